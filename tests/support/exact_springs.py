"""Energies of springs differentiated with 60 digits along the kinematics of the URDF's own numbers.

Numbers carry their first and second derivatives (jets) through the textbook formula of each energy: nothing of the
kernels' code, no closed form of a gradient or a Hessian enters.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from support.exact_chain import numbers, origin

mp = mpmath.mp.clone()
mp.dps = 60


def exact(array: Any) -> np.ndarray:
    """An array of 60-digit numbers of the same values."""
    values = np.asarray(array)
    out = np.empty(values.shape, dtype=object)
    for index in np.ndindex(values.shape):
        out[index] = mp.mpf(float(values[index]) if values.dtype != object else values[index])
    return out


@dataclass
class Jet:
    """A number with gradient (k) and Hessian (k, k)."""

    value: Any
    first: np.ndarray
    second: np.ndarray

    def __add__(self, other: Any) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.first + other.first, self.second + other.second)
        return Jet(self.value + other, self.first, self.second)

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return self * -1

    def __sub__(self, other: Any) -> Jet:
        return self + -1 * other

    def __rsub__(self, other: Any) -> Jet:
        return -1 * self + other

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.first * other, self.second * other)
        cross = np.outer(self.first, other.first)
        second = self.value * other.second + other.value * self.second + cross + cross.T
        return Jet(self.value * other.value, self.value * other.first + other.value * self.first, second)

    __rmul__ = __mul__

    def through(self, value: Any, slope: Any, curvature: Any) -> Jet:
        """f(self), from f, f' and f'' at its value."""
        return Jet(value, slope * self.first, slope * self.second + curvature * np.outer(self.first, self.first))

    def inverse(self) -> Jet:
        x = 1 / self.value
        return self.through(x, -(x**2), 2 * x**3)

    def sqrt(self) -> Jet:
        x = mp.sqrt(self.value)
        return self.through(x, 1 / (2 * x), -1 / (4 * x**3))


def arc(sine: Jet, cosine: Jet) -> Jet:
    """atan2 of two jets, the second one positive."""
    ratio = sine * cosine.inverse()
    slope = 1 / (1 + ratio.value**2)
    return ratio.through(mp.atan2(sine.value, cosine.value), slope, -2 * ratio.value * slope**2)


def poses(text: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jets of the last link's origin (3) and rotation (3,3) by q, from the URDF's text (a serial chain)."""
    robot = ET.fromstring(text)
    n = len(q)
    zero, zeros = exact(np.zeros(n)), exact(np.zeros((n, n)))

    def jets(values: Any) -> np.ndarray:
        out = np.empty(np.shape(values), dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = Jet(mp.mpf(values[index]), zero, zeros)
        return out

    rotation, place, coordinate = jets(np.eye(3)), jets(np.zeros(3)), 0
    for joint in robot.findall("joint"):
        own_rotation, own_place = origin(joint)
        own = np.array([[mp.mpf(own_rotation[i, j]) for j in range(3)] for i in range(3)], dtype=object)
        place = place + rotation @ np.array([mp.mpf(x) for x in own_place], dtype=object)
        rotation = rotation @ own
        if joint.get("type") == "fixed":
            continue
        mimic, at, multiplier, offset = joint.find("mimic"), coordinate, mp.mpf(1), mp.mpf(0)
        if mimic is None:
            coordinate += 1
        else:
            at, multiplier, offset = 0, mp.mpf(mimic.get("multiplier")), mp.mpf(mimic.get("offset"))
        first = zero.copy()
        first[at] = multiplier
        position = Jet(multiplier * mp.mpf(float(q[at])) + offset, first, zeros)
        axis = np.array([mp.mpf(x) for x in numbers(joint.find("axis").get("xyz"), "")], dtype=object)
        axis = axis / mp.sqrt(axis @ axis)
        if joint.get("type") == "prismatic":
            place = place + (rotation @ axis) * position
            continue
        s, c = mp.sin(position.value), mp.cos(position.value)
        sine, cosine = position.through(s, c, -s), position.through(c, -s, -c)
        K = exact([[0, 0, 0]] * 3)
        K[0, 1], K[0, 2], K[1, 2] = -axis[2], axis[1], -axis[0]
        K[1, 0], K[2, 0], K[2, 1] = axis[2], -axis[1], axis[0]
        turn = jets(np.eye(3)) + K * sine + (K @ K) * (1 - cosine)
        rotation = rotation @ turn
    return place, rotation


def moved(place: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jets of p + v and exp([w]) R by x = (v, w) at 0, from 60-digit numbers."""
    zero, zeros = exact(np.zeros(6)), exact(np.zeros((6, 6)))
    x = [Jet(mp.mpf(0), np.array([mp.mpf(i == k) for i in range(6)], dtype=object), zeros) for k in range(6)]
    v, w = np.array(x[:3], dtype=object), x[3:]
    none = Jet(mp.mpf(0), zero, zeros)
    W = np.array([[none, -w[2], w[1]], [w[2], none, -w[0]], [-w[1], w[0], none]], dtype=object)
    one = np.array([[none + mp.mpf(i == j) for j in range(3)] for i in range(3)], dtype=object)
    return v + place, (one + W + (W @ W) * mp.mpf("0.5")) @ rotation


def _turned(axes: str, R: np.ndarray, R0: np.ndarray) -> np.ndarray:
    return {"base": exact(np.eye(3)), "tip": R, "equilibrium": R0}[axes]


def _upper(matrix: np.ndarray) -> np.ndarray:
    return np.triu(matrix) + np.triu(matrix, 1).T


def orthonormal(rounded: np.ndarray) -> np.ndarray:
    """The rotation (60 digits) that a rotation matrix of doubles is the rounding of, by Gram and Schmidt."""
    x, y, _ = exact(rounded).T
    x = x / mp.sqrt(x @ x)
    y = y - x * (x @ y)
    y = y / mp.sqrt(y @ y)
    return np.stack(
        [x, y, np.array([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])], 1
    )


def energy(kind: str, placement: Any, p: np.ndarray, R: np.ndarray, equilibrium: Any, *stiffnesses: np.ndarray) -> Jet:
    """A spring's energy as a jet; ``equilibrium`` is (p0, R0) in 60 digits, the stiffnesses are arrays of doubles.

    Where R and R0 are rounded to doubles, and so no rotations to the last digit, displacements enter as the definition
    of the energies has it: through R - R0.
    """
    p0, R0 = equilibrium
    K = [exact(_upper(s)) for s in stiffnesses]
    translation = placement.translation_axes or ("equilibrium" if kind == "coupled" else "base")
    centre = exact(placement.centre)
    away = _turned(translation, R, R0).T @ (p - p0 + (R - R0) @ centre)
    Kt, Ko = (K[0][:3, :3], K[0][3:, 3:]) if kind == "coupled" else K
    linear = (away @ Kt @ away) * mp.mpf("0.5")
    D = R - R0
    S = R0.T @ D
    s = np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]], dtype=object) * mp.mpf("0.5")  # u sin a
    if placement.rotation_axes == "base":
        D, s = D @ R0.T, R0 @ s
    if kind in ("trace", "coupled"):
        G = exact(np.eye(3)) * (Ko[0, 0] + Ko[1, 1] + Ko[2, 2]) / 2 - Ko
        total = linear + sum((row @ G @ row for row in D), start=mp.mpf(0)) * mp.mpf("0.5")
        return total + away @ K[0][:3, 3:] @ s if kind == "coupled" else total
    E = R0.T @ R
    cosine = (E[0, 0] + E[1, 1] + E[2, 2] - 1) * mp.mpf("0.5")
    square = s @ s
    sine = square.sqrt()
    angle = arc(sine, cosine) if cosine.value > 0 else mp.pi - arc(sine, -cosine)
    form = (s @ Ko @ s) * square.inverse()
    if kind == "rotation_vector":
        return linear + angle * angle * form * mp.mpf("0.5")
    c, sn = mp.cos(angle.value / 2), mp.sin(angle.value / 2)
    return linear + (1 - angle.through(c, -sn / 2, -c / 4)) * form * 4
