# SPDX-License-Identifier: MIT
"""CasADi expressions between a force-torque sensor's reading and the wrench of the environment at the tip.

Behind the sensor is a payload with mass m, first moment h and inertia I about the sensor's origin, all in sensor axes.
The tool side acts on the sensor with the wrench

    f = f_env + m (g - a) - e x h - w x (w x h)
    n = n_env + h x (g - a) - I e - w x (I w)

about the sensor's origin in sensor axes. Here a is the acceleration of that origin, w the angular velocity and e its
rate. A sensor with the sign "environment" reports bias + (f, n), one with the sign "robot" bias - (f, n).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from stiffgen.core.robot.chain import Chain, MountedSensor
from stiffgen.core.symbolic.kinematics import (
    Configuration,
    Expressions,
    Frame,
    Section,
    constant,
    cross,
    outward_frames,
)


def _sensor_of(chain: Chain) -> MountedSensor:
    assert chain.sensor is not None  # the family has no kernels otherwise
    return chain.sensor


def _place(chain: Chain, pose: ca.SX, tool_pose: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """Return the sensor's rotation in base axes, and the arm from the tip to the sensor in sensor axes [m].

    The sensor is mounted in the frame of the tip link; the tip's ``pose`` is that of a tool at run time, if any.
    """
    sensor = _sensor_of(chain)
    rotation, arm = constant(sensor.rotation), constant(sensor.translation)  # in the tip link
    tip_rotation = pose[:3, :3]
    if tool_pose is not None:
        tip_rotation, arm = tip_rotation @ tool_pose[:3, :3].T, arm - tool_pose[:3, 3]
    return ca.densify(tip_rotation @ rotation), rotation.T @ arm


def _sections(R: ca.SX, fall: ca.SX, load: ca.SX) -> tuple[Section, ...]:
    return (
        Section("sensor in base axes: rotation Rs", {"Rs_": R}),
        Section("sensor axes: free fall less acceleration gs", {"gs_": ca.densify(fall)}),
        Section("sensor axes: wrench ws of the payload at the sensor", {"ws_": ca.densify(load)}),
    )


def _weight(payload: ca.SX, fall: ca.SX) -> ca.SX:
    """Return the wrench of a payload's weight at the sensor, in sensor axes."""
    return ca.vertcat(payload[0] * fall, cross(payload[1:4], fall))


def _net(chain: Chain, reading: ca.SX, bias: ca.SX) -> ca.SX:
    """Return the wrench of the tool side on the sensor, in sensor axes."""
    return reading - bias if _sensor_of(chain).option.sign == "environment" else bias - reading


def _to_tip(chain: Chain, R: ca.SX, arm: ca.SX, reading: ca.SX, bias: ca.SX, load: ca.SX) -> ca.SX:
    """Return the hybrid wrench of the environment at the tip."""
    net = _net(chain, reading, bias) - load
    force = net[:3]
    return ca.densify(ca.vertcat(R @ force, R @ (net[3:] + cross(arm, force))))


def tip_wrench(chain: Chain, pose: ca.SX, *arguments: ca.SX) -> Expressions:
    """Return the wrench (6) at the tip; ``arguments`` are a tool pose (at run time), reading, bias and payload.

    All that does not depend on the pose is computed in the tip's axes first, so that three products with its rotation
    remain behind the kinematics. The payload is mass [kg] and first moment (3) [kg m], in the sensor's axes.
    """
    *tool_pose, reading, bias, payload = arguments
    sensor = _sensor_of(chain)
    rotation, free_fall = constant(sensor.rotation), constant(sensor.option.gravity)
    R, arm = pose[:3, :3], constant(sensor.translation)
    if tool_pose:
        R, arm = ca.densify(R @ tool_pose[0][:3, :3].T), arm - tool_pose[0][:3, 3]
    net, mass = _net(chain, reading, bias), payload[0]
    # in tip axes about the tip: the net reading, and the payload's first moment
    force = rotation @ net[:3]
    moment = rotation @ net[3:] + cross(arm, force)
    first_moment = rotation @ payload[1:4] + mass * arm
    names = {"fs_": ca.densify(force), "ns_": ca.densify(moment), "hs_": ca.densify(first_moment)}
    title = "tip axes, about the tip: force fs and moment ns of the net reading, first moment hs of the payload"
    weight = ca.vertcat(mass * free_fall, cross(R @ first_moment, free_fall))
    return Expressions(ca.densify(ca.vertcat(R @ force, R @ moment) - weight), (Section(title, names),))


def reading(chain: Chain, pose: ca.SX, *arguments: ca.SX) -> Expressions:
    """Return the sensor's reading; ``arguments`` are a tool pose (at run time), wrench, bias and payload."""
    *tool_pose, wrench, bias, payload = arguments
    R, arm = _place(chain, pose, tool_pose[0] if tool_pose else None)
    fall = R.T @ constant(_sensor_of(chain).option.gravity)
    load = _weight(payload, fall)
    force = R.T @ wrench[:3]
    net = ca.vertcat(force, R.T @ wrench[3:] - cross(arm, force)) + load
    value = bias + net if _sensor_of(chain).option.sign == "environment" else bias - net
    return Expressions(ca.densify(value), _sections(R, fall, load))


class Motion(NamedTuple):
    """Motion of a frame in base axes: angular velocity w, its rate e, and the acceleration a of its origin."""

    w: ca.SX
    e: ca.SX
    a: ca.SX


def tip_wrench_dynamic(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return the wrench at the tip of a moving robot.

    ``arguments`` are those of the configuration, velocity, acceleration, reading, bias and the payload's ten
    parameters. The motion of a floating base is its body twist and the rate of that twist.
    """
    *of_configuration, velocity, acceleration, reading, bias, payload = arguments
    configuration = Configuration.of(chain, of_configuration)
    recursion, frames = outward_frames(chain, configuration)
    joint_rotation, *_ = frames[-1]
    motions, sections = _motions(chain, configuration, frames, velocity, acceleration)
    R, to_sensor, arm = _from_joint(chain, joint_rotation, configuration.tool_pose)
    sensor = _shifted(motions[-1], to_sensor)
    w, e = R.T @ sensor.w, R.T @ sensor.e  # in sensor axes, as all that follows
    fall = ca.densify(R.T @ (constant(_sensor_of(chain).option.gravity) - sensor.a))  # g - a
    h, inertia = payload[1:4], _tensor(payload[4:10])
    turning = ca.vertcat(cross(e, h) + cross(w, cross(w, h)), inertia @ e + cross(w, inertia @ w))
    load = ca.densify(_weight(payload, fall) - turning)
    axes, *of_load = _sections(R, fall, load)
    of_rates = Section("sensor axes: angular velocity w, its rate e", {"w_": ca.densify(w), "e_": ca.densify(e)})
    result = _to_tip(chain, R, arm, reading, bias, load)
    return Expressions(result, (*recursion.sections, *sections, axes, of_rates, *of_load))


def _from_joint(chain: Chain, rotation: ca.SX, tool_pose: ca.SX | None) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the sensor's rotation and offset from the last joint in base axes, and the arm of :func:`_place`."""
    sensor, tip = _sensor_of(chain), rotation @ constant(chain.tip_rotation)
    R = ca.densify(tip @ constant(sensor.rotation))
    to_tip = rotation @ constant(chain.tip_translation)
    origin = constant(sensor.translation)
    arm = origin if tool_pose is None else origin - tool_pose[:3, 3]
    return R, to_tip + tip @ origin, constant(sensor.rotation).T @ arm


def _shifted(motion: Motion, offset: ca.SX) -> Motion:
    """Return the motion of a point that is fixed in a link, ``offset`` from the one before [m]."""
    w, e, a = motion
    return Motion(w, e, a + cross(e, offset) + cross(w, cross(w, offset)))


def _motions(
    chain: Chain, configuration: Configuration, frames: Sequence[Frame], velocity: ca.SX, acceleration: ca.SX
) -> tuple[list[Motion], list[Section]]:
    """Return the motion of each joint's frame, and sections with the motions."""
    base_rotation, base_origin = configuration.base
    zero, base_joints = ca.SX(3, 1), chain.base_joints
    of_base = Motion(zero, zero, zero)
    if base_joints:  # the rate of the body twist (v, w) is that seen from the base
        v, w = velocity[:3], velocity[3:6]
        linear = acceleration[:3] + cross(w, v)
        of_base = Motion(base_rotation @ w, base_rotation @ acceleration[3:6], base_rotation @ linear)
    motions, sections = base_joints * [of_base], list[Section]()
    for index, joint in enumerate(chain.joints[base_joints:], start=base_joints):
        parent, parent_origin = of_base, base_origin
        if joint.parent >= 0:
            parent, (_, parent_origin, _) = motions[joint.parent], frames[joint.parent]
        _, origin, axis = frames[index]
        before_joint = _shifted(parent, origin - parent_origin)
        rate = joint.multiplier * velocity[joint.coordinate] * axis
        joint_acceleration = joint.multiplier * acceleration[joint.coordinate] * axis
        motion = _after_joint(before_joint, rate, joint_acceleration, prismatic=joint.prismatic)
        title = f"frame of joint {joint.name}: angular velocity w{index}, its rate e{index}, acceleration a{index}"
        names = {f"w{index}_": motion.w, f"e{index}_": motion.e, f"a{index}_": motion.a}
        sections.append(Section(title, names))
        motions.append(motion)
    return motions, sections


def _after_joint(motion: Motion, rate: ca.SX, acceleration: ca.SX, *, prismatic: bool) -> Motion:
    """Return the motion beyond a joint from that before it; rate and acceleration are vectors along its axis."""
    w, e, a = motion
    if prismatic:
        a = a + 2 * cross(w, rate) + acceleration  # Coriolis acceleration of the slide, and its own
    else:
        w, e = w + rate, e + cross(w, rate) + acceleration
    return Motion(ca.densify(w), ca.densify(e), ca.densify(a))


def _tensor(entries: ca.SX) -> ca.SX:
    """Return the symmetric inertia (3x3) of its entries xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = ca.vertsplit(entries)
    return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
