# SPDX-License-Identifier: MIT
"""Differentiate kinetic and potential energy along the joints' poses, as references for mass matrix and forces.

A body with mass m, first moment h and inertia tensor I in a frame whose pose is H (4x4) has

    T = trace(dH P dH^T)/2    with the 4x4 P = [[trace(I)/2 1 - I, h], [h^T, m]]
    U = -g . (m p + R h)

The bias forces are Lagrange's equations at constant rates, d/dt dT/d(dq) - dT/dq + dU/dq. A floating base has moved by
x = (v, w) to p + R v, R exp([w]); its twist is constant in its own axes where x accelerates by (w x v, 0).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from stiffgen.core.robot.chain import Chain, RigidBody
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.kernels.rounding import evaluate_longer


def _second_moments(body: RigidBody) -> ca.DM:
    """Return P of a body."""
    xx, xy, xz, yy, yz, zz = body.tensor
    tensor = ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moment = ca.DM(body.moment)
    return ca.blockcat([[ca.trace(tensor) / 2 * ca.DM.eye(3) - tensor, moment], [moment.T, body.mass]])


def potential_energy(chain: Chain, poses: Sequence[ca.SX], gravity: ca.SX) -> ca.SX:
    """Return the potential energy of all bodies from the poses of their joints' frames."""
    pairs = zip(chain.joints, poses, strict=True)
    moment = sum(((pose @ _second_moments(joint.body)[:, 3])[:3] for joint, pose in pairs), ca.SX.zeros(3))
    return ca.SX(-ca.dot(gravity, moment))


def differentiated(
    chain: Chain, poses: Sequence[ca.SX], moves: ca.SX, q: ca.SX, base_pose: ca.SX, samples: Sequence[FloatArray]
) -> dict[str, FloatArray]:
    """Return the values of the kernels of a robot's dynamics, by qualified name.

    Args:
        chain: the robot.
        poses: of its joints' frames, as expressions of the three arguments that follow.
        moves: motion of the base from its pose (6), no entries if it stands.
        q: joint positions.
        base_pose: row by row (16); nothing depends on it if the base stands.
        samples: stacks of joint positions, base poses, rates and accelerations of free fall.

    """
    coordinates, base_joints = ca.vertcat(moves, q), moves.shape[0]
    rates, gravity = ca.SX.sym("dq", *coordinates.shape), ca.SX.sym("g", 3)
    kinetic, potential = ca.SX(0), potential_energy(chain, poses, gravity)
    for joint, pose in zip(chain.joints, poses, strict=True):
        pose_rate = ca.jtimes(ca.vec(pose), coordinates, rates).reshape((4, 4))  # dH/dt
        kinetic += ca.trace(pose_rate @ _second_moments(joint.body) @ pose_rate.T) / 2
    mass_matrix, momentum = ca.hessian(kinetic, rates)  # T = dq^T M dq/2: its gradient is M dq
    stiffness, gradient = ca.hessian(potential, coordinates)
    # Lagrange's equations at constant rates: d/dt dT/d(dq) - dT/dq + dU/dq
    momentum_rate = ca.jtimes(momentum, coordinates, rates)
    forces = momentum_rate - ca.gradient(kinetic, coordinates) + gradient
    if base_joints:
        # The twist (v, w) of the base is constant in its own axes, which turn: x accelerates by (w x v, 0).
        v, w = rates[:3], rates[3:6]
        forces += mass_matrix[:, :3] @ ca.cross(w, v)
    expected = {
        "mass_matrix": mass_matrix,
        "bias_forces": forces,
        "gravity_energy": potential,
        "gravity_gradient": gradient,
        "gravity_joint_stiffness": stiffness,
    }
    symbols = [q, base_pose, rates, gravity]  # in the order of the samples
    columns = [stack.reshape(len(stack), -1).T for stack in samples]  # (entries, states)
    at_rest = ca.DM.zeros(base_joints)
    return {
        name: evaluate_longer(symbols, ca.substitute(expression, moves, at_rest), columns)
        for name, expression in expected.items()
    }
