# SPDX-License-Identifier: MIT
"""Oracles of the dynamics."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import BASE_POSE, GRAVITY, TOOL_POSE, VELOCITY, Argument, Q
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.poses import homogeneous, jacobian_of, joint_poses
from stiffgen.core.verify.kernels.references import WRENCH, References, as_columns
from stiffgen.core.verify.kernels.rounding import evaluate_longer
from stiffgen.families.dynamics.reference import differentiated as differentiated_energies
from stiffgen.families.dynamics.reference import potential_energy


def dynamics(r: References) -> dict[str, FloatArray]:
    """Return mass matrix, bias forces and gravity by kernel, from the energies of the whole tree."""
    place, samples = r.place, r.samples
    base_poses = samples[BASE_POSE].reshape(-1, 16)  # (samples, 4, 4) row by row, as place.base_pose
    return differentiated_energies(
        r.chain,
        poses=joint_poses(r.chain, place.q, place.base()),
        moves=place.moves,
        q=place.q,
        base_pose=place.base_pose,
        samples=(samples[Q], base_poses, samples[VELOCITY], samples[GRAVITY]),
    )


def static_torque_derivatives(r: References) -> FloatArray:
    """Return the derivative of the torque at rest, dU/dq - J^T F (samples, n, n): row torque, column coordinate.

    A floating base moves twice: by ``moves_of_torque`` for J and dU/dq, then by the place's own motion for their
    derivatives. Both motions are zero afterwards.
    """
    place, tips, base_joints = r.place, len(r.chain.tips), r.chain.base_joints
    moves_of_torque, gravity = ca.SX.sym("s", base_joints), ca.SX.sym("g", 3)
    wrenches, tool_poses = ca.SX.sym("F", 6, tips), ca.SX.sym("T", 16, tips)  # a column per tip; poses row by row
    at_rest = ca.DM.zeros(base_joints)
    torque = _torque_at_rest(r, moves_of_torque, wrenches, tool_poses, gravity)
    torque = ca.substitute(torque, moves_of_torque, at_rest)
    derivative = ca.substitute(ca.jacobian(torque, place.coordinates), place.moves, at_rest)
    values_of = (
        (place.q, r.samples[Q]),
        (place.base_pose, r.samples[BASE_POSE]),
        (ca.vec(wrenches), _of_all_tips(r, WRENCH)),
        (ca.vec(tool_poses), _of_all_tips(r, TOOL_POSE)),
        (gravity, r.samples[GRAVITY]),
    )
    symbols = [symbol for symbol, _ in values_of]
    return evaluate_longer(symbols, derivative, [as_columns(values) for _, values in values_of])


def _torque_at_rest(r: References, moves: ca.SX, wrenches: ca.SX, tool_poses: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return the torque dU/dq - J^T F (n) that holds the robot, the base moved from its place by ``moves``.

    The energy U is that of gravity, J the hybrid Jacobian of each tip. ``wrenches`` (6, tips) and ``tool_poses`` (16,
    tips, row by row) have a column per tip.
    """
    chain, place = r.chain, r.place
    joints, coordinates = joint_poses(chain, place.q, place.base(moves)), ca.vertcat(moves, place.q)
    torque = ca.gradient(potential_energy(chain, joints, gravity), coordinates)
    for k, tip in enumerate(chain.tips):
        tip_pose = joints[tip.joint] @ homogeneous(tip.rotation, tip.translation)
        if chain.runtime_tool:
            tip_pose = tip_pose @ tool_poses[:, k].reshape((4, 4)).T
        torque -= jacobian_of(tip_pose, coordinates, "hybrid").T @ wrenches[:, k]
    return torque


def _of_all_tips(r: References, argument: Argument) -> FloatArray:
    """Return the values of an argument of the tips, (samples, tips, ...)."""
    return np.stack([tip.samples[argument] for tip in r.tips], axis=1)


def _of_energies(name: str) -> tuple[Oracle, ...]:
    return (Oracle("differentiated energies", lambda r: r.of(dynamics)[name]),)


ORACLES = {
    **{
        name: _of_energies(name)
        for name in ("mass_matrix", "bias_forces", "gravity_energy", "gravity_gradient", "gravity_joint_stiffness")
    },
    "static_torque_derivatives": (Oracle("differentiated energies", lambda r: r.of(static_torque_derivatives)),),
}
