# SPDX-License-Identifier: MIT
"""Differentiate energies of springs with 60 digits along the kinematics of the URDF's own numbers.

Numbers carry their first and second derivatives (jets) through the textbook formula of each energy. The test uses no
code of the kernels and no closed form of a gradient or a Hessian. The numbers are balls (Arb, in python-flint), which
bound the loss of digits.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat

from support.chains import child_of

flint.ctx.dps = 60


def exact(array: Any) -> np.ndarray:
    """Return an array of 60-digit numbers of the same values."""
    values = np.asarray(array)
    out = np.empty(values.shape, dtype=object)
    for index in np.ndindex(values.shape):
        out[index] = values[index] if isinstance(values[index], arb) else arb(float(values[index]))
    return out


def floats(array: Any) -> np.ndarray:
    """Round to doubles."""
    if isinstance(array, arb_mat):
        return np.array([float(x) for x in array.entries()]).reshape(array.nrows(), array.ncols())
    return np.array([float(x) for x in np.ravel(array)]).reshape(np.shape(array))


@dataclass
class Jet:
    """A number with gradient (1, k) and Hessian (k, k)."""

    value: arb
    first: arb_mat
    second: arb_mat

    @staticmethod
    def variables(values: Any) -> np.ndarray:
        """Return jets of the values with respect to themselves."""
        k = len(values)
        units = [arb_mat(1, k, [arb(i == j) for j in range(k)]) for i in range(k)]
        return np.array([Jet(v, u, arb_mat(k, k)) for v, u in zip(exact(values), units, strict=True)], dtype=object)

    def __add__(self, other: Any) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.first + other.first, self.second + other.second)
        return Jet(self.value + other, self.first, self.second)

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.first, -self.second)

    def __sub__(self, other: Any) -> Jet:
        return self + -other

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.first * other, self.second * other)
        cross = self.first.transpose() * other.first
        second = other.second * self.value + self.second * other.value + cross + cross.transpose()
        return Jet(self.value * other.value, other.first * self.value + self.first * other.value, second)

    __rmul__ = __mul__

    def through(self, value: arb, slope: arb, curvature: arb) -> Jet:
        """Return f(self), from f, f' and f'' at its value."""
        outer = self.first.transpose() * self.first
        return Jet(value, self.first * slope, self.second * slope + outer * curvature)

    def inverse(self) -> Jet:
        x = 1 / self.value
        return self.through(x, -(x**2), 2 * x**3)

    def sqrt(self) -> Jet:
        x = self.value.sqrt()
        return self.through(x, 1 / (2 * x), -1 / (4 * x**3))


def arc(sine: Jet, cosine: Jet) -> Jet:
    """Return atan2 of two jets, the second one positive."""
    ratio = sine * cosine.inverse()
    slope = 1 / (1 + ratio.value**2)
    return ratio.through(arb.atan2(sine.value, cosine.value), slope, -2 * ratio.value * slope**2)


def _numbers(text: str | None, default: str = "0 0 0") -> np.ndarray:
    return np.array([arb(word) for word in (text or default).split()], dtype=object)


def cross_matrix(v: np.ndarray) -> np.ndarray:
    x, y, z = v
    zero = 0 * x
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]], dtype=object)


ONE = exact(np.eye(3))


def _turn(axis: np.ndarray, sine: Any, cosine: Any) -> np.ndarray:
    """Return the rotation about a unit axis; sine and cosine are numbers or jets."""
    K = cross_matrix(axis)
    return ONE + K * sine + (K @ K) * (1 - cosine)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return exp([vector])."""
    v = exact(vector)
    angle = (v @ v).sqrt()
    return _turn(v / angle, angle.sin(), angle.cos())


class Kinematics:
    """Serial chain read from the text of its URDF; joints stand in order in the file, mimic joints follow the first."""

    def __init__(self, text: str) -> None:
        self.joints = []
        for joint in ET.fromstring(text).findall("joint"):
            found = joint.find("origin")
            given = {} if found is None else found.attrib
            rotation = ONE
            for axis, angle in zip(ONE, _numbers(given.get("rpy")), strict=True):  # about x, then y, then z
                rotation = _turn(axis, angle.sin(), angle.cos()) @ rotation
            kind, mimic, axis = joint.get("type"), joint.find("mimic"), None
            if kind != "fixed":
                axis = _numbers(child_of(joint, "axis").get("xyz"))
                axis = axis / (axis @ axis).sqrt()
            law = None if mimic is None else (arb(mimic.get("multiplier")), arb(mimic.get("offset")))
            self.joints.append((kind, rotation, _numbers(given.get("xyz")), axis, law))

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return jets with respect to q: origin (3) and rotation (3,3) of the last link in the first."""
        coordinates = list(Jet.variables(q))
        first, none = coordinates[0], 0 * coordinates[0]
        R, p = ONE + none, np.array([none, none, none], dtype=object)
        for kind, own, place, axis, law in self.joints:
            p, R = p + R @ place, R @ own
            if kind == "fixed":
                continue
            position = first * law[0] + law[1] if law else coordinates.pop(0)
            if kind == "prismatic":
                p = p + (R @ axis) * position
            else:
                s, c = position.value.sin(), position.value.cos()
                R = R @ _turn(axis, position.through(s, c, -s), position.through(c, -s, -c))
        return p, R


def moved(p: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return jets of p + v and exp([w]) R with respect to x = (v, w) at 0, from numbers."""
    x = Jet.variables(np.zeros(6))
    W = cross_matrix(x[3:])
    return x[:3] + p, (ONE + W + (W @ W) * arb(0.5)) @ R


def orthonormal(rounded: np.ndarray) -> np.ndarray:
    """Return the rotation (60 digits) nearest to a rounded rotation matrix, by Gram and Schmidt."""
    x, y, _ = exact(rounded).T
    x = x / (x @ x).sqrt()
    y = y - x * (x @ y)
    y = y / (y @ y).sqrt()
    return np.stack([x, y, cross_matrix(x) @ y], 1)


def _upper(matrix: np.ndarray) -> np.ndarray:
    return np.triu(matrix) + np.triu(matrix, 1).T


class Energies:
    """Energies of all springs between one pose (jets) and one equilibrium (p0, R0), with one stiffness (6, 6).

    The diagonal blocks are Kt and Ko of the springs that have two stiffnesses, ``limits`` the largest force and moment
    of the bounded spring. Terms that springs, axes and centres share are computed once. If R and R0 are rounded to
    doubles, they are no exact rotations. Displacements then enter through R - R0, as in the definition of the energies.
    """

    def __init__(
        self, p: np.ndarray, R: np.ndarray, equilibrium: Any, stiffness: np.ndarray, limits: tuple[float, float]
    ) -> None:
        self.p, self.R, (self.p0, self.R0) = p, R, equilibrium
        self.K = exact(_upper(stiffness))
        self.limits = limits
        self.known: dict[Any, Any] = {}

    def __call__(self, kind: str, placement: Any) -> Jet:
        """Return the energy of a spring with these axes and centre."""
        translation = placement.translation_axes or ("equilibrium" if kind == "coupled" else "base")
        where = translation, tuple(placement.centre)
        linear = self._shared(self._linear, *where)
        if kind == "bounded":
            turning = self._shared(self._turning, "trace", placement.rotation_axes)
            return self._bounded(linear, self.K[:3, :3], self.limits[0]) + self._bounded(
                turning, self.K[3:, 3:], self.limits[1]
            )
        if kind != "coupled":
            return linear + self._shared(self._turning, kind, placement.rotation_axes)
        turning = self._shared(self._turning, "trace", placement.rotation_axes)
        return linear + turning + self._shared(self._cross, *where, placement.rotation_axes)

    def _shared(self, function: Any, *arguments: Any) -> Any:
        key = function.__name__, arguments
        if key not in self.known:
            self.known[key] = function(*arguments)
        return self.known[key]

    def _away(self, axes: str, centre: tuple[float, ...]) -> np.ndarray:
        """Return the displacement of the centre of stiffness, in the axes of Kt."""
        away = self.p - self.p0 + (self.R - self.R0) @ exact(centre)
        return {"base": ONE, "tip": self.R, "equilibrium": self.R0}[axes].T @ away

    def _linear(self, axes: str, centre: tuple[float, ...]) -> Jet:
        away = self._shared(self._away, axes, centre)
        return away @ (self.K[:3, :3] @ away) * arb(0.5)

    def _bounded(self, V: Jet, K: np.ndarray, limit: float) -> Jet:
        """Return E (sqrt(1 + 2 V/E) - 1), the pseudo-Huber form, with E = limit^2/kappa and kappa >= |K|."""
        kappa = max((sum(abs(x) for x in row) for row in K), key=float)
        scale = arb(limit) ** 2 / kappa
        return ((V * (2 / scale) + 1).sqrt() - 1) * scale

    def _seen_from(self, axes: str) -> np.ndarray:
        """Return the axes of Ko relative to the equilibrium's axes, as columns."""
        return {"base": self.R0.T, "tip": self.R0.T @ self.R, "equilibrium": ONE}[axes]

    def _sine(self, axes: str) -> np.ndarray:
        """Return the axis of the rotation R0^T R times the sine of its angle, in the axes of Ko."""
        S = self.R0.T @ (self.R - self.R0)
        s = np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]], dtype=object) * arb(0.5)
        return self._seen_from(axes).T @ s

    def _cross(self, axes: str, centre: tuple[float, ...], rotation_axes: str) -> Jet:
        away, s = self._shared(self._away, axes, centre), self._shared(self._sine, rotation_axes)
        return away @ (self.K[:3, 3:] @ s)

    def _turning(self, kind: str, axes: str) -> Jet:
        Ko = self.K[3:, 3:]
        if kind == "trace":
            G = ONE * (Ko[0, 0] + Ko[1, 1] + Ko[2, 2]) / 2 - Ko
            D = (self.R - self.R0) @ self._seen_from(axes)
            return sum((row @ (G @ row) for row in D), start=0) * arb(0.5)
        s, angle = self._shared(self._sine, axes), self._shared(self._angle)
        form = s @ (Ko @ s) * self._shared(self._inverse_square)
        if kind == "rotation_vector":
            return angle * angle * form * arb(0.5)
        c, sn = (angle.value / 2).cos(), (angle.value / 2).sin()
        return (1 - angle.through(c, -sn / 2, -c / 4)) * form * 4

    def _square(self) -> Jet:
        s = self._shared(self._sine, "equilibrium")
        return s @ s

    def _inverse_square(self) -> Jet:
        return self._shared(self._square).inverse()

    def _angle(self) -> Jet:
        E = self.R0.T @ self.R
        cosine, sine = (E[0, 0] + E[1, 1] + E[2, 2] - 1) * arb(0.5), self._shared(self._square).sqrt()
        return arc(sine, cosine) if cosine.value > 0 else arb.pi() - arc(sine, -cosine)
