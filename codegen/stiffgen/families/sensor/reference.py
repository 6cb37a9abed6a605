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
    """Return force and moment about the origin of forces on particles, from sum of (x, 1) f^T with the positions x.

    The last row is the force; x x f has the entries x_i f_j - x_j f_i.
    """
    xf = power[:3, :3]
    moment = [xf[1, 2] - xf[2, 1], xf[2, 0] - xf[0, 2], xf[0, 1] - xf[1, 0]]
    return ca.vertcat(power[3, :3].T, *moment)


def payload_wrench(chain: Chain, pose: ca.SX, acceleration: ca.SX, payload: ca.SX) -> ca.SX:
    """Return the wrench of weight less inertia on the sensor, about the origin of the frame of reference."""
    assert chain.sensor is not None
    moments = pose @ second_moments(payload)  # sum of m (x, 1) (y, 1)^T: x in reference axes, y in sensor axes
    weight = moments[:, 3] @ ca.DM(chain.sensor.option.gravity).T  # sum of (x, 1) (m g)^T
    inertia = moments @ acceleration.T  # sum of (x, 1) (m d2x/dt2)^T
    return _wrench_at_origin(weight - inertia[:, :3])


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
    reading, bias, F = ca.SX.sym("r", 6), ca.SX.sym("b", 6), ca.SX.sym("F", 6)
    rates, accelerations = ca.SX.sym("dq", n), ca.SX.sym("ddq", n)
    payload, moving_payload = ca.SX.sym("l", 4), ca.SX.sym("l10", 10)
    pose, second = sensor_pose(chain, joint_pose), accelerations
    if base_joints:
        v, w = rates[:3], rates[3:6]
        second = ca.vertcat(accelerations[:3] + ca.cross(w, v), accelerations[3:])
    flat = ca.vec(pose)
    # The pose's second time derivative: velocities twice, then accelerations once.
    of_velocities = ca.jtimes(ca.jtimes(flat, place.coordinates, rates), place.coordinates, rates)
    of_accelerations = ca.jtimes(flat, place.coordinates, second)
    acceleration = ca.reshape(of_velocities + of_accelerations, 4, 4)
    at_rest = environment_wrench(chain, pose, tip, ca.SX.zeros(4, 4), reading, bias, payload)
    moving = environment_wrench(chain, pose, tip, acceleration, reading, bias, moving_payload)
    reported = reading_of(chain, pose, tip, F, bias, payload)
    return {
        "tip_wrench": (at_rest, [reading, bias, payload], (READING, BIAS, PAYLOAD)),
        "reading": (reported, [F, bias, payload], (WRENCH, BIAS, PAYLOAD)),
        "tip_wrench_dynamic": (
            moving,
            [rates, accelerations, reading, bias, moving_payload],
            (VELOCITY, ACCELERATION, READING, BIAS, MOVING_PAYLOAD),
        ),
    }
