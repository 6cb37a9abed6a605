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
        result[index, index] = angular[2]  # J_j . h_j: the moment about z
        link, inner = links[index], chain.joints[index].parent
        while inner >= 0:
            # from link to its parent ``inner``: its axes, then its origin, then its axes before its joint turned
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
        linear = _read_part(chain, joint, linear)
        stacked.append(ca.vertcat(column, linear, angular + cross(origin, linear)))
    return Expressions(ca.densify(ca.horzcat(*stacked)), tuple(sections))


def _read_part(chain: Chain, joint: Joint, linear: ca.SX) -> ca.SX:
    """Return the linear part of h_j, in the axes of the first joint, without components that no J_i . h_j reads.

    If the parent i of a revolute joint j is the first joint, two products read h_j. J_j . h_j reads no linear part.
    J_i . h_j reads the component along the axis z of i (prismatic), or the components across it (revolute).
    """
    if joint.prismatic or joint.parent < 0 or chain.joints[joint.parent].parent >= 0:
        return linear
    return linear * (_ALONG if chain.joints[joint.parent].prismatic else 1 - _ALONG)


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
    turns = _turns(chain, q, sections, of_first=True)
    upward = ca.densify(-(base_rotation.T @ gravity))  # a base that accelerates upwards feels gravity
    zero = ca.SX(3, 1)
    fixed_base = _LinkMotion(zero, zero, upward)
    motions: list[_LinkMotion] = []
    wrenches: list[_Wrench] = []  # force and moment for the motion of each link alone
    if base_link is not None:
        # The base's twist (v, w) has no rate in the base's axes, so that the base's origin accelerates by w x v.
        v, w = velocity[:3], velocity[3:6]
        motions = base_joints * [_LinkMotion(w, zero, upward + cross(w, v))]
        wrenches = base_joints * [_rate_of_momentum(base_link, motions[0])]
    for index in range(base_joints, len(links)):
        joint, link = chain.joints[index], links[index]
        motion = _link_motion(
            joint,
            link,
            turns[index],
            parent=motions[joint.parent] if joint.parent >= 0 else fixed_base,
            shift=_shift(chain, joint, link, q),
            rate=joint.multiplier * velocity[joint.coordinate],
            acceleration=joint.multiplier * acceleration[joint.coordinate],
        )
        title = f"link of joint {joint.name}: angular velocity w{index} and its rate e{index}, acceleration a{index}"
        names = {f"w{index}_": motion.angular, f"e{index}_": motion.angular_rate, f"a{index}_": motion.linear}
        sections.append(Section(title, names))
        motions.append(motion)
        wrenches.append(_rate_of_momentum(link, motion))
    forces = _joint_forces(chain, links, turns, q, wrenches, sections)
    return Expressions(ca.densify(ca.vertcat(*forces)), tuple(sections))


@dataclass(frozen=True)
class _LinkMotion:
    """Motion of a link in its own axes: angular velocity w, its rate, and acceleration of the origin, ``linear``."""

    angular: ca.SX
    angular_rate: ca.SX
    linear: ca.SX


def _link_motion(
    joint: Joint, link: _Link, turn: _Turn, *, parent: _LinkMotion, shift: ca.SX, rate: ca.SX, acceleration: ca.SX
) -> _LinkMotion:
    """Return the motion of a link from that of its parent.

    ``shift`` [m] leads from the parent's origin to the link's, in the parent's axes. ``rate`` and ``acceleration`` are
    those of the joint, along or about its axis z.
    """
    w, w_rate = parent.angular, parent.angular_rate
    linear = parent.linear + cross(w_rate, shift) + cross(w, cross(w, shift))  # of the link's origin, fixed in parent
    w, w_rate, linear = (_into_link(each, link.rotation, turn) for each in (w, w_rate, linear))
    relative, joint_acceleration = rate * _ALONG, acceleration * _ALONG
    if joint.prismatic:
        linear = linear + 2 * cross(w, relative) + joint_acceleration  # Coriolis' acceleration
    else:
        w, w_rate = w + relative, w_rate + cross(w, relative) + joint_acceleration
    return _LinkMotion(ca.densify(w), ca.densify(w_rate), ca.densify(linear))


_Wrench = tuple[ca.SX, ca.SX]
"""Force [N], and moment [N m] about the origin of a link, in the link's axes."""


def _joint_forces(
    chain: Chain,
    links: list[_Link],
    turns: list[_Turn],
    q: ca.SX,
    wrenches: list[_Wrench],
    sections: list[Section],
) -> list[ca.SX]:
    """Add up the wrenches of all links inwards; return the components along the joints' axes.

    ``wrenches`` holds the wrench of each link alone. The joints of a floating base carry one link, the last of them,
    whose total wrench is the force of all six.
    """
    base_joints = chain.base_joints
    totals = list(wrenches)  # of a link and all links beyond it
    forces: list[ca.SX] = [ca.SX()] * len(links)
    for index in reversed(range(base_joints, len(links))):  # children first: a total is complete when it is read
        joint, link = chain.joints[index], links[index]
        force, moment = totals[index]
        forces[index] = (force if joint.prismatic else moment)[2]
        if joint.parent < 0:
            continue
        force, moment = (_out_of_link(each, link.rotation, turns[index]) for each in (force, moment))
        moment = moment + cross(_shift(chain, joint, link, q), force)  # about the parent's origin
        title = f"force f{index} and moment n{index} of all links from joint {joint.name} outwards, in parent's axes"
        sections.append(Section(title, {f"f{index}_": ca.densify(force), f"n{index}_": ca.densify(moment)}))
        parents_force, parents_moment = totals[joint.parent]
        totals[joint.parent] = parents_force + force, parents_moment + moment
    if base_joints:
        force, moment = totals[base_joints - 1]
        forces[:base_joints] = [*ca.vertsplit(force), *ca.vertsplit(moment)]
    return forces


def _rate_of_momentum(link: _Link, motion: _LinkMotion) -> _Wrench:
    """Return the wrench that causes the motion of a link (Newton, Euler).

    With the mass m, first moment h and inertia I about the link's origin, whose acceleration is a,

        f = m a + w_rate x h + w x (w x h)        n = I w_rate + w x (I w) + h x a
    """
    w, w_rate, a = motion.angular, motion.angular_rate, motion.linear
    force = link.mass * a + cross(w_rate, link.moment) + cross(w, cross(w, link.moment))
    moment = link.tensor @ w_rate + cross(w, link.tensor @ w) + cross(link.moment, a)
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


def _turns(chain: Chain, q: ca.SX, sections: list[Section], *, of_first: bool = False) -> list[_Turn]:
    """Return the turn of every joint, and add their section.

    Unless ``of_first``, joints on the base have no turn: the mass matrix does not depend on their angles.
    """
    section = Section("sine and cosine of each joint angle")
    turns: list[_Turn] = []
    for index, joint in enumerate(chain.joints):
        is_read = of_first or joint.parent >= 0
        if joint.prismatic or index < chain.base_joints or not is_read:
            turns.append(None)
            continue
        position = joint_position(chain, joint, q)
        sine, cosine = ca.sin(position), ca.cos(position)
        section.values |= {f"s{index}": sine, f"c{index}": cosine}
        turns.append((sine, cosine))
    sections.append(section)
    return turns


def _frames(
    chain: Chain, links: list[_Link], turns: list[_Turn], q: ca.SX, sections: list[Section]
) -> list[tuple[ca.SX, ca.SX]]:
    """Return axes (z along the joint's axis) and origin of each joint, in the first link.

    The axes are those of the joint before it turns its link; only these enter the products with z.
    """
    frames: list[tuple[ca.SX, ca.SX]] = []
    link_frames: list[tuple[ca.SX, ca.SX]] = []  # the same, turned by the joint's angle
    parents = {joint.parent for joint in chain.joints}  # joints whose link frames others read
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
            x, y, z = ca.horzsplit(axes)
            link_axes = ca.horzcat(c * x + s * y, c * y - s * x, z)
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

    Momenta are about the joint's origin, in the joint's axes at zero position. Mass, first moment m and inertia I of
    the composite bodies, about the joint's origin, are added up from the tips inwards.
    """
    composites = [_Composite(link.mass, link.moment, link.tensor) for link in links]
    momenta: list[tuple[ca.SX, ca.SX]] = [(ca.SX(), ca.SX())] * len(links)
    for index in reversed(range(len(links))):  # children first: a composite is complete when it is read
        joint, link, turn = chain.joints[index], links[index], turns[index]
        composite = composites[index]  # in the link's axes
        if turn is not None:  # to the link's axes at the zero position of its joint
            moment, tensor = _turned(composite.moment, turn), _turned_tensor(composite.tensor, turn)
            composite = replace(composite, moment=moment, tensor=tensor)
        upper = {f"I{index}_{r}{c}": composite.tensor[r, c] for r in range(3) for c in range(r, 3)}
        title = f"all links from joint {joint.name} outwards: first moment m{index} [kg m], inertia I{index} [kg m^2]"
        sections.append(Section(title, {f"m{index}_": ca.densify(composite.moment), **upper}))
        linear, angular = composite.momentum(prismatic=joint.prismatic)
        if joint.parent < 0:  # the components that no parent link needs are zero
            linear, angular = _ALONG * linear, _ALONG * angular
        momenta[index] = linear, angular
        if joint.parent >= 0:
            composites[joint.parent] += composite.in_parent(link.rotation, _shift(chain, joint, link, q))
    return momenta


@dataclass(frozen=True)
class _Composite:
    """Inertia of all links from a joint outwards, about the joint's origin; composites in the same axes add up.

    ``mass`` [kg], ``moment`` (first moment [kg m]) and ``tensor`` [kg m^2].
    """

    mass: float
    moment: ca.SX
    tensor: ca.SX

    def __add__(self, other: _Composite) -> _Composite:
        return _Composite(self.mass + other.mass, self.moment + other.moment, self.tensor + other.tensor)

    def momentum(self, *, prismatic: bool) -> tuple[ca.SX, ca.SX]:
        """Return the momentum (linear, angular) at a unit rate of the joint, along or about z."""
        x, y = self.moment[0], self.moment[1]
        if prismatic:  # every point has the velocity z: mass z, and first moment x z
            return self.mass * _ALONG, ca.vertcat(y, -x, 0)
        return ca.vertcat(-y, x, 0), self.tensor[:, 2]  # the angular velocity is z: z x first moment, and I z

    def in_parent(self, rotation: ca.SX, shift: ca.SX) -> _Composite:
        """Return the composite in the parent's axes and about its origin; the link has this pose there."""
        moment, tensor = rotation @ self.moment, _symmetric(rotation @ self.tensor @ rotation.T)
        return _Composite(self.mass, *_shifted(self.mass, moment, tensor, shift))


def _turned(vector: ca.SX, turn: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Rotate a vector about z by the angle with this sine and cosine."""
    (s, c), (x, y, z) = turn, ca.vertsplit(vector)
    return ca.vertcat(c * x - s * y, s * x + c * y, z)


def _turned_tensor(tensor: ca.SX, turn: tuple[ca.SX, ca.SX]) -> ca.SX:
    """Rotate an inertia tensor about z: R I R^T with fewer operations.

    Since c^2 = 1 - s^2,

        xx' = c^2 xx - 2 s c xy + s^2 yy = xx - s a        yy' = yy + s a        a = s (xx - yy) + 2 c xy
        xy' = s c (xx - yy) + (c^2 - s^2) xy = xy + s b                          b = c (xx - yy) - 2 s xy
    """
    s, c = turn
    xx, xy, xz, yy, yz, zz = (tensor[r, k] for r in range(3) for k in range(r, 3))
    a, b = s * (xx - yy) + 2 * (c * xy), c * (xx - yy) - 2 * (s * xy)
    upper = ca.SX(3, 3)
    upper[0, 0], upper[1, 1], upper[2, 2] = xx - s * a, yy + s * a, zz
    upper[0, 1] = xy + s * b
    upper[0, 2], upper[1, 2] = c * xz - s * yz, s * xz + c * yz
    return ca.triu2symm(upper)


def _shifted(mass: float, moment: ca.SX, tensor: ca.SX, shift: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return first moment h' and inertia I' of a body about a new point; ``shift`` d points from new to old (Steiner).

    The sums over its particles at r + d, m |r + d|^2 1 - m (r + d) (r + d)^T, give with h the first moment before

        h' = h + m d        I' = I + (d . (h + h')) 1 - (h d^T + d h'^T)
    """
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
    bodies = [_inertia(joint.body).seen_from(axes.inverse()) for joint, axes in zip(joints, aligned, strict=True)]
    links: list[_Link] = []
    base_link = None
    for index in reversed(range(len(joints))):  # children first: what they pass on to this body is in it
        joint, body = joints[index], bodies[index]
        parent_axes = aligned[joint.parent] if joint.parent >= 0 else Pose.identity()
        joint_frame = Pose.translated(joint.translation) @ Pose.turned(joint.rotation)  # in the parent joint's frame
        pose = parent_axes.inverse() @ joint_frame @ aligned[index]
        if index == chain.base_joints - 1:  # the last of the base's joints carries the base link
            base_link = _link(Pose.identity(), body, scale=body)
        passed_on = _insensitive(body, prismatic=joint.prismatic)
        if joint.parent >= 0:
            bodies[joint.parent] += passed_on.seen_from(pose)
        links.append(_link(pose, body - passed_on, scale=body))
    return links[::-1], base_link


def _link(pose: Pose, inertia: Inertia, *, scale: Inertia) -> _Link:
    """Return a link with its pose in its parent; entries that are negligible against those of ``scale`` become 0."""
    rotation, translation = pose.rounded()
    mass, moment, tensor = inertia.rounded(scale=scale)
    return _Link(constant(rotation), constant(translation), mass, constant(moment), constant(tensor))


def _insensitive(body: Inertia, *, prismatic: bool) -> Inertia:
    """Return the part of a body's inertia that does not depend on the position of its joint (about or along z).

    Along z a body only slides: its tensor stays. About z a rod along z looks the same at every angle: all of the mass
    and of the first moment along z, and of the tensor yy in x and y, which leaves xx - yy in x and 0 in y.
    """
    no_inertia = Inertia.zero()
    if prismatic:
        return replace(no_inertia, tensor=body.tensor)
    zero, yy = no_inertia.mass, body.tensor[1][1]
    rod = ((yy, zero, zero), (zero, yy, zero), (zero, zero, zero))
    return Inertia(body.mass, (zero, zero, body.moment[2]), rod)


def _inertia(body: RigidBody) -> Inertia:
    xx, xy, xz, yy, yz, zz = map(mpf, body.tensor)
    return Inertia(mpf(body.mass), tuple(map(mpf, body.moment)), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
