# SPDX-License-Identifier: MIT
"""References of a force-torque sensor's kernels: momenta of the payload, and wrenches moved by 4x4 products.

The payload's second moments P are a 4x4 matrix with the mass in its last entry. At the pose H of the sensor, in the
frame of reference, the forces on its particles add up to H P d2H/dt2^T: the last row is the total force, the
antisymmetric part the moment about the origin. No part of it uses angular velocities or a recursion.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import VELOCITY, Argument
from stiffgen.core.verify.kernels.poses import MovedConfiguration, homogeneous
from stiffgen.families.sensor.kernels import ACCELERATION, BIAS, MOVING_PAYLOAD, PAYLOAD, READING, WRENCH


def second_moments(payload: ca.SX) -> ca.SX:
    """Return P (4x4) of a payload's ten parameters, or of four: its inertia then does not matter."""
    parameters = ca.vertcat(payload, ca.SX.zeros(10 - payload.shape[0]))
    mass, moment = parameters[0], parameters[1:4]  # [kg], first moment [kg m]
    xx, xy, xz, yy, yz, zz = ca.vertsplit(parameters[4:])
    tensor = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # integral of r r^T from the inertia tensor, beside the first moment
    upper = ca.horzcat(ca.trace(tensor) / 2 * ca.SX.eye(3) - tensor, moment)
    return ca.vertcat(upper, ca.horzcat(moment.T, mass))


def sensor_pose(chain: Chain, joint_pose: ca.SX) -> ca.SX:
    """Return the pose (4x4) of the sensor from that of the tip's joint."""
    assert chain.sensor is not None
    (tip,) = chain.tips
    mounted = homogeneous(chain.sensor.rotation, chain.sensor.translation)
    return joint_pose @ homogeneous(tip.rotation, tip.translation) @ mounted


def _wrench_at_origin(power: ca.SX) -> ca.SX:
    """Return force and moment about the origin of forces on particles, from sum of x f^T with x = (position, 1)."""
    turned = power[:3, :3]
    moment = [turned[1, 2] - turned[2, 1], turned[2, 0] - turned[0, 2], turned[0, 1] - turned[1, 0]]
    return ca.vertcat(power[3, :3].T, *moment)


def payload_wrench(chain: Chain, pose: ca.SX, acceleration: ca.SX, payload: ca.SX) -> ca.SX:
    """Return the wrench of weight less inertia on the sensor, about the origin of the frame of reference."""
    assert chain.sensor is not None
    P = second_moments(payload)
    moments = pose @ P
    weight = moments[:, 3] @ ca.DM(chain.sensor.option.gravity).T  # sum of x (m g)^T
    return _wrench_at_origin(weight - (moments @ acceleration.T)[:, :3])


def _moved(force_and_moment: ca.SX, by: ca.SX) -> ca.SX:
    """Return a wrench about a point that lies ``by`` from the point before."""
    force = force_and_moment[:3]
    return ca.vertcat(force, force_and_moment[3:] - ca.cross(by, force))


def _out_of_sensor(pose: ca.SX, values: ca.SX) -> ca.SX:
    """Return a wrench in sensor axes about the sensor as one about the origin, in the axes of reference."""
    R = pose[:3, :3]
    return _moved(ca.vertcat(R @ values[:3], R @ values[3:]), -pose[:3, 3])


def environment_wrench(
    chain: Chain, pose: ca.SX, tip: ca.SX, acceleration: ca.SX, reading: ca.SX, bias: ca.SX, payload: ca.SX
) -> ca.SX:
    """Return the wrench at the tip from a reading; poses and acceleration are 4x4."""
    assert chain.sensor is not None
    sign = {"environment": 1, "robot": -1}[chain.sensor.option.sign]
    total = _out_of_sensor(pose, sign * (reading - bias))
    return _moved(total - payload_wrench(chain, pose, acceleration, payload), tip[:3, 3])


def reading_of(chain: Chain, pose: ca.SX, tip: ca.SX, wrench: ca.SX, bias: ca.SX, payload: ca.SX) -> ca.SX:
    """Return the reading of a robot at rest under a wrench at the tip."""
    assert chain.sensor is not None
    still = payload_wrench(chain, pose, ca.SX.zeros(4, 4), payload)
    total, back = _moved(wrench, -tip[:3, 3]) + still, pose[:3, :3].T
    at_sensor = _moved(total, pose[:3, 3])
    sign = {"environment": 1, "robot": -1}[chain.sensor.option.sign]
    return bias + sign * ca.vertcat(back @ at_sensor[:3], back @ at_sensor[3:])


def expressions(
    chain: Chain, place: MovedConfiguration, joint_pose: ca.SX, tip: ca.SX
) -> dict[str, tuple[ca.SX, list[ca.SX], tuple[Argument, ...]]]:
    """Return expression, symbols and their arguments of the kernels' wrenches and readings, by the kernel's name.

    A floating base has moved by x = (v, w) to p + R v, R exp([w]); its twist has the rate a where x accelerates by
    a + (w x v, 0).
    """
    base_joints, n = place.moves.shape[0], chain.dof
    r, b, F, rates, accelerations = (
        ca.SX.sym(name, size) for name, size in (("r", 6), ("b", 6), ("F", 6), ("dq", n), ("ddq", n))
    )
    at_rest, moving = ca.SX.sym("l", 4), ca.SX.sym("l10", 10)
    pose, second = sensor_pose(chain, joint_pose), accelerations
    if base_joints:
        second = ca.vertcat(accelerations[:3] + ca.cross(rates[3:6], rates[:3]), accelerations[3:])
    flat = ca.vec(pose)
    # The pose's second time derivative: velocities twice, then accelerations once.
    along = ca.jtimes(ca.jtimes(flat, place.coordinates, rates), place.coordinates, rates)
    motion = ca.reshape(along + ca.jtimes(flat, place.coordinates, second), 4, 4)
    still = environment_wrench(chain, pose, tip, ca.SX.zeros(4, 4), r, b, at_rest)
    moved = environment_wrench(chain, pose, tip, motion, r, b, moving)
    return {
        "tip_wrench": (still, [r, b, at_rest], (READING, BIAS, PAYLOAD)),
        "reading": (reading_of(chain, pose, tip, F, b, at_rest), [F, b, at_rest], (WRENCH, BIAS, PAYLOAD)),
        "tip_wrench_dynamic": (
            moved,
            [rates, accelerations, r, b, moving],
            (VELOCITY, ACCELERATION, READING, BIAS, MOVING_PAYLOAD),
        ),
    }
