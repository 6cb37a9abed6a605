"""Oracles for the kernels of springs: each energy written down another way, and differentiated along the pose.

The kernels have closed forms of gradient and Hessian; here CasADi differentiates the energy along a plain product of
joint poses by q (torque, joint stiffness) and by a twist of the tip (wrench, covariant Hessian).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from stiffgen.symbolic.springs import Spring

Energy = Callable[..., ca.SX]


def _symmetric(matrix: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(matrix))


def _trace(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> ca.SX:
    away, stiffness = p - H[:3, 3], _symmetric(Ko)
    G = ca.trace(stiffness) / 2 * ca.SX.eye(3) - stiffness
    return away.T @ _symmetric(Kt) @ away / 2 + ca.trace(G @ (ca.SX.eye(3) - H[:3, :3].T @ R))


ENERGIES: dict[str, Energy] = {"spring": _trace}
"""Energies by group of kernels, as textbooks have them."""


def differentiated(spring: Spring, pose: ca.SX, q: ca.SX, parameters: list[ca.SX]) -> dict[str, ca.SX]:
    """What the kernels of a spring compute, by differentiation of its energy; names as those of the results."""
    energy = ENERGIES[spring.name]
    p, R = pose[:3, 3], pose[:3, :3]
    x = ca.SX.sym("x", 6)
    turn = ca.skew(x[3:])
    moved = energy(p + x[:3], (ca.DM.eye(3) + turn + turn @ turn / 2) @ R, *parameters)
    covariant, wrench = (ca.substitute(each, x, ca.DM.zeros(6)) for each in ca.hessian(moved, x))
    value = energy(p, R, *parameters)
    hessian, gradient = ca.hessian(value, q)
    return {
        "energy": value, "wrench": wrench, "task_stiffness": covariant, "torque": -gradient, "joint_stiffness": hessian,
    }  # fmt: skip
