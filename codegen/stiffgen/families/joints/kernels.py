# SPDX-License-Identifier: MIT
"""Potentials of the joint positions: a spring towards a posture, and a repulsion from joint limits.

A spring at the tip of a redundant arm leaves motions without any restoring torque; a potential of q adds one. The sum
stays conservative: energies, torques and joint stiffnesses of all potentials add up. A potential is defined by its
energy U(q) [J] alone; the torque -dU/dq and the joint stiffness d2U/dq2 are its derivatives.

    posture   U = sum_i k_i (q_i - r_i)^2/2                  r the posture at rest
    limits    U = sum_i k_i (d+_i^3 + d-_i^3)/(6 w)          d+ = max(0, q - (upper - w)), d- = max(0, lower + w - q)

d is the depth of a joint in the zone of width w before a limit. Inside the zone the torque k d^2/(2 w) points away from
the limit, and the stiffness k d/w rises from 0 at the edge of the zone to k at the limit. Both are continuous. (A
linear spring that starts at the edge of the zone would have a discontinuous stiffness.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument, Q
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, pruned
from stiffgen.core.symbolic.quantities import Sampling, Uniform
from stiffgen.core.symbolic.steps import Map, SparseSum

Part = Literal["energy", "torque", "joint_stiffness"]


@dataclass(frozen=True)
class JointPotential:
    """Potential of q, a sum over the coordinates.

    ``name`` is the group of the kernels, ``title`` a phrase for their summaries. ``energy`` is the term of one
    coordinate: it takes the joint's position and one value of every parameter. ``equation`` and ``domain`` are the
    formula and the note of the kernels.
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
    """Return the cube of a positive number, else 0; the first two derivatives are continuous."""
    return ca.if_else(depth <= 0, 0, depth**3)


def _limits_energy(q: ca.SX, lower: ca.SX, upper: ca.SX, zone: ca.SX, stiffness: ca.SX) -> ca.SX:
    return stiffness * (_cube(q - (upper - zone)) + _cube((lower + zone) - q)) / (6 * zone)


@dataclass(frozen=True)
class _LimitNear:
    """Limits of which the joints are in turn at or beyond the lower and the upper one.

    In every fourth state chance decides for each limit, so that a joint is also at both or at none.
    """

    is_upper: bool

    def __call__(self, to: Sampling) -> FloatArray:
        """Return values (states, joints)."""
        state, joint = np.indices(to.size)
        is_turn_of_lower = (state + joint) % 2 == 0
        is_turn = ~is_turn_of_lower if self.is_upper else is_turn_of_lower
        is_at = np.where(state % 4 == 3, to.random.random(to.size) < 0.5, is_turn)
        # from the joint to the limit [rad or m]: in the limit's zone or beyond the limit, or before all zones
        near, far = to.random.uniform(-0.2, 0.15, to.size), to.random.uniform(0.5, 1.5, to.size)
        distance = np.where(is_at, near, far)
        return np.asarray(to.values(Q) + (distance if self.is_upper else -distance))


_STIFFNESS_UNIT = "N m/rad or N/m"
POSTURE = JointPotential(
    "posture",
    "the spring that pulls every joint to a posture",
    (
        Argument(
            "posture", ("q",), "rad or m", "joint positions at which the spring is at rest", symbol="r",
            draw=Uniform(-2.0, 2.0), largest="none", turns=True,
        ),
        Argument(
            "posture_stiffness", ("q",), _STIFFNESS_UNIT, "stiffness of every joint, not negative", symbol="k",
            draw=Uniform(0.5, 20.0), largest="none",
        ),
    ),
    _posture_energy,
    "U = sum_i k_i (q_i - r_i)^2/2",
    "Torque and stiffness add to those of a spring at the tip; the sum is conservative.",
)  # fmt: skip
LIMITS = JointPotential(
    "limits",
    "the potential that keeps joints away from their limits",
    (
        Argument(
            "lower", ("q",), "rad or m", "lower limits", symbol="a", draw=_LimitNear(is_upper=False), largest="none",
            turns=True,
        ),
        Argument(
            "upper", ("q",), "rad or m", "upper limits, greater than the lower limits", symbol="b",
            draw=_LimitNear(is_upper=True), largest="none", turns=True,
        ),
        Argument(
            "zone", (), "rad or m", "width w of the zone before a limit, positive", symbol="w",
            draw=Uniform(0.2, 0.4), largest="none",
        ),
        Argument(
            "limit_stiffness", ("q",), _STIFFNESS_UNIT, "stiffness of every joint at its limit, not negative",
            symbol="k", draw=Uniform(50.0, 500.0), largest="none",
        ),
    ),
    _limits_energy,
    "U = sum_i k_i d_i^3/(6 w), d_i >= 0 the depth of joint i in the zone before a limit",
    "U is 0 outside the zones. Inside, the torque k d^2/(2 w) and the stiffness k d/w are continuous, and both grow "
    "further beyond the limit. For a joint without limits, pass zero stiffness and any finite limits. The controller's "
    "limit avoidance is a different law: linear from the edge of the zone, and bounded.",
)  # fmt: skip
JOINT_POTENTIALS = (POSTURE, LIMITS)


def term(q: ca.SX, *parameters: ca.SX, potential: JointPotential, part: Part) -> ca.SX:
    """Return energy U, torque -dU/dq or joint stiffness d2U/dq2 of one coordinate."""
    symbol = ca.SX.sym("q")
    energy = potential.energy(symbol, *parameters)
    gradient = ca.gradient(energy, symbol)
    result = {"energy": energy, "torque": -gradient, "joint_stiffness": ca.gradient(gradient, symbol)}[part]
    return ca.substitute(result, symbol, q)


def program(chain: Chain, potential: JointPotential, part: Part, result: Argument) -> Program:
    """Return the program of energy, torque or joint stiffness of a potential of q; entries of a floating base are 0."""
    candidates = [
        Operand(argument.array(chain), "j" if argument.shape else "") for argument in (Q, *potential.parameters)
    ]
    symbols = [ca.SX.sym(operand.array.name) for operand in candidates]
    of_coordinate = term(*symbols, potential=potential, part=part)
    operands, body = pruned(tuple(zip(candidates, symbols, strict=True)), of_coordinate)  # the stiffness may not read q
    output, base_joints = result.array(chain), chain.base_joints
    symbol, formula = {"energy": ("u", "U"), "torque": ("t", "-dU/dq"), "joint_stiffness": ("d", "d2U/dq2")}[part]
    if part == "torque" and not base_joints:
        return (Map(formula, Over.COORDINATES, Operand(output, "j"), operands, body),)
    terms = Array(symbol, (chain.dof - base_joints,))
    step = Map(f"{formula} per coordinate", Over.COORDINATES, Operand(terms, "j"), operands, body)

    def behind_base(values: ca.SX) -> ca.SX:
        return ca.vertcat(ca.SX.zeros(base_joints), values)

    if part == "joint_stiffness":
        return step, SparseSum("diagonal", output, None, (terms,), lambda values: ca.diag(behind_base(values)))
    comment, total = ("sum", ca.sum1) if part == "energy" else ("zeros for the base, then the joints", behind_base)
    return step, Map(comment, Over.ONCE, Operand(output, ""), (Operand(terms, ""),), total)


def _joint_potential_kernels(potential: JointPotential) -> tuple[Kernel, ...]:
    """Return the kernels of a potential: energy, torque and joint stiffness."""
    energy = Argument("energy", (), "J", "energy U of the potential")
    torque = Argument("torque", ("n",), "N m or N", "-dU/dq: torque that the potential exerts on the joints")
    joint = Argument(
        "joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2 = -d torque/dq, diagonal", symmetric=True
    )  # fmt: skip

    def kernel(result: Argument, summary: str, equation: str, part: Part) -> Kernel:
        steps = partial(program, potential=potential, part=part, result=result)
        inputs = (Q, *potential.parameters)
        return Kernel(
            name=part,
            group=potential.name,
            arguments=inputs,
            results=(result,),
            summary=f"{summary} {potential.title}.",
            equation=equation,
            program=steps,
            note=potential.domain,
            batch=True,
        )

    return (
        kernel(energy, "Energy of", potential.equation, "energy"),
        kernel(torque, "Joint torque of", f"-dU/dq, {potential.equation}", "torque"),
        kernel(joint, "Joint stiffness of", f"d2U/dq2, {potential.equation}", "joint_stiffness"),
    )


JOINT_POTENTIAL_KERNELS = tuple(
    kernel for potential in JOINT_POTENTIALS for kernel in _joint_potential_kernels(potential)
)
"""Kernels of the potentials of the joints."""
