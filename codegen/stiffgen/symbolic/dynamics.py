# SPDX-License-Identifier: MIT
"""CasADi expressions of the joint-space mass matrix, by composite bodies in link axes, and of the bias forces.

M_ij = J_i . h_j for every joint i on the way from the base to joint j, where h_j = I^c_j J_j is the momentum of
everything beyond joint j at a unit rate of joint j (Featherstone, Rigid Body Dynamics Algorithms, 2008,
composite-rigid-body algorithm). With z along every joint's axis, h_j is a column of the composite inertia I^c_j, and
J_i . h_j an entry of h_j as link i sees it. What keeps it short, and independent of where the base stands:

* Composites are taken in the axes of their link, about its joint's origin. Going to the link before is a turn about z.
* Neither the first joint's position nor its placement in the base enters.
* What of a link does not feel its joint's motion is counted with the link before (base inertial parameters: Gautier
  and Khalil 1990): the mass of a turning link, its first moment along the axis, and a rod's inertia along it; the
  inertia tensor of a sliding one. This is done once, with 50 digits.

The bias forces C(q, dq) dq + g(q) come from one pass outwards, for rates and accelerations, and one pass inwards, for
forces (recursive Newton-Euler algorithm: Luh, Walker and Paul 1980), in the same axes and with the same parameters,
which change neither. The base is taken to accelerate against gravity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from stiffgen.robot.chain import Body, Chain, Joint
from stiffgen.robot.geometry import Inertia, Pose, aligning_rotation, mpf
from stiffgen.symbolic.kinematics import Configuration, Expressions, Section, constant, cross, joint_position

_ALONG = ca.SX(ca.sparsify(ca.DM([0, 0, 1])))
"""The axis of every joint, in the axes of its link."""


@dataclass(frozen=True)
class _Link:
    """Moving link in axes whose z is its joint's axis.

    ``rotation`` and ``translation`` [m] are its pose in the link before at zero position; its base inertial parameters
    are mass [kg], first moment [kg m] and inertia
    tensor about the joint's origin [kg m^2]. Zeros are structural.
    """

    rotation: ca.SX
    translation: ca.SX
    mass: float
    moment: ca.SX
    tensor: ca.SX


def mass_matrix(chain: Chain, q: ca.SX) -> Expressions:
    """Return the mass matrix of moving joints that all turn, as m*m numbers row by row.

    Every h_j is taken from link to link towards the base: the fewest operations, but quadratic in length.
    """
    links, _ = _links(chain)
    sections: list[Section] = []
    turns = _turns(chain, q, sections)
    result = ca.SX.zeros(len(links), len(links))
    for index, (linear, angular) in enumerate(_momenta(chain, links, turns, q, sections)):
        named: dict[str, ca.SX] = {}
        result[index, index] = angular[2]
        link, at = links[index], chain.joints[index].parent
        while at >= 0:
            linear, angular = ca.densify(link.rotation @ linear), ca.densify(link.rotation @ angular)
            angular = angular + cross(link.translation, linear)
            turn = turns[at]
            if turn is not None:
                linear, angular = _turned(linear, turn), _turned(angular, turn)
            named |= {f"l{index}_{at}_": linear, f"a{index}_{at}_": angular}
            result[at, index] = result[index, at] = angular[2]
            link, at = links[at], chain.joints[at].parent
        title = f"momentum h{index} of all beyond joint {chain.joints[index].name}, seen from the links k before it"
        sections.append(Section(f"{title}: linear l{index}_k, angular a{index}_k", named))
    return Expressions(ca.densify(ca.vec(result)), tuple(sections))


def columns_and_momenta(chain: Chain, q: ca.SX) -> Expressions:
    """Return Jacobian columns over momenta (12 x number of joints): rows 0..5 J_j, rows 6..11 h_j, linear first.

    Both are taken about the origin of the first joint on the way to joint j and in the axes of its link. The length is
    linear in the number of joints; the products J_i . h_j are left to a loop.
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
            # J_j . h_j does not feel the linear part of h_j, the first joint feels it across its axis or along it.
            sliding = chain.joints[joint.parent].prismatic
            linear = linear * (_ALONG if sliding else 1 - _ALONG)
        stacked.append(ca.vertcat(column, linear, angular + cross(origin, linear)))
    return Expressions(ca.densify(ca.horzcat(*stacked)), tuple(sections))


def bias_forces(chain: Chain, *given: ca.SX) -> Expressions:
    """Return the joint forces at constant rates: Coriolis, centrifugal and gravity.

    ``given``: the base's pose if it floats, q, velocity, gravity. A floating base's rates are those of its body twist;
    its forces are a wrench at the base link's origin in its axes.
    """
    *configuration, velocity, gravity = given
    at = Configuration.of(chain, configuration)
    q, (base_rotation, _), own = at.q, at.base, chain.base_joints
    links, base_link = _links(chain)
    sections: list[Section] = []
    rates = [joint.multiplier * velocity[joint.coordinate] for joint in chain.joints]
    turns: list[_Turn] = [
        None if joint.prismatic or index < own else _sine_cosine(chain, joint, q)
        for index, joint in enumerate(chain.joints)
    ]
    named = {f"{letter}{k}": turn[i] for k, turn in enumerate(turns) if turn for i, letter in enumerate("sc")}
    sections.append(Section("sine and cosine of each joint angle", named))
    zero = ca.SX(3, 1)
    falling = ca.densify(-(base_rotation.T @ gravity))
    motions: list[tuple[ca.SX, ca.SX, ca.SX]] = []
    wrenches: list[tuple[ca.SX, ca.SX]] = []
    if base_link is not None:
        # The twist's rate is zero in the base's own axes: there the origin accelerates by w x v.
        turning = velocity[3:6]
        motions = own * [(turning, zero, falling + cross(turning, velocity[:3]))]
        wrenches = own * [_rate_of_momentum(base_link, *motions[0])]
    for index, (joint, link, turn, rate) in enumerate(zip(chain.joints, links, turns, rates, strict=True)):
        if index < own:
            continue
        turning, turning_rate, linear = motions[joint.parent] if joint.parent >= 0 else (zero, zero, falling)
        shift, relative = _shift(chain, joint, link, q), rate * _ALONG
        linear = linear + cross(turning_rate, shift) + cross(turning, cross(turning, shift))
        turning, turning_rate, linear = (
            _into_link(each, link.rotation, turn) for each in (turning, turning_rate, linear)
        )
        if joint.prismatic:
            linear = linear + 2 * cross(turning, relative)
        else:
            turning, turning_rate = turning + relative, turning_rate + cross(turning, relative)
        motion = ca.densify(turning), ca.densify(turning_rate), ca.densify(linear)
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
    """Add up the wrenches of all links inwards; return their components along the joints' axes."""
    own = chain.base_joints
    forces: list[ca.SX] = [ca.SX()] * len(links)
    for index in reversed(range(own, len(links))):
        joint, link = chain.joints[index], links[index]
        force, moment = wrenches[index]
        forces[index] = (force if joint.prismatic else moment)[2]
        if joint.parent < 0:
            continue
        force, moment = (_out_of_link(each, link.rotation, turns[index]) for each in (force, moment))
        moment = moment + cross(_shift(chain, joint, link, q), force)
        title = f"force f{index} and moment n{index} of everything from joint {joint.name} outwards, seen before it"
        sections.append(Section(title, {f"f{index}_": ca.densify(force), f"n{index}_": ca.densify(moment)}))
        outer_force, outer_moment = wrenches[joint.parent]
        wrenches[joint.parent] = outer_force + force, outer_moment + moment
    if own:
        forces[:own] = [each for part in wrenches[own - 1] for each in ca.vertsplit(part)]
    return forces


def _rate_of_momentum(link: _Link, turning: ca.SX, turning_rate: ca.SX, linear: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return force and moment about a link's origin that accelerate it (Newton, Euler)."""
    moved = cross(turning, link.moment)
    force = link.mass * linear + cross(turning_rate, link.moment) + cross(turning, moved)
    moment = link.tensor @ turning_rate + cross(turning, link.tensor @ turning) + cross(link.moment, linear)
    return force, moment


def _shift(chain: Chain, joint: Joint, link: _Link, q: ca.SX) -> ca.SX:
    """Return the position of a link's origin in the link before."""
    if not joint.prismatic:
        return link.translation
    return link.translation + link.rotation[:, 2] * joint_position(chain, joint, q)


def _into_link(vector: ca.SX, rotation: ca.SX, turn: _Turn) -> ca.SX:
    """Rotate a vector from the axes of a link's parent to the link's."""
    vector = rotation.T @ vector
    return ca.densify(vector if turn is None else _turned(vector, (-turn[0], turn[1])))


def _out_of_link(vector: ca.SX, rotation: ca.SX, turn: _Turn) -> ca.SX:
    """Rotate from the link's axes to its parent's."""
    return ca.densify(rotation @ (vector if turn is None else _turned(vector, turn)))


_Turn = tuple[ca.SX, ca.SX] | None
"""Sine and cosine of a joint's angle, None where the mass matrix does not depend on it or the joint slides."""


def _turns(chain: Chain, q: ca.SX, sections: list[Section]) -> list[_Turn]:
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
    """Return the axes of each joint before its own turn (z is its axis) and its origin, in the first link."""
    before: list[tuple[ca.SX, ca.SX]] = []
    after: list[tuple[ca.SX, ca.SX]] = []
    inner = {joint.parent for joint in chain.joints}
    for index, (joint, link, turn) in enumerate(zip(chain.joints, links, turns, strict=True)):
        if joint.parent < 0:
            axes, origin = ca.SX.eye(3), ca.SX.zeros(3)
        else:
            axes, origin = after[joint.parent]
            origin = origin + axes @ link.translation
            axes = axes @ link.rotation
            if joint.prismatic:
                origin = origin + axes[:, 2] * joint_position(chain, joint, q)
        turned = axes
        if turn is not None:
            s, c = turn
            turned = ca.horzcat(c * axes[:, 0] + s * axes[:, 1], c * axes[:, 1] - s * axes[:, 0], axes[:, 2])
        if index in inner:
            named = {f"R{index}_": ca.densify(turned), f"p{index}_": ca.densify(origin)}
            sections.append(
                Section(f"link of joint {joint.name}: axes R{index}, origin p{index}, seen from the first link", named)
            )
        before.append((axes, origin))
        after.append((turned, origin))
    return before


def _momenta(
    chain: Chain, links: list[_Link], turns: list[_Turn], q: ca.SX, sections: list[Section]
) -> list[tuple[ca.SX, ca.SX]]:
    """Return the momentum (linear, angular) of everything beyond each joint at its unit rate.

    Momenta are about the joint's origin, in its axes before its turn.

    From the tips inwards, composites by composites: mass, first moment m and inertia I about the joint's origin.
    """
    beyond = [(link.mass, link.moment, link.tensor) for link in links]
    momenta: list[tuple[ca.SX, ca.SX]] = [(ca.SX(), ca.SX())] * len(links)
    for index in reversed(range(len(links))):
        joint, link = chain.joints[index], links[index]
        mass, moment, tensor = beyond[index]
        turn = turns[index]
        if turn is not None:
            moment, tensor = _turned(moment, turn), _turned_tensor(tensor, turn)
        upper = {f"I{index}_{r}{c}": tensor[r, c] for r in range(3) for c in range(r, 3)}
        title = f"from joint {joint.name} outwards: first moment m{index} [kg m] and inertia I{index} [kg m^2]"
        sections.append(Section(title, {f"m{index}_": ca.densify(moment), **upper}))
        if joint.prismatic:
            linear, angular = mass * _ALONG, ca.vertcat(moment[1], -moment[0], 0)
        else:
            linear, angular = ca.vertcat(-moment[1], moment[0], 0), tensor[:, 2]
        if joint.parent < 0:  # no link before it sees the rest
            linear, angular = _ALONG * linear, _ALONG * angular
        momenta[index] = linear, angular
        if joint.parent >= 0:
            shift = _shift(chain, joint, link, q)
            moment, tensor = link.rotation @ moment, _symmetric(link.rotation @ tensor @ link.rotation.T)
            moment, tensor = _moved(mass, moment, tensor, shift)
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
    moved, product = s * (xx - yy) + 2 * (c * xy), c * (xx - yy) - 2 * (s * xy)
    upper = ca.SX(3, 3)
    upper[0, 0], upper[1, 1], upper[2, 2] = xx - s * moved, yy + s * moved, zz
    upper[0, 1] = xy + s * product
    upper[0, 2], upper[1, 2] = c * xz - s * yz, s * xz + c * yz
    return ca.triu2symm(upper)


def _moved(mass: float, moment: ca.SX, tensor: ca.SX, by: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Shift first moment and inertia of a body to another point, from which the old one stands ``by`` (Steiner)."""
    moved = moment + mass * by if mass else moment
    outer = moment @ by.T + by @ moved.T
    steiner = ca.dot(by, moment + moved) * ca.SX.eye(3) - outer
    return moved, _symmetric(tensor + steiner)


def _symmetric(matrix: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(matrix))


def _links(chain: Chain) -> tuple[list[_Link], _Link | None]:
    """Return all links, and a floating base's link.

    Inertia that does not feel its joint's motion is counted with the link before.
    """
    joints = chain.joints
    aligned = [Pose.turned(aligning_rotation(joint.axis)) for joint in joints]
    places = []
    for joint, own in zip(joints, aligned, strict=True):
        before = aligned[joint.parent] if joint.parent >= 0 else Pose.identity()
        places.append(before.inverse() @ Pose.translated(joint.translation) @ Pose.turned(joint.rotation) @ own)
    bodies = [_inertia(joint.body).seen_from(own.inverse()) for joint, own in zip(joints, aligned, strict=True)]
    links: list[_Link] = []
    base_link = None
    for index in reversed(range(len(joints))):
        joint, total = joints[index], bodies[index]
        if index == chain.base_joints - 1:
            mass, moment, tensor = total.rounded()
            base_link = _Link(ca.SX.eye(3), ca.SX.zeros(3), mass, constant(moment), constant(tensor))
        still = _insensitive(total, prismatic=joint.prismatic)
        if joint.parent >= 0:
            bodies[joint.parent] += still.seen_from(places[index])
        rotation, translation = places[index].rounded()
        mass, moment, tensor = (total - still).rounded(scale=total)
        links.append(_Link(constant(rotation), constant(translation), mass, constant(moment), constant(tensor)))
    return links[::-1], base_link


def _insensitive(body: Inertia, *, prismatic: bool) -> Inertia:
    """Return the part of a body that moves in the same way if its joint (about or along z) is fixed at any position."""
    zero = Inertia.zero()
    if prismatic:
        return replace(zero, tensor=body.tensor)
    (nothing, *_), yy = zero.moment, body.tensor[1][1]
    rod = ((yy, nothing, nothing), (nothing, yy, nothing), (nothing, nothing, nothing))
    return Inertia(body.mass, (nothing, nothing, body.moment[2]), rod)


def _inertia(body: Body) -> Inertia:
    xx, xy, xz, yy, yz, zz = map(mpf, body.tensor)
    return Inertia(mpf(body.mass), tuple(map(mpf, body.moment)), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
