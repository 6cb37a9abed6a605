# SPDX-License-Identifier: MIT
"""Derivative of the torque that holds a robot at rest, dU/dq - J^T F, with the energy U of gravity.

Wrenches (f, m) on the tips are constant in base axes (hybrid form); gravity is a constant force at every body. A
constant force f at a point with the arm r from joint j and the moments contribute, with the axes a of the joints,

    U_ij = a_i . u_j            i on the way from the base to j       u_j = sum of f x (a_j x r)
    D_ij = a_j . t_i            j strictly on the way to i            t_i = u_i + (sum of m) x a_i

to the derivative of torque i with respect to q_j, else 0. All sums run over the bodies and tips beyond the joint. A
prismatic joint has f x a_j in place of f x (a_j x r), and 0 in place of a_i.

A floating base moves as one body, so that the second formula holds for all pairs of its joints, which slide along x, y,
z, then rotate about x, y, z. The first one agrees with it where u_j of a rotation includes a_j x N, N the moment about
the base's origin, and where columns have three more entries: e_i of a slide i, and a_j x f of a rotation j.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import GRAVITY, Argument
from stiffgen.core.symbolic.kinematics import Expressions, Section, constant, cross
from stiffgen.core.symbolic.pieces import in_base_axes, over_joints
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, StraightLine
from stiffgen.families.dynamics.gravity import MovedMasses


class _Loads:
    """Forces and moments beyond every joint: weights, and wrenches on the tips.

    ``forces`` holds pairs of a force and its first moment (arm times 1, or masses times arms) per joint, about the
    joint's origin; ``moments`` and ``sums`` hold the sums of moments and of forces.
    """

    def __init__(self, chain: Chain, masses: MovedMasses, wrenches: ca.SX, gravity: ca.SX, tools: ca.SX | None) -> None:
        self.forces = [[(gravity, moment)] for moment in masses.moments]
        self.sums = [mass * gravity for mass in masses.masses]
        self.moments = [ca.SX.zeros(3)] * len(chain.joints)
        tips = len(chain.tips)
        wrench_of = ca.reshape(ca.densify(wrenches).T, 6, tips)  # a column per tip
        for k, tip in enumerate(chain.tips):
            point = constant(tip.translation)  # of the wrench, in the frame of the tip's joint
            if tools is not None:
                tool_pose = ca.reshape(ca.densify(tools).T, 16, tips)[:, k]  # row by row
                point = point + constant(tip.rotation) @ tool_pose[3:12:4]
            arms = self._add_wrench(chain, masses, tip.joint, point, wrench_of[:, k])
            title = f"arms r{k}_j to tip {tip.link}, from joint j's origin" if tip.link else f"arms r{k}_j to the tip"
            masses.sections.append(Section(title, {f"r{k}_{joint}_": arm for joint, arm in arms.items()}))

    def _add_wrench(
        self, chain: Chain, masses: MovedMasses, joint: int, point: ca.SX, wrench: ca.SX
    ) -> dict[int, ca.SX]:
        """Add a wrench at a point in the frame of a ``joint`` to all joints that carry the point, outermost first.

        Return the arms [m] from the origins of these joints to the point, in base axes.
        """
        force, moment = wrench[:3], wrench[3:]
        arms, arm = dict[int, ca.SX](), masses.rotations[joint] @ point
        while joint >= 0:
            arm = ca.densify(arm)
            arms[joint] = arm
            self.forces[joint].append((force, arm))
            self.sums[joint] += force
            self.moments[joint] = self.moments[joint] + moment
            arm = arm + masses.offsets[joint]  # from the parent joint's origin
            joint = chain.joints[joint].parent
        return arms


def columns_and_covectors(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return columns S, covectors u and t of all joints, row-major, stacked.

    S and u have 3 rows, or 6 on a floating base; t has 3. ``arguments`` are q, poses of tools where they are arguments,
    wrenches and gravity in base axes.
    """
    q, *tools, wrenches, gravity = arguments
    masses = MovedMasses(chain, q)
    loads = _Loads(chain, masses, wrenches, gravity, tools[0] if tools else None)
    columns, u_columns, t_columns = [], [], []
    used: list[list[bool]] = []  # rows in which a column of this joint or of one before it is not always zero
    for index, joint in enumerate(chain.joints):
        column, u, t = _of_joint(chain, index, masses.axes[index], loads)
        used_before = used[joint.parent] if joint.parent >= 0 else column.numel() * [False]
        entries = zip(used_before, ca.vertsplit(column), strict=True)
        used.append([before or not entry.is_zero() for before, entry in entries])
        columns.append(column)
        u_columns.append(_only(u, used[index]))  # read by S_i of this joint and those before it
        t_columns.append(_only(t, used_before[-3:]))  # read by a_j of the joints before it
    rows = ca.vertcat(*(ca.vec(ca.densify(ca.horzcat(*each)).T) for each in (columns, u_columns, t_columns)))
    return Expressions(rows, tuple(masses.sections))


def _of_joint(chain: Chain, index: int, axis: ca.SX, loads: _Loads) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return column S, covectors u and t of a joint with this axis, by the formulas of the module's head."""
    joint, zero = chain.joints[index], ca.SX.zeros(3)
    force, of_base = loads.sums[index], index < chain.base_joints
    if joint.prismatic:
        column, u = zero, cross(force, axis)
        t = u
    else:
        column = axis
        u = sum((cross(f, cross(axis, arm)) for f, arm in loads.forces[index]), zero)
        t = u + cross(loads.moments[index], axis)
    if not chain.floating:
        return column, u, t
    # Three more entries: those of S are e_i of a slide i of the base, those of u are a_j x f of a rotation j of it.
    slide = axis if of_base and joint.prismatic else zero
    push = zero
    if of_base and not joint.prismatic:
        moment_about_base = sum((cross(arm, f) for f, arm in loads.forces[index]), loads.moments[index])
        u, push = u + cross(axis, moment_about_base), cross(axis, force)
    return ca.vertcat(slide, column), ca.vertcat(push, u), t


def _only(vector: ca.SX, rows: list[bool]) -> ca.SX:
    """Return the vector with zeros in the rows that meet zeros alone."""
    return ca.vertcat(*(entry if row else ca.SX(0) for entry, row in zip(ca.vertsplit(vector), rows, strict=True)))


def static_torque_derivatives(chain: Chain, result: Argument, inputs: tuple[Argument, ...]) -> Program:
    """Return the program of d(dU/dq - J^T F)/dq: one dot product per pair of joints on the way to each other.

    ``inputs`` are the configuration arguments and the wrench, or the wrenches on all tips.
    """
    *configuration, wrench = (each for each in inputs if not each.is_base_pose)
    m, size = len(chain.joints), 6 if chain.floating else 3
    # columns of the joints; covectors of what they carry; arms of the joints' own torques
    S, u, t = Array("S", (size, m)), Array("u", (size, m)), Array("t", (3, m))
    turning_wrench, F = in_base_axes(chain, wrench)
    turning_gravity, g = in_base_axes(chain, GRAVITY)
    arguments = (*(argument.array(chain) for argument in configuration), F, g)
    heading = "columns S; covectors u for joints beyond the joint of a torque, and t for joints before it"
    recursion = StraightLine((S, u, t), columns_and_covectors, arguments, heading=heading, columns=3)
    serial = all(joint.parent == index - 1 for index, joint in enumerate(chain.joints))

    def steps(output: Array) -> Program:
        pair = Operand(output, "ij")
        beyond, before = (Over.UPPER, Over.STRICTLY_LOWER) if serial else (Over.ON_THE_WAY, Over.BEYOND)
        branches = Map("joints of different branches: 0", Over.UPPER, pair, (), lambda: ca.SX(0), mirror=True)

        def product(outer: ca.SX, column: ca.SX) -> ca.SX:
            """Return the outer joint's arm times the column's axis, its last three entries."""
            return ca.SX(ca.dot(outer, column[size - 3 :]))

        return (
            recursion,
            *(() if serial else (branches,)),
            Map(f"D_ij = S_i . u_j for {beyond}", beyond, pair, (Operand(S, "i"), Operand(u, "j")), ca.dot),
            Map(f"D_ij = t_i . a_j for {before}", before, pair, (Operand(t, "i"), Operand(S, "j")), product),
        )

    return *turning_wrench, *turning_gravity, *over_joints(chain, result, steps)
