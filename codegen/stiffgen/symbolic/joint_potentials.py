# SPDX-License-Identifier: MIT
"""Potentials of the joint positions: a posture to return to, and joint limits to stay away from.

A redundant arm needs something beside a spring at the tip, which leaves it motions that cost nothing. Only a potential
keeps the whole conservative: energies, torques and joint stiffnesses of all of them add up. Each is defined once, by
its energy U(q) [J]; torque -dU/dq and joint stiffness d2U/dq2 follow by differentiation.

    posture   U = sum_i k_i (q_i - r_i)^2/2                  r the posture to return to; isotropic if all k_i are equal
    limits    U = sum_i k_i (d+_i^3 + d-_i^3)/(6 w)          d+ = max(0, q - (upper - w)), d- = max(0, lower + w - q)

d is the depth in the zone of width w before a limit, along the joint: there the torque is k d^2/(2 w), away from the
limit, and the stiffness k d/w, which rises from 0 at the zone's edge to k at the limit. Both are continuous. A linear
spring from the zone's edge on would be stiff at once: its tangent jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from stiffgen.symbolic.arguments import Argument

Part = Literal["energy", "torque", "joint_stiffness"]


@dataclass(frozen=True)
class JointPotential:
    """Potential of q, a sum over the coordinates; ``name`` is the group of its kernels.

    ``energy`` is that of one coordinate: of its position, and of the ``parameters``, its own where there is one each.
    """

    name: str
    title: str
    parameters: tuple[Argument, ...]
    energy: Callable[..., ca.SX]
    equation: str
    domain: str


def _posture_energy(q: ca.SX, posture: ca.SX, stiffness: ca.SX) -> ca.SX:
    return stiffness * (q - posture) ** 2 / 2


def _cube(depth: ca.SX) -> ca.SX:
    """Return the cube of a positive number, else 0: two derivatives are continuous."""
    return ca.if_else(depth <= 0, 0, depth**3)


def _limits_energy(q: ca.SX, lower: ca.SX, upper: ca.SX, zone: ca.SX, stiffness: ca.SX) -> ca.SX:
    return stiffness * (_cube(q - (upper - zone)) + _cube((lower + zone) - q)) / (6 * zone)


_STIFFNESS_UNIT = "N m/rad or N/m"
POSTURE = JointPotential(
    "posture",
    "the spring that pulls every joint to a posture",
    (
        Argument("posture", ("q",), "rad or m", "joint positions at which the spring is at rest", symbol="r"),
        Argument("posture_stiffness", ("q",), _STIFFNESS_UNIT, "of every joint, not negative", symbol="k"),
    ),
    _posture_energy,
    "U = sum_i k_i (q_i - r_i)^2/2",
    "Torque and stiffness add to those of a spring at the tip, and keep the whole conservative.",
)
LIMITS = JointPotential(
    "limits",
    "the potential that keeps joints away from their limits",
    (
        Argument("lower", ("q",), "rad or m", "lower limits", symbol="a"),
        Argument("upper", ("q",), "rad or m", "upper limits, above the lower ones", symbol="b"),
        Argument("zone", (), "rad or m", "width w of the zone before a limit where it acts, positive", symbol="w"),
        Argument("limit_stiffness", ("q",), _STIFFNESS_UNIT, "of every joint at its limit, not negative", symbol="k"),
    ),
    _limits_energy,
    "U = sum_i k_i d_i^3/(6 w), d_i >= 0 how deep joint i is in the zone before a limit",
    "0 outside the zones. Inside, the torque k d^2/(2 w) and the stiffness k d/w are continuous; beyond the limit both "
    "grow on. A joint without limits: stiffness zero, and any finite limits. Not the controller's limit avoidance, "
    "which is linear from the zone's edge on and bounded.",
)
JOINT_POTENTIALS = (POSTURE, LIMITS)


def term(q: ca.SX, *parameters: ca.SX, potential: JointPotential, part: Part) -> ca.SX:
    """Return energy U, torque -dU/dq or joint stiffness d2U/dq2 of one coordinate."""
    at = ca.SX.sym("q")
    energy = potential.energy(at, *parameters)
    gradient = ca.gradient(energy, at)
    result = {"energy": energy, "torque": -gradient, "joint_stiffness": ca.gradient(gradient, at)}[part]
    return ca.substitute(result, at, q)
