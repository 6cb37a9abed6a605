# SPDX-License-Identifier: MIT
"""Gradient drive of a ball joint, without a robot: energy, torque, stiffness, and damping of each deflection.

Simulators drive ball joints by K times the difference of two rotation vectors, which is no gradient, and flutters
(docs/flutter.md). The functions here take one energy. They accept arrays of NumPy and of JAX (jit, vmap, grad), and
leading dimensions broadcast; ``HEADER`` is the same in C, to be copied.

A rotation is a unit quaternion (4), ordered (x, y, z, w), of the body in its parent; only its direction counts. Torque,
stiffness and damping are in the axes of the body, as the rates of a ball joint are. With the rotation from the target
to the body, an angle a about the axis u, and the stiffness K at the target, the energies are

    "trace"     (1 - cos a) u^T K u     smooth everywhere; the torque falls to zero at a half turn
    "log"       (a^2 / 2) u^T K u       does not soften; the torque jumps at a half turn

For turns about the axis of the target and K = k I, "log" is three position drives of the gain k. Both energies are
g(eta) eps^T K eps of the quaternion (eta, eps), as in :func:`stiffgen.families.springs.parts.by_quaternion`; the tests
compare the two.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

AnyArray = Any
"""Array of NumPy or JAX."""

HEADER = Path(__file__).with_name("drive.h")
"""The drive in C99, a header of static inline functions."""

_SERIES_BOUND = 1e-4
"""Bound on |eps|^2 below which a series replaces the half angle divided by its sine (error below 1e-17)."""


_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""Indices of a cross product: a[_NEXT] b[_LAST] - a[_LAST] b[_NEXT]."""


def _cross(a: AnyArray, b: AnyArray) -> AnyArray:
    """Return a x b; ``numpy.cross`` would take a third of the time of the whole call."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def _namespace(*arrays: AnyArray) -> Any:
    """Return the module of the functions of some arrays: ``jax.numpy`` if one of them is JAX's, else NumPy."""
    for array in arrays:
        if hasattr(array, "__array_namespace__"):
            module = array.__array_namespace__()
            if module is not np:
                return module
    return np


def _factor(xp: Any, eta: AnyArray, square: AnyArray, form: str) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return g of the energy g eps^T K eps and its first and second derivative with respect to eta.

    It is 2 for the form "trace", and 2 h^2 for "log", with the half angle over its sine h; ``square`` is |eps|^2.
    """
    if form == "trace":
        return 2.0 + 0.0 * eta, 0.0 * eta, 0.0 * eta
    if form != "log":
        raise ValueError(f'form must be "trace" or "log", not {form!r}')
    h, first, second = _half_angle_over_sine(xp, eta, square)
    return 2 * h**2, 4 * h * first, 4 * (first**2 + h * second)


def _half_angle_over_sine(xp: Any, eta: AnyArray, square: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return h = arctan2(s, eta) / s with s^2 = ``square`` = 1 - eta^2, and its derivatives with respect to eta.

    Far away s^2 h' = eta h - 1 and s^2 h'' = h + 3 eta h'. Near the target, where these lose all digits, h is a series
    in x = s^2, with dx/deta = -2 eta: h = 1 + x/6 + 3 x^2/40 + 15 x^3/336.
    """
    is_near = square < _SERIES_BOUND
    x, away = xp.where(is_near, square, 0.0), xp.where(is_near, 1.0, square)  # each where its formula holds
    sine = xp.sqrt(away)
    far = xp.arctan2(sine, eta) / sine
    far_first = (eta * far - 1) / away
    slope = 1 / 6 + x * (6 / 40 + x * (45 / 336))  # dh/dx
    bend = 6 / 40 + x * (90 / 336)  # d2h/dx2
    h = xp.where(is_near, 1 + x * (1 / 6 + x * (3 / 40 + x * (15 / 336))), far)
    first = xp.where(is_near, -2 * eta * slope, far_first)
    second = xp.where(is_near, 4 * eta**2 * bend - 2 * slope, (far + 3 * eta * far_first) / away)
    return h, first, second


class _Deflection:
    """Rotation from the target as quaternion (eta, eps) with eta >= 0, and the products of the formulas.

    Attributes:
        xp: module of the arrays' functions.
        K: symmetric part of the stiffness (3, 3).
        eta, eps: scalar (1) and vector part (3) of the quaternion.
        g, dg, ddg: factor of the energy and its derivatives with respect to eta (1).
        share: eps^T K eps (1), of which the energy is g times.
        n: T^T K eps (3), with T = eta 1 + [eps]: a turn by y changes eps by T y / 2.

    """

    def __init__(self, rotation: AnyArray, target: AnyArray, rotation_stiffness: AnyArray, form: str) -> None:
        self.xp = xp = _namespace(rotation, target, rotation_stiffness)
        a, b = xp.asarray(target), xp.asarray(rotation)
        K = xp.asarray(rotation_stiffness)
        if a.shape[-1:] != (4,) or b.shape[-1:] != (4,) or K.shape[-2:] != (3, 3):
            raise ValueError(
                "rotation and target must end with 4 numbers (x, y, z, w), rotation_stiffness with (3, 3), not have "
                f"the shapes {b.shape}, {a.shape}, {K.shape}"
            )
        # the product of the target's conjugate and the rotation
        eps = a[..., 3:] * b[..., :3] - b[..., 3:] * a[..., :3] - _cross(a[..., :3], b[..., :3])
        eta = (a * b).sum(-1, keepdims=True)
        scale = xp.where(eta < 0, -1.0, 1.0) / xp.sqrt(eta**2 + (eps**2).sum(-1, keepdims=True))
        self.K, self.eta, self.eps = 0.5 * (K + xp.swapaxes(K, -1, -2)), scale * eta, scale * eps
        self.g, self.dg, self.ddg = _factor(xp, self.eta, (self.eps**2).sum(-1, keepdims=True), form)
        K_eps = (self.K @ self.eps[..., None])[..., 0]
        self.share = (self.eps * K_eps).sum(-1, keepdims=True)
        self.n = self.eta * K_eps + _cross(K_eps, self.eps)


def energy(rotation: AnyArray, target: AnyArray, rotation_stiffness: AnyArray, form: str = "trace") -> AnyArray:
    """Return the energy of the drive, zero at the target.

    Args:
        rotation: quaternion of the body (4), in the axes of its parent.
        target: quaternion at which the drive is at rest (4).
        rotation_stiffness: stiffness K at the target (3, 3) [N m/rad], in the axes of the target; its symmetric part
            is used.
        form: "trace" or "log".

    Returns:
        Energy () [J].

    Raises:
        ValueError: shapes differ, or ``form`` is another word.

    """
    turn = _Deflection(rotation, target, rotation_stiffness, form)
    return (turn.g * turn.share)[..., 0]


def torque(rotation: AnyArray, target: AnyArray, rotation_stiffness: AnyArray, form: str = "trace") -> AnyArray:
    """Return the torque of the drive on the body (3) [N m], in the body's axes: minus the gradient of the energy.

    Arguments and errors as in :func:`energy`. A turn by y changes eta by -eps . y / 2 and eps by T y / 2, and so the
    energy g(eta) eps^T K eps by (g T^T K eps - g' (eps^T K eps) eps / 2) . y.
    """
    turn = _Deflection(rotation, target, rotation_stiffness, form)
    return 0.5 * turn.share * turn.dg * turn.eps - turn.g * turn.n


def stiffness(rotation: AnyArray, target: AnyArray, rotation_stiffness: AnyArray, form: str = "trace") -> AnyArray:
    """Return the second derivative of the energy along turns about fixed axes (3, 3) [N m/rad], in the body's axes.

    The matrix is symmetric, and negative in some directions at large deflections. Arguments and errors as in
    :func:`energy`.

    The energy is V = g(eta) eps^T K eps of the deflection's quaternion (eta, eps). A turn by y changes eta by
    -eps . y / 2 and eps by T y / 2, T = eta I + [eps]; V to second order in y gives the terms below.
    """
    turn = _Deflection(rotation, target, rotation_stiffness, form)
    xp, eye = turn.xp, np.eye(3)
    skew = _cross(turn.eps[..., None, :], eye)  # row i is eps x e_i: column i of [eps]
    T = turn.eta[..., None] * eye + xp.swapaxes(skew, -1, -2)
    across = (0.25 * turn.share * (turn.eta * turn.dg + 2 * turn.g))[..., None]
    mixed = turn.eps[..., :, None] * turn.n[..., None, :]
    square = turn.eps[..., :, None] * turn.eps[..., None, :]
    turned = xp.swapaxes(T, -1, -2) @ turn.K @ T
    return (
        0.25 * turn.g[..., None] * (turned + xp.swapaxes(turned, -1, -2))
        + (0.25 * turn.share * turn.ddg)[..., None] * square
        - 0.5 * turn.dg[..., None] * (mixed + xp.swapaxes(mixed, -1, -2))
        - across * eye
    )


def damping(stiffness: AnyArray, inertia: AnyArray, ratio: float = 1.0) -> AnyArray:
    """Return the damping with which every mode of a stiffness and an inertia has a damping ratio.

    With the stiffness of a deflection (:func:`stiffness`) the damping follows the deflection. A mode of negative
    stiffness has the damping of its absolute value, and a mode without stiffness has none.

    Args:
        stiffness: matrix (3, 3) [N m/rad], in the body's axes; its symmetric part is used.
        inertia: inertia of the body (3, 3) [kg m^2], symmetric and positive definite, in the body's axes.
        ratio: damping ratio; 1 is critical.

    Returns:
        Damping (3, 3) [N m s/rad], symmetric and positive semidefinite.

    """
    xp = _namespace(stiffness, inertia)
    # With M = L L^T and L^-1 K L^-T = W diag(values) W^T the damping is 2 ratio L W diag(sqrt(values)) W^T L^T.
    L = xp.linalg.cholesky(xp.asarray(inertia))
    reduced = xp.linalg.solve(L, xp.swapaxes(xp.linalg.solve(L, xp.asarray(stiffness)), -1, -2))
    values, W = xp.linalg.eigh(0.5 * (reduced + xp.swapaxes(reduced, -1, -2)))
    modes = L @ W
    return 2 * ratio * (modes * xp.sqrt(xp.abs(values))[..., None, :]) @ xp.swapaxes(modes, -1, -2)
