# SPDX-License-Identifier: MIT
"""CasADi expressions of gravity: potential energy, and the factors of its gradient and Hessian.

The potential energy is U = -g . sum_k m_k c_k with the acceleration of free fall g in base axes [m/s^2] and the centres
of mass c_k of the bodies. Let w_j be the derivative with respect to q_j of the first moment of all bodies:

    w_j = a_j x s_j    revolute joint: axis a_j, first moment s_j of all bodies beyond j about a point on it [kg m]
    w_j = m_j a_j      prismatic joint: axis a_j, mass m_j of all bodies beyond j [kg]

The gradient is dU/dq_j = -g . w_j. A revolute joint i nearer the base rotates w_j; a prismatic one does not change it.
With a_i = 0 for prismatic joints, and by symmetry for joints beyond j, the Hessian is

    d2U/dq_i dq_j = -g . (a_i x w_j) = a_i . (g x w_j)    for i on the way from the base to j, else 0.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Expressions, PoseRecursion, Section, constant, cross, frame_title


def axes_and_moment_rates(chain: Chain, q: ca.SX) -> Expressions:
    """Return axes, moment rates and first moment: 6 entries per joint, row-major, then 3.

    Rows 0..2 are the axes a_j (0 for prismatic joints), rows 3..5 are w_j. The first moment is that of all bodies about
    the base's origin.
    """
    masses = MovedMasses(chain, q)
    columns = []
    for joint, axis, mass, moment in zip(chain.joints, masses.axes, masses.masses, masses.moments, strict=True):
        turning_axis, moment_rate = axis, cross(axis, moment)
        if joint.prismatic:
            turning_axis, moment_rate = ca.SX.zeros(3), mass * axis
        columns.append(ca.vertcat(turning_axis, moment_rate))
    rows = ca.vec(ca.horzcat(*columns).T)
    return Expressions(ca.densify(ca.vertcat(rows, masses.first_moment)), tuple(masses.sections))


def potential_energy(chain: Chain, first_moment: ca.SX, gravity: ca.SX, base_pose: ca.SX | None = None) -> Expressions:
    """Return U [J], 0 where the centre of mass is level with the origin of the base (floating base: of the world).

    ``first_moment`` [kg m] is about the base's origin in the base's axes, ``gravity`` in base axes or the world's.
    """
    if base_pose is None:
        return Expressions(ca.SX(-ca.dot(gravity, first_moment)), ())
    mass = sum(joint.body.mass for joint in chain.joints)
    in_world = base_pose[:3, :3] @ first_moment + mass * base_pose[:3, 3]
    return Expressions(ca.SX(-ca.dot(gravity, in_world)), ())


def moment_rate(column: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return dU/dq_j = -g . w_j from a column of :func:`axes_and_moment_rates`."""
    return ca.SX(-ca.dot(gravity, column[3:]))


def covector(column: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return u_j = g x w_j, where d2U/dq_i dq_j = a_i . u_j."""
    return cross(gravity, column[3:])


def second_derivative(column: ca.SX, covector: ca.SX) -> ca.SX:
    """Return d2U/dq_i dq_j = a_i . u_j."""
    return ca.SX(ca.dot(column[:3], covector))


class MovedMasses:
    """Axis of each joint, and mass [kg] and first moment [kg m] of all bodies beyond the joint, in base axes.

    First moments of joints are about the joint's origin. ``first_moment`` is that of all bodies about the base's
    origin. ``rotations`` are those of the joints' frames, ``offsets`` [m] lead from the parent joint's origin.
    """

    def __init__(self, chain: Chain, q: ca.SX) -> None:
        """Place all joints in base axes, then sum masses and first moments from tips to base."""
        self.rotations: list[ca.SX] = []
        self.offsets: list[ca.SX] = []
        self.axes: list[ca.SX] = []
        self.sections: list[Section] = []
        self._place_outwards(chain, q)
        self.masses = [joint.body.mass for joint in chain.joints]
        self.moments = [R @ constant(j.body.moment) for R, j in zip(self.rotations, chain.joints, strict=True)]
        self.first_moment = ca.SX.zeros(3)
        self._sum_inwards(chain)

    def _place_outwards(self, chain: Chain, q: ca.SX) -> None:
        """Append rotation, offset and axis of each joint; the six joints of a floating base stay at its origin."""
        r = PoseRecursion(chain, q)
        for k in range(chain.base_joints):
            self.rotations.append(ca.SX.eye(3))
            self.offsets.append(ca.SX.zeros(3))
            self.axes.append(ca.SX.eye(3)[:, k % 3])  # along, then about x, y, z
        for index, joint in enumerate(chain.joints[chain.base_joints :], start=chain.base_joints):
            parent = self.rotations[joint.parent] if joint.parent >= 0 else ca.SX.eye(3)
            offset, auxiliary = parent @ constant(joint.translation), parent @ r.rotation_in_parent(index)
            axis, turn = r.axis(index, auxiliary), r.rotations[index]
            if turn is None:
                offset = offset + axis * r.positions[index]
            else:
                auxiliary = auxiliary @ turn
            title = f"{frame_title(chain, index)}: rotation R{index}, in base axes"
            r.sections.append(Section(title, {f"R{index}_": ca.densify(auxiliary)}))
            self.rotations.append(auxiliary @ r.rotation_to_urdf_frame(index))
            self.offsets.append(ca.densify(offset))
            self.axes.append(axis)
        self.sections += r.sections

    def _sum_inwards(self, chain: Chain) -> None:
        """Add masses and first moments of each joint to those of its parent, the outermost joints first.

        Before, they are those of the joint's own body; the sums are complete when they are added to the parent's.
        """
        for index in reversed(range(len(chain.joints))):
            joint, mass = chain.joints[index], self.masses[index]
            moment = ca.densify(self.moments[index])
            self.moments[index] = moment
            if index >= chain.base_joints - 1:
                point = f"joint {joint.name}'s origin" if index >= chain.base_joints else "the base link's origin"
                title = f"first moment s{index} [kg m] of all bodies beyond {point}, about that point"
                self.sections.append(Section(title, {f"s{index}_": moment}))
            about_parent = moment + mass * self.offsets[index]
            if joint.parent >= 0:
                self.masses[joint.parent] += mass
                self.moments[joint.parent] += about_parent
            else:
                self.first_moment += about_parent
