# SPDX-License-Identifier: MIT
"""Differentiate springs' energies, written in another form, along the pose, as references for the kernels.

The kernels have closed forms of gradient and Hessian; here CasADi differentiates the energy along a plain product of
joint poses, with respect to q (torque, joint stiffness) and to a twist of the tip (wrench, covariant Hessian).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from stiffgen.core.symbolic.choices import KINDS
from stiffgen.core.symbolic.placement import Placement
from stiffgen.families.springs.springs import Spring
from stiffgen.families.springs.springs import spring as stiffgen_spring

Energy = Callable[..., ca.SX]


def _symmetric(matrix: ca.SX) -> ca.SX:
    return (matrix + matrix.T) / 2


def _vee(E: ca.SX) -> ca.SX:
    """Return the vector a of [a] = (E - E^T)/2: the axis of a rotation times the sine of its angle."""
    return ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2


def _in(axes: str, R: ca.SX, R0: ca.SX) -> ca.SX:
    """Return the rotation of a stiffness' axes in the base."""
    return {"base": ca.SX.eye(3), "tip": R, "equilibrium": R0}[axes]


def _rotation(R: ca.SX, R0: ca.SX, Ko: ca.SX, rotation: str, axes: str) -> ca.SX:
    """Return the rotational energy of a kind of spring; ``axes`` are those of Ko, which is turned to R0's.

    The trace form tr(G (I - E)) is written with R - R0, which keeps its digits near the equilibrium.
    """
    Q = R0.T @ _in(axes, R, R0)
    K, E = Q @ _symmetric(Ko) @ Q.T, R0.T @ R
    if rotation == "trace":
        return ca.trace((R - R0) @ (ca.trace(K) / 2 * ca.SX.eye(3) - K) @ (R - R0).T) / 2
    w, v = _quaternion(E)
    square = ca.dot(v, v)
    angle = 2 * ca.atan2(ca.sqrt(square), w)
    form = v.T @ K @ v / square  # u^T K u, u the axis
    return form * {"rotation_vector": angle**2 / 2, "quaternion": 4 * (1 - ca.cos(angle / 2))}[rotation]


def _quaternion(E: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the unit quaternion (w, v), w >= 0, of a rotation by the one of four formulas with the largest divisor.

    Each formula has one component as the root of its square and divides by it (Shepperd 1978). The squares are
    4 w^2 = 1 + t and 4 v_k^2 = 1 + 2 E_kk - t, t the trace: the largest of t and E_kk decides. The chosen formula is
    smooth where it is chosen, so that CasADi can differentiate it.
    """
    t = ca.trace(E)
    largest, q = t, ca.vertcat(1 + t, 2 * _vee(E)) / (2 * ca.sqrt(1 + t))  # divides by w
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        divisor = 2 * ca.sqrt(1 + 2 * E[k, k] - t)  # 4 v_k
        by_component = ca.SX(4, 1)
        by_component[0] = (E[j, i] - E[i, j]) / divisor
        by_component[1 + k] = divisor / 4
        by_component[1 + i], by_component[1 + j] = (E[i, k] + E[k, i]) / divisor, (E[j, k] + E[k, j]) / divisor
        is_larger = E[k, k] > largest
        q, largest = ca.if_else(is_larger, by_component, q), ca.if_else(is_larger, E[k, k], largest)
    sign = ca.if_else(q[0] < 0, -1, 1)
    return sign * q[0], sign * q[1:]


def _pseudo_huber(V: ca.SX, K: ca.SX, limit: ca.SX) -> ca.SX:
    """Return E (sqrt(1 + 2 V/E) - 1), E = limit^2/kappa, kappa the largest sum of absolute values in a row of K."""
    E = limit**2 / ca.mmax(ca.sum2(ca.fabs(_symmetric(K))))
    return E * (ca.sqrt(1 + 2 * V / E) - 1)


def textbook(name: str, placement: Placement) -> Energy:
    """Return the textbook energy of one of stiffgen's springs, by the group of its kernels."""
    kind = name.removeprefix("spring").removeprefix("_") or "trace"
    translation = placement.translation_axes or ("equilibrium" if kind == "coupled" else "base")

    def energy(p: ca.SX, R: ca.SX, H: ca.SX, *stiffnesses: ca.SX) -> ca.SX:
        """Return the energy [J] at position p and rotation R of the tip, with equilibrium H."""
        R0, p0, centre = H[:3, :3], H[:3, 3], ca.DM(placement.centre)
        # displacement [m] of the centre of stiffness, in the axes of the translational stiffness
        away = _in(translation, R, R0).T @ (p + R @ centre - p0 - R0 @ centre)
        if kind == "bounded":
            Kt, Ko, force, moment = stiffnesses
            turned = _rotation(R, R0, Ko, "trace", placement.rotation_axes)
            return _pseudo_huber(away.T @ _symmetric(Kt) @ away / 2, Kt, force) + _pseudo_huber(turned, Ko, moment)
        if kind != "coupled":
            Kt, Ko = stiffnesses
            return away.T @ _symmetric(Kt) @ away / 2 + _rotation(R, R0, Ko, kind, placement.rotation_axes)
        K = _symmetric(stiffnesses[0])
        sine = _in(placement.rotation_axes, R, R0).T @ R0 @ _vee(R0.T @ R)
        turned = _rotation(R, R0, K[3:, 3:], "trace", placement.rotation_axes)
        return away.T @ K[:3, :3] @ away / 2 + turned + away.T @ K[:3, 3:] @ sine

    return energy


def differentiated(
    spring: Spring, placement: Placement, pose: ca.SX, q: ca.SX, parameters: list[ca.SX]
) -> dict[str, ca.SX]:
    """Return the values of the kernels of a spring by differentiation of its energy, by name of the result.

    A user's potential is differentiated along the pose without changes.
    """
    is_stiffgens = spring.name in {each.name for each in map(stiffgen_spring, KINDS)}
    energy = textbook(spring.name, placement) if is_stiffgens else spring.energy
    p, R = pose[:3, 3], pose[:3, :3]
    x = ca.SX.sym("x", 6)  # twist of the tip
    turn = ca.skew(x[3:])
    moved = energy(p + x[:3], (ca.DM.eye(3) + turn + turn @ turn / 2) @ R, *parameters)
    covariant, wrench = (ca.substitute(each, x, ca.DM.zeros(6)) for each in ca.hessian(moved, x))
    value = energy(p, R, *parameters)
    hessian, gradient = ca.hessian(value, q)
    return {
        "energy": value, "wrench": wrench, "task_stiffness": covariant, "torque": -gradient, "joint_stiffness": hessian,
    }  # fmt: skip
