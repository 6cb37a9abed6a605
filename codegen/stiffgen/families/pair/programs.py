# SPDX-License-Identifier: MIT
"""Programs of energies of two tips in the base: columns of both tips, wrenches and Hessian, then pairs of joints.

With columns Ja, Jb (zero for a joint that does not move the tip), wrenches Fa, Fb and the Hessian K on both twists,

    Kq_ij = Ja_i . ua_j + Jb_i . ub_j       (ua, ub)_j = K (Ja, Jb)_j + load covectors of Fa with Ja_j and Fb with Jb_j

for i <= j: a load covector is linear in the column, so that it vanishes for a joint beyond which there is no such tip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kinematics import (
    Configuration,
    Expressions,
    Frame,
    Section,
    constant,
    cross,
    outward_frames,
)
from stiffgen.core.symbolic.pieces import over_joints, with_base_connection
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, StraightLine
from stiffgen.core.symbolic.stiffness import load_covector, symmetric_from_upper
from stiffgen.families.pair.springs import matrices
from stiffgen.families.pair.tips import TipFrame
from stiffgen.families.springs.parts import Terms

Define = Callable[[TipFrame, TipFrame, tuple[ca.SX, ...], ca.SX], Terms]
"""Function that returns energy, wrenches (12) and Hessian (12x12).

Arguments: frames of both tips relative to the base link's origin, parameters, and that origin.
"""


def _tip_frames(chain: Chain, frames: Sequence[Frame], tool_poses: ca.SX | None) -> list[TipFrame]:
    """Return rotation and origin of both tips, or of the tools mounted there."""
    tools = (None, None) if tool_poses is None else matrices(tool_poses)
    found = []
    for tip, tool in zip(chain.tips, tools, strict=True):
        rotation, origin = constant(tip.rotation), constant(tip.translation)
        if tool is not None:
            rotation, origin = rotation @ tool[:3, :3], origin + rotation @ tool[:3, 3]
        R, p, _ = frames[tip.joint]
        found.append((ca.densify(R @ rotation), ca.densify(p + R @ origin)))
    return found


def _columns(chain: Chain, frames: Sequence[Frame], tip: Tip, point: ca.SX) -> ca.SX:
    """Return the tip's hybrid columns (6 x number of joints): zero for joints that do not move it."""
    columns, index = ca.SX(6, len(chain.joints)), tip.joint
    while index >= 0:
        joint, (_, origin, axis) = chain.joints[index], frames[index]
        linear, angular = (axis, ca.SX(3, 1)) if joint.prismatic else (cross(axis, point - origin), axis)
        columns[:, index] = ca.vertcat(linear, angular)
        index = joint.parent
    return columns


def terms(chain: Chain, *arguments: ca.SX, define: Define, parts: str) -> Expressions:
    """Return the quantities that ``parts`` selects, row-major, stacked.

    Args:
        chain: joints on the paths to both tips.
        arguments: pose of a floating base, q, tool poses at run time, and the parameters of the energy.
        define: energy.
        parts: "J" selects the columns of both tips, "U" the energy, "F" the wrenches, "K" the Hessian.

    """
    values = list(arguments)
    base_pose = values.pop(0) if chain.floating else None
    q, tools = values.pop(0), values.pop(0) if chain.runtime_tool else None
    origin = ca.SX.zeros(3)
    if base_pose is not None:  # the base's distance from the world's origin would cost digits of differences
        base_pose, origin = ca.diagcat(base_pose[:3, :3], 1), base_pose[:3, 3]
    recursion, frames = outward_frames(chain, Configuration(q, base_pose))
    tips = _tip_frames(chain, frames, tools)
    sections = [*recursion.sections]
    for tip, letter, (R, p) in zip(chain.tips, "ab", tips, strict=True):
        sections.append(Section(f"pose of {tip.link}: rotation, origin", {f"R{letter}": R, f"p{letter}": p}))
    found = define(tips[0], tips[1], tuple(values), origin)
    K = symmetric_from_upper(found.K)
    columns = [_columns(chain, frames, tip, p) for tip, (_, p) in zip(chain.tips, tips, strict=True)]
    results = {
        "J": ca.vertcat(*(ca.vec(ca.densify(each).T) for each in columns)),
        "U": found.V,
        "F": found.F,
        "K": ca.vec(ca.densify(K).T),
    }
    sections.extend(found.sections)
    if "K" in parts:  # its entries stand in both triangles
        sections.append(Section("covariant Hessian", {"hessian": K}, shared=True))
    return Expressions(ca.densify(ca.vertcat(*(results[part] for part in parts))), tuple(sections))


@dataclass(frozen=True)
class EnergyOfTips:
    """Energy of two tips: function, and arguments of its kernels."""

    define: Define
    inputs: tuple[Argument, ...]

    def quantity(self, chain: Chain, result: Argument, part: str) -> Program:
        """Return the program of energy, wrenches or Hessian (:func:`terms`)."""
        headings = {"U": "energy U", "F": "wrenches F = dU on A and B", "K": "covariant Hessian of U on both twists"}
        return (self._step(chain, (result.array(chain),), part, headings[part]),)

    def _step(self, chain: Chain, outputs: tuple[Array, ...], parts: str, heading: str) -> StraightLine:
        arguments = tuple(argument.array(chain) for argument in self.inputs)
        expressions = partial(terms, define=self.define, parts=parts)
        return StraightLine(outputs, expressions, arguments, heading=heading, columns=2 * ("J" in parts))

    def in_joints(
        self,
        chain: Chain,
        energy: Argument | None = None,
        torque: Argument | None = None,
        joint_stiffness: Argument | None = None,
    ) -> Program:
        """Return the program of energy, torque and joint stiffness, or some, in one pass."""
        m = len(chain.joints)
        # columns of both tips, their wrenches (12) and Hessian (12, 12)
        Ja, Jb, F, K = Array("Ja", (6, m)), Array("Jb", (6, m)), Array("F", (12,)), Array("K", (12, 12))
        parts = "J" + "U" * bool(energy) + "F" + "K" * bool(joint_stiffness)  # letters of terms()
        arrays_of: dict[str, tuple[Array, ...]] = {"J": (Ja, Jb), "F": (F,), "K": (K,)}
        if energy:
            arrays_of["U"] = (energy.array(chain),)
        outputs = tuple(array for part in parts for array in arrays_of[part])
        program: Program = (self._step(chain, outputs, parts, heading="columns and wrenches of both tips"),)
        if torque:
            program += over_joints(chain, torque, lambda output: (_torque(Ja, Jb, F, output),))
        if joint_stiffness:
            program += over_joints(
                chain, joint_stiffness, lambda output: _tangent(chain, Ja, Jb, F, K, output), mirror=True
            )
        return program


def _force(a: ca.SX, b: ca.SX, F: ca.SX) -> ca.SX:
    """Return the generalised force dU/dq_j of a joint: a . Fa + b . Fb from its columns and the wrenches (12)."""
    return ca.SX(ca.dot(a, F[:6]) + ca.dot(b, F[6:]))


def _torque(Ja: Array, Jb: Array, F: Array, output: Array) -> Map:
    """Return the step of the torques -dU/dq."""
    operands = Operand(Ja, "j"), Operand(Jb, "j"), Operand(F, "")
    comment = "torque_j = -(Ja_j . Fa + Jb_j . Fb)"
    return Map(comment, Over.JOINTS, Operand(output, "j"), operands, lambda a, b, F: ca.SX(-1 * _force(a, b, F)))


def _tangent(chain: Chain, Ja: Array, Jb: Array, F: Array, K: Array, output: Array) -> Program:
    """Return the steps of the joint stiffness over the moving joints, by the formulas of the module's head."""
    ua, ub = Array("ua", Ja.shape), Array("ub", Jb.shape)
    columns_and_wrenches = Operand(Ja, "j"), Operand(Jb, "j"), Operand(F, "")

    def covectors(u: Array, *, of_b: bool) -> Map:
        """Return the step of the covectors of one tip."""
        rows = slice(6, 12) if of_b else slice(0, 6)  # of F, and of K on the twists of both tips

        def covector(a: ca.SX, b: ca.SX, F: ca.SX, K: ca.SX) -> ca.SX:
            load = load_covector("hybrid", b if of_b else a, F[rows])
            return ca.densify(symmetric_from_upper(K)[rows, :] @ ca.vertcat(a, b) + load)

        comment = f"{u.name}_j: rows of K (Ja, Jb)_j, and the load covector"
        return Map(comment, Over.JOINTS, Operand(u, "j"), (*columns_and_wrenches, Operand(K, "")), covector)

    def pairs(into: Array) -> Program:
        operands = Operand(Ja, "i"), Operand(Jb, "i"), Operand(ua, "j"), Operand(ub, "j")
        comment = "Kq_ij = Ja_i . ua_j + Jb_i . ub_j for i<=j, mirrored"
        return (Map(comment, Over.UPPER, Operand(into, "ij"), operands, _sum_of_products, mirror=True),)

    stiffness = with_base_connection(chain, output, pairs, operands=columns_and_wrenches, generalised_force=_force)
    return covectors(ua, of_b=False), covectors(ub, of_b=True), *stiffness


def _sum_of_products(a: ca.SX, b: ca.SX, ua: ca.SX, ub: ca.SX) -> ca.SX:
    """Return a . ua + b . ub."""
    return ca.SX(ca.dot(a, ua) + ca.dot(b, ub))
