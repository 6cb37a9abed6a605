# SPDX-License-Identifier: MIT
"""CasADi expressions of gravity: potential energy, and what its gradient and Hessian are made of.

U = -g . sum_k m_k c_k with g the acceleration of free fall in base axes [m/s^2] and c_k the bodies' centres of mass.
Joint j moves the first moment of everything beyond it, per unit rate, by

    w_j = a_j x s_j    where it turns: a_j its axis, s_j the first moment about a point on the axis [kg m]
    w_j = m_j a_j      where it slides: m_j the mass of everything beyond it [kg]

so that dU/dq_j = -g . w_j. A turn of a joint i nearer the base takes w_j along, a slide does not, and a joint beyond j
leaves d2U/dq_i dq_j to symmetry: with a_i = 0 for sliding joints

    d2U/dq_i dq_j = -g . (a_i x w_j) = a_i . (g x w_j)    for i on the way from the base to j, else 0.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kinematics import Expressions, PoseRecursion, Section, constant, cross, frame_title


def axes_and_moment_rates(chain: Chain, q: ca.SX) -> Expressions:
    """Return a (6 x number of joints) matrix by rows: 0..2 the axes a_j of turning joints (sliding ones: 0), 3..5
    w_j; below it the first moment (3) of all bodies about the base's origin.
    """
    moved = _MovedMasses(chain, q)
    columns = []
    for joint, axis, mass, moment in zip(chain.joints, moved.axes, moved.masses, moved.moments, strict=True):
        slides = joint.prismatic
        columns.append(ca.vertcat(ca.SX.zeros(3), mass * axis) if slides else ca.vertcat(axis, cross(axis, moment)))
    rows = ca.vec(ca.horzcat(*columns).T)
    return Expressions(ca.densify(ca.vertcat(rows, moved.first_moment)), tuple(moved.sections))


def potential_energy(chain: Chain, first_moment: ca.SX, gravity: ca.SX, base_pose: ca.SX | None = None) -> Expressions:
    """Return U [J]: 0 where the centre of mass is at the height of the base, or for a floating base of the world."""
    if base_pose is not None:
        mass = sum(joint.body.mass for joint in chain.joints)
        first_moment = base_pose[:3, :3] @ first_moment + mass * base_pose[:3, 3]
    return Expressions(ca.SX(-ca.dot(gravity, first_moment)), ())


def in_base_axes(base_pose: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return the acceleration of free fall in the axes of a floating base."""
    return base_pose[:3, :3].T @ gravity


def moment_rate(column: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return dU/dq_j = -g . w_j from a column of :func:`axes_and_moment_rates`."""
    return ca.SX(-ca.dot(gravity, column[3:]))


def covector(column: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return u_j = g x w_j with d2U/dq_i dq_j = a_i . u_j."""
    return cross(gravity, column[3:])


def second_derivative(column: ca.SX, covector: ca.SX) -> ca.SX:
    """Return a_i . u_j."""
    return ca.SX(ca.dot(column[:3], covector))


class _MovedMasses:
    """Axis of each joint, and mass [kg] and first moment [kg m] about its origin of everything beyond it, in base axes.

    ``first_moment`` is that of all joints together, about the base's origin.
    """

    def __init__(self, chain: Chain, q: ca.SX) -> None:
        r = PoseRecursion(chain, q)
        rotations: list[ca.SX] = []
        offsets: list[ca.SX] = []  # from the origin of the joint before
        self.axes: list[ca.SX] = []
        for k in range(chain.base_joints):  # in the base's own axes
            rotations.append(ca.SX.eye(3))
            offsets.append(ca.SX.zeros(3))
            self.axes.append(ca.SX.eye(3)[:, k % 3])
        for index, joint in enumerate(chain.joints[chain.base_joints :], start=chain.base_joints):
            before = rotations[joint.parent] if joint.parent >= 0 else ca.SX.eye(3)
            offset, auxiliary = before @ constant(joint.translation), before @ r.local(index)
            axis, turn = r.axis(index, auxiliary), r.rotations[index]
            if turn is None:
                offset = offset + axis * r.positions[index]
            else:
                auxiliary = auxiliary @ turn
            title = f"{frame_title(chain, index)}: rotation R{index}, in base axes"
            r.sections.append(Section(title, {f"R{index}_": ca.densify(auxiliary)}))
            rotations.append(auxiliary @ r.after(index))
            offsets.append(ca.densify(offset))
            self.axes.append(axis)
        self.masses = [joint.body.mass for joint in chain.joints]
        self.moments = [R @ constant(j.body.moment) for R, j in zip(rotations, chain.joints, strict=True)]
        self.first_moment = ca.SX.zeros(3)
        for index in reversed(range(len(chain.joints))):
            joint, mass = chain.joints[index], self.masses[index]
            moment = self.moments[index] = ca.densify(self.moments[index])
            if index >= chain.base_joints - 1:
                point = f"joint {joint.name}'s origin" if index >= chain.base_joints else "the base link's origin"
                title = f"first moment s{index} [kg m] about {point} of everything beyond it"
                r.sections.append(Section(title, {f"s{index}_": moment}))
            seen = moment + mass * offsets[index]
            if joint.parent >= 0:
                self.masses[joint.parent] += mass
                self.moments[joint.parent] += seen
            else:
                self.first_moment += seen
        self.sections = r.sections
