# SPDX-License-Identifier: MIT
"""Oracles of the dynamics."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import BASE_POSE, GRAVITY, TOOL_POSE, VELOCITY, Q
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.poses import homogeneous, jacobian_of, joint_poses
from stiffgen.core.verify.kernels.references import WRENCH, References, as_columns
from stiffgen.core.verify.kernels.rounding import evaluate_longer
from stiffgen.families.dynamics.reference import differentiated as differentiated_energies
from stiffgen.families.dynamics.reference import potential_energy


def dynamics(r: References) -> dict[str, FloatArray]:
    """Mass matrix, bias forces and gravity by kernel, from the energies of the whole tree."""
    place, samples = r.place, r.samples
    poses = joint_poses(r.chain, place.q, place.base())
    stacks = samples[Q], samples[BASE_POSE].reshape(-1, 16), samples[VELOCITY], samples[GRAVITY]
    return differentiated_energies(r.chain, poses, place.moves, place.q, place.base_pose, stacks)


def static_torque_derivatives(r: References) -> FloatArray:
    """Return the derivative of dU/dq - J^T F (samples, n, n): J from differentiated poses, the base moved twice."""
    chain, place, moves = r.chain, r.place, ca.SX.sym("s", r.chain.base_joints)
    gravity, count = ca.SX.sym("g", 3), len(chain.tips)
    wrenches, tools = (ca.SX.sym(name, size, count) for name, size in (("F", 6), ("T", 16)))
    poses, coordinates = joint_poses(chain, place.q, place.base(moves)), ca.vertcat(moves, place.q)
    torque = ca.gradient(potential_energy(chain, poses, gravity), coordinates)
    for k, tip in enumerate(chain.tips):
        mounted = tools[:, k].reshape((4, 4)).T if chain.runtime_tool else ca.SX.eye(4)
        pose = poses[tip.joint] @ homogeneous(tip.rotation, tip.translation) @ mounted
        torque -= jacobian_of(pose, coordinates, "hybrid").T @ wrenches[:, k]
    at_rest = ca.DM.zeros(chain.base_joints)
    derivative = ca.jacobian(ca.substitute(torque, moves, at_rest), place.coordinates)
    of_tips = (np.stack([tip.samples[each] for tip in r.tips], axis=1) for each in (WRENCH, TOOL_POSE))
    stacks = *r.samples.of((Q, BASE_POSE)), *of_tips, r.samples[GRAVITY]
    symbols = [place.q, place.base_pose, ca.vec(wrenches), ca.vec(tools), gravity]
    there = ca.substitute(derivative, place.moves, at_rest)
    return evaluate_longer(symbols, there, [as_columns(stack) for stack in stacks])


def _of_energies(name: str) -> tuple[Oracle, ...]:
    return (Oracle("differentiated energies", lambda r: r.of(dynamics)[name]),)


ORACLES = {
    **{
        name: _of_energies(name)
        for name in ("mass_matrix", "bias_forces", "gravity_energy", "gravity_gradient", "gravity_joint_stiffness")
    },
    "static_torque_derivatives": (Oracle("differentiated energies", lambda r: r.of(static_torque_derivatives)),),
}
