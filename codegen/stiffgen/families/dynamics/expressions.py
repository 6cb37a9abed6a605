# SPDX-License-Identifier: MIT
"""CasADi expressions of the joint-space mass matrix and of the bias forces.

Mass matrix (composite-rigid-body algorithm: Featherstone, Rigid Body Dynamics Algorithms, 2008). M_ij = J_i . h_j for
every joint i on the way from the base to joint j, where h_j = I^c_j J_j is the momentum of all bodies beyond joint j
at a unit rate of joint j. With z along every joint's axis, h_j is a column of the composite inertia I^c_j, and the
product J_i . h_j is one entry of h_j in the axes of link i. Three choices keep the expressions short:

* Composite inertias are expressed in the axes of their link, about its joint's origin. The step to the parent link is
  then a rotation about z.
* The position of the first joint and the pose of its frame in the base do not enter.
* The part of a link's inertia that the motion of its joint does not affect is added to the parent link (base inertial
  parameters: Gautier and Khalil 1990). For a revolute joint this part is the mass, the first moment along the axis and
  the inertia of a rod along the axis; for a prismatic joint it is the inertia tensor. It is added once, with 50 digits.

Bias forces (recursive Newton-Euler algorithm: Luh, Walker and Paul 1980). C(q, dq) dq + g(q) results from one pass
outwards for rates and accelerations and one pass inwards for forces, in the same axes and with the same parameters.
Moving inertia to the parent link does not change the result. Gravity enters as an upward acceleration of the base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from stiffgen.core.robot.chain import Chain, Joint, RigidBody
from stiffgen.core.robot.geometry import Inertia, Pose, aligning_rotation, mpf
from stiffgen.core.symbolic.kinematics import Configuration, Expressions, Section, constant, cross, joint_position

_ALONG = ca.SX(ca.sparsify(ca.DM([0, 0, 1])))
"""Axis of every joint, in the axes of its link."""


@dataclass(frozen=True)
class _Link:
    """Moving link, in axes with z along its joint's axis.

    ``rotation`` and ``translation`` [m] are the pose in the parent link at zero position. ``mass`` [kg], ``moment``
    (first moment [kg m]) and ``tensor`` (about the joint's origin [kg m^2]) are the base inertial parameters. Zeros are
    structural.
    """

    rotation: ca.SX
    translation: ca.SX
    mass: float
    moment: ca.SX
    tensor: ca.SX


def mass_matrix(chain: Chain, q: ca.SX) -> Expressions:
    """Return the mass matrix of a chain whose moving joints are all revolute: m*m entries, row-major.

    Every h_j is transformed from link to link towards the base. This needs the fewest operations, but the length of the
    code grows with the square of the number of joints.
    """
    links, _ = _links(chain)
    sections: list[Section] = []
    turns = _turns(chain, q, sections)
    result = ca.SX.zeros(len(links), len(links))
    for index, (linear, angular) in enumerate(_momenta(chain, links, turns, q, sections)):
        values: dict[str, ca.SX] = {}
        result[index, index] = angular[2]
        link, inner = links[index], chain.joints[index].parent
        while inner >= 0:  # the momentum in the axes of link ``inner``; its joint turns about z
            linear, angular = ca.densify(link.rotation @ linear), ca.densify(link.rotation @ angular)
            angular = angular + cross(link.translation, linear)
            turn = turns[inner]
            if turn is not None:
                linear, angular = _turned(linear, turn), _turned(angular, turn)
            values |= {f"l{index}_{inner}_": linear, f"a{index}_{inner}_": angular}
            result[inner, index] = result[index, inner] = angular[2]
            link, inner = links[inner], chain.joints[inner].parent
        title = f"momentum h{index} of all bodies beyond joint {chain.joints[index].name}, in the axes of links k"
        sections.append(Section(f"{title}: linear l{index}_k, angular a{index}_k", values))
    return Expressions(ca.densify(ca.vec(result)), tuple(sections))


def columns_and_momenta(chain: Chain, q: ca.SX) -> Expressions:
    """Return Jacobian columns above momenta (12 x number of joints): rows 0..5 J_j, rows 6..11 h_j, linear first.

    J_j and h_j refer to the origin and the link axes of the first joint on the way to joint j. The length of the code
    is linear in the number of joints; a loop computes the products J_i . h_j.
    """
    links, _ = _links(chain)
    sections: list[Section] = []
    turns = _turns(chain, q, sections)
    frames = _frames(chain, links, turns, q, sections)
    momenta = _momenta(chain, links, turns, q, sections)
    stacked = []
    for joint, (axes, origin), (linear, angular) in zip(chain.joints, frames, momenta, strict=True):
        axis = axes[:, 2]
        column = ca.vertcat(axis, ca.SX.zeros(3)) if joint.prismatic else ca.vertcat(cross(origin, axis), axis)
        linear, angular = ca.densify(axes @ linear), ca.densify(axes @ angular)
        if joint.parent >= 0 and chain.joints[joint.parent].parent < 0 and not joint.prismatic:
            # J_j . h_j does not depend on the linear part of h_j. J_i . h_j of the first joint i depends on the
            # component along its axis (prismatic) or on the components across its axis (revolute).
            is_sliding = chain.joints[joint.parent].prismatic
            linear = linear * (_ALONG if is_sliding else 1 - _ALONG)
        stacked.append(ca.vertcat(column, linear, angular + cross(origin, linear)))
    return Expressions(ca.densify(ca.horzcat(*stacked)), tuple(sections))


def bias_forces(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return the joint forces at constant rates: Coriolis, centrifugal and gravity forces.

    ``arguments`` are the base pose (floating base only), q, velocity and gravity. The rates of a floating base are its
    body twist; its forces are a wrench at the base link's origin in the base link's axes.
    """
    return joint_forces(chain, *arguments, ca.SX(chain.dof, 1))


def joint_forces(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return the joint forces of a motion; the arguments are those of ``bias_forces``, and the joints' acceleration.

    The rate of a floating base's twist is zero.
    """
    *configuration_arguments, velocity, gravity, acceleration = arguments
    configuration = Configuration.of(chain, configuration_arguments)
    q, (base_rotation, _), base_joints = configuration.q, configuration.base, chain.base_joints
    links, base_link = _links(chain)
    sections: list[Section] = []
    rates = [joint.multiplier * velocity[joint.coordinate] for joint in chain.joints]
    turns: list[_Turn] = [
        None if joint.prismatic or index < base_joints else _sine_cosine(chain, joint, q)
        for index, joint in enumerate(chain.joints)
    ]
    values = {f"{letter}{k}": turn[i] for k, turn in enumerate(turns) if turn for i, letter in enumerate("sc")}
    sections.append(Section("sine and cosine of each joint angle", values))
    zero = ca.SX(3, 1)
    upward = ca.densify(-(base_rotation.T @ gravity))  # a base that accelerates upwards feels gravity
    # Per link, in its axes: angular velocity, its rate, acceleration of the origin; force and moment for this motion.
    motions: list[tuple[ca.SX, ca.SX, ca.SX]] = []
    wrenches: list[tuple[ca.SX, ca.SX]] = []
    if base_link is not None:
        # The rate of the base's twist is zero in the base's axes, so that the base's origin accelerates by w x v.
        angular = velocity[3:6]
        motions = base_joints * [(angular, zero, upward + cross(angular, velocity[:3]))]
        wrenches = base_joints * [_rate_of_momentum(base_link, *motions[0])]
    for index, (joint, link, turn, rate) in enumerate(zip(chain.joints, links, turns, rates, strict=True)):
        if index < base_joints:
            continue
        angular, angular_rate, linear = motions[joint.parent] if joint.parent >= 0 else (zero, zero, upward)
        shift, relative = _shift(chain, joint, link, q), rate * _ALONG
        joint_acceleration = joint.multiplier * acceleration[joint.coordinate] * _ALONG
        linear = linear + cross(angular_rate, shift) + cross(angular, cross(angular, shift))
        angular, angular_rate, linear = (  # until here in the parent's axes
            _into_link(each, link.rotation, turn) for each in (angular, angular_rate, linear)
        )
        if joint.prismatic:
            linear = linear + 2 * cross(angular, relative) + joint_acceleration
        else:
            angular, angular_rate = angular + relative, angular_rate + cross(angular, relative) + joint_acceleration
        motion = ca.densify(angular), ca.densify(angular_rate), ca.densify(linear)
        title = f"link of joint {joint.name}: angular velocity w{index} and its rate e{index}, acceleration a{index}"
        letters = zip(("w", "e", "a"), motion, strict=True)
        sections.append(Section(title, {f"{letter}{index}_": each for letter, each in letters}))
        motions.append(motion)
        wrenches.append(_rate_of_momentum(link, *motion))
    forces = _joint_forces(chain, links, turns, q, wrenches, sections)
    return Expressions(ca.densify(ca.vertcat(*forces)), tuple(sections))


def _joint_forces(
    chain: Chain,
    links: list[_Link],
    turns: list[_Turn],
    q: ca.SX,
    wrenches: list[tuple[ca.SX, ca.SX]],
    sections: list[Section],
) -> list[ca.SX]:
    """Add up the wrenches of all links inwards; return the wrenches' components along the joints' axes.

    ``wrenches`` holds a force and a moment for each link, and is altered: each link adds its own to its parent's. The
    joints of a floating base carry one link, the last of them, whose wrench is the force of all six.
    """
    base_joints = chain.base_joints
    forces: list[ca.SX] = [ca.SX()] * len(links)
    for index in reversed(range(base_joints, len(links))):
        joint, link = chain.joints[index], links[index]
        force, moment = wrenches[index]
        forces[index] = (force if joint.prismatic else moment)[2]
        if joint.parent < 0:
            continue
        force, moment = (_out_of_link(each, link.rotation, turns[index]) for each in (force, moment))
        moment = moment + cross(_shift(chain, joint, link, q), force)
        title = f"force f{index} and moment n{index} of all links from joint {joint.name} outwards, in parent's axes"
        sections.append(Section(title, {f"f{index}_": ca.densify(force), f"n{index}_": ca.densify(moment)}))
        outer_force, outer_moment = wrenches[joint.parent]
        wrenches[joint.parent] = outer_force + force, outer_moment + moment
    if base_joints:
        forces[:base_joints] = [each for part in wrenches[base_joints - 1] for each in ca.vertsplit(part)]
    return forces


def _rate_of_momentum(link: _Link, angular: ca.SX, angular_rate: ca.SX, linear: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the force on a link and the moment about its origin that cause its motion (Newton, Euler).

    ``angular`` is the angular velocity, ``angular_rate`` its rate, ``linear`` the acceleration of the origin.
    """
    moment_rate = cross(angular, link.moment)
    force = link.mass * linear + cross(angular_rate, link.moment) + cross(angular, moment_rate)
    moment = link.tensor @ angular_rate + cross(angular, link.tensor @ angular) + cross(link.moment, linear)
    return force, moment


def _shift(chain: Chain, joint: Joint, link: _Link, q: ca.SX) -> ca.SX:
    """Return the position of a link's origin in the parent link [m]."""
    if not joint.prismatic:
        return link.translation
    return link.translation + link.rotation[:, 2] * joint_position(chain, joint, q)


def _into_link(vector: ca.SX, rotation: ca.SX, turn: _Turn) -> ca.SX:
    """Rotate a vector from the axes of a link's parent to the axes of the link."""
    at_zero = rotation.T @ vector
    return ca.densify(at_zero if turn is None else _turned(at_zero, (-turn[0], turn[1])))


def _out_of_link(vector: ca.SX, rotation: ca.SX, turn: _Turn) -> ca.SX:
    """Rotate a vector from the axes of a link to the axes of its parent."""
    return ca.densify(rotation @ (vector if turn is None else _turned(vector, turn)))


_Turn = tuple[ca.SX, ca.SX] | None
"""Sine and cosine of a joint's angle; None for a prismatic joint, or where the result does not depend on the angle."""


def _turns(chain: Chain, q: ca.SX, sections: list[Section]) -> list[_Turn]:
    """Return the turn of every joint on which the mass matrix depends, and add their section."""
    section = Section("sine and cosine of each joint angle")
    turns: list[_Turn] = []
    for index, joint in enumerate(chain.joints):
        if joint.prismatic or joint.parent < 0 or index < chain.base_joints:
            turns.append(None)
            continue
        sine, cosine = _sine_cosine(chain, joint, q)
        section.values |= {f"s{index}": sine, f"c{index}": cosine}
        turns.append((sine, cosine))
    sections.append(section)
    return turns


def _sine_cosine(chain: Chain, joint: Joint, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    position = joint_position(chain, joint, q)
    return ca.sin(position), ca.cos(position)


def _frames(
    chain: Chain, links: list[_Link], turns: list[_Turn], q: ca.SX, sections: list[Section]
) -> list[tuple[ca.SX, ca.SX]]:
    """Return axes (z along the joint's axis) and origin of each joint at zero position, in the first link."""
    frames: list[tuple[ca.SX, ca.SX]] = []
    link_frames: list[tuple[ca.SX, ca.SX]] = []  # the same, turned by the joint's angle
    parents = {joint.parent for joint in chain.joints}
    for index, (joint, link, turn) in enumerate(zip(chain.joints, links, turns, strict=True)):
        if joint.parent < 0:
            axes, origin = ca.SX.eye(3), ca.SX.zeros(3)
        else:
            axes, origin = link_frames[joint.parent]
            origin = origin + axes @ link.translation
            axes = axes @ link.rotation
            if joint.prismatic:
                origin = origin + axes[:, 2] * joint_position(chain, joint, q)
        link_axes = axes
        if turn is not None:
            s, c = turn
            link_axes = ca.horzcat(c * axes[:, 0] + s * axes[:, 1], c * axes[:, 1] - s * axes[:, 0], axes[:, 2])
        if index in parents:
            values = {f"R{index}_": ca.densify(link_axes), f"p{index}_": ca.densify(origin)}
            sections.append(
                Section(f"link of joint {joint.name}: axes R{index}, origin p{index}, in the first link", values)
            )
        frames.append((axes, origin))
        link_frames.append((link_axes, origin))
    return frames


def _momenta(
    chain: Chain, links: list[_Link], turns: list[_Turn], q: ca.SX, sections: list[Section]
) -> list[tuple[ca.SX, ca.SX]]:
    """Return the momentum (linear, angular) of all bodies beyond each joint at a unit rate of the joint.

    Momenta are about the joint's origin, in the joint's axes at zero position. Composite mass, first moment m and
    inertia I about the joint's origin are added up from the tips inwards.
    """
    beyond = [(link.mass, link.moment, link.tensor) for link in links]
    momenta: list[tuple[ca.SX, ca.SX]] = [(ca.SX(), ca.SX())] * len(links)
    for index in reversed(range(len(links))):
        joint, link = chain.joints[index], links[index]
        mass, moment, tensor = beyond[index]  # in the link's axes
        turn = turns[index]
        if turn is not None:  # to the link's axes at the zero position of its joint
            moment, tensor = _turned(moment, turn), _turned_tensor(tensor, turn)
        upper = {f"I{index}_{r}{c}": tensor[r, c] for r in range(3) for c in range(r, 3)}
        title = f"all links from joint {joint.name} outwards: first moment m{index} [kg m], inertia I{index} [kg m^2]"
        sections.append(Section(title, {f"m{index}_": ca.densify(moment), **upper}))
        if joint.prismatic:  # velocity z at every point: m z, and the first moment x z
            linear, angular = mass * _ALONG, ca.vertcat(moment[1], -moment[0], 0)
        else:  # angular velocity z: z x the first moment, and I z
            linear, angular = ca.vertcat(-moment[1], moment[0], 0), tensor[:, 2]
        if joint.parent < 0:  # the components that no parent link needs are zero
            linear, angular = _ALONG * linear, _ALONG * angular
        momenta[index] = linear, angular
        if joint.parent >= 0:
            shift = _shift(chain, joint, link, q)
            moment, tensor = link.rotation @ moment, _symmetric(link.rotation @ tensor @ link.rotation.T)
            moment, tensor = _shifted(mass, moment, tensor, shift)
            outer = beyond[joint.parent]
            beyond[joint.parent] = outer[0] + mass, outer[1] + moment, outer[2] + tensor
    return momenta


def _turned(vector: ca.SX, turn: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Rotate a vector about z by the angle with this sine and cosine."""
    (s, c), (x, y, z) = turn, ca.vertsplit(vector)
    return ca.vertcat(c * x - s * y, s * x + c * y, z)


def _turned_tensor(tensor: ca.SX, turn: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Rotate an inertia tensor about z."""
    s, c = turn
    xx, xy, xz, yy, yz, zz = (tensor[r, k] for r in range(3) for k in range(r, 3))
    # c^2 xx - 2 s c xy + s^2 yy = xx - s moved; the other entries likewise, with fewer operations than R I R^T
    moved, product = s * (xx - yy) + 2 * (c * xy), c * (xx - yy) - 2 * (s * xy)
    upper = ca.SX(3, 3)
    upper[0, 0], upper[1, 1], upper[2, 2] = xx - s * moved, yy + s * moved, zz
    upper[0, 1] = xy + s * product
    upper[0, 2], upper[1, 2] = c * xz - s * yz, s * xz + c * yz
    return ca.triu2symm(upper)


def _shifted(mass: float, moment: ca.SX, tensor: ca.SX, shift: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Shift first moment and inertia of a body to a new reference point; ``shift`` points from new to old (Steiner)."""
    new_moment = moment + mass * shift if mass else moment
    outer = moment @ shift.T + shift @ new_moment.T
    steiner = ca.dot(shift, moment + new_moment) * ca.SX.eye(3) - outer
    return new_moment, _symmetric(tensor + steiner)


def _symmetric(matrix: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(matrix))


def _links(chain: Chain) -> tuple[list[_Link], _Link | None]:
    """Return the links of all joints, and the base link if the base floats.

    Inertia that the motion of a joint does not affect is added to the parent link.
    """
    joints = chain.joints
    aligned = [Pose.turned(aligning_rotation(joint.axis)) for joint in joints]  # link axes in the joint's frame
    poses = []
    for joint, axes in zip(joints, aligned, strict=True):
        parent_axes = aligned[joint.parent] if joint.parent >= 0 else Pose.identity()
        poses.append(parent_axes.inverse() @ Pose.translated(joint.translation) @ Pose.turned(joint.rotation) @ axes)
    bodies = [_inertia(joint.body).seen_from(axes.inverse()) for joint, axes in zip(joints, aligned, strict=True)]
    links: list[_Link] = []
    base_link = None
    for index in reversed(range(len(joints))):  # children first: each passes its remainder on to its parent's body
        joint, total = joints[index], bodies[index]
        if index == chain.base_joints - 1:
            mass, moment, tensor = total.rounded()
            base_link = _Link(ca.SX.eye(3), ca.SX.zeros(3), mass, constant(moment), constant(tensor))
        remainder = _insensitive(total, prismatic=joint.prismatic)
        if joint.parent >= 0:
            bodies[joint.parent] += remainder.seen_from(poses[index])
        rotation, translation = poses[index].rounded()
        mass, moment, tensor = (total - remainder).rounded(scale=total)
        links.append(_Link(constant(rotation), constant(translation), mass, constant(moment), constant(tensor)))
    return links[::-1], base_link


def _insensitive(body: Inertia, *, prismatic: bool) -> Inertia:
    """Return the part of a body's inertia that does not depend on the position of its joint (about or along z)."""
    no_inertia = Inertia.zero()
    if prismatic:
        return replace(no_inertia, tensor=body.tensor)
    (zero, *_), yy = no_inertia.moment, body.tensor[1][1]
    rod = ((yy, zero, zero), (zero, yy, zero), (zero, zero, zero))
    return Inertia(body.mass, (zero, zero, body.moment[2]), rod)


def _inertia(body: RigidBody) -> Inertia:
    xx, xy, xz, yy, yz, zz = map(mpf, body.tensor)
    return Inertia(mpf(body.mass), tuple(map(mpf, body.moment)), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
