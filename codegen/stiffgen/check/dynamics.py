"""Oracles for what a robot's masses make: kinetic and potential energy along its joints' poses, differentiated.

A body with mass m, first moment h and inertia tensor I in a frame whose pose is H (4x4) has

    T = trace(dH P dH^T)/2    with the 4x4 P = [[trace(I)/2 1 - I, h], [h^T, m]]
    U = -g . (m p + R h)

The bias forces are Lagrange's equations at constant rates, d/dt dT/d(dq) - dT/dq + dU/dq.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from stiffgen.check.result import Array
from stiffgen.robot.chain import Body, Chain


def _second_moments(body: Body) -> ca.DM:
    """P of a body."""
    xx, xy, xz, yy, yz, zz = body.tensor
    tensor = ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moment = ca.DM(body.moment)
    return ca.blockcat([[ca.trace(tensor) / 2 * ca.DM.eye(3) - tensor, moment], [moment.T, body.mass]])


def differentiated(
    chain: Chain, poses: Sequence[ca.SX], q: ca.SX, samples: tuple[Array, Array, Array]
) -> dict[str, Array]:
    """What the kernels of a robot's dynamics give, by qualified name.

    Args:
        chain: the robot.
        poses: of its joints' frames in the base, as expressions of q.
        q: its symbol.
        samples: stacks of joint positions, rates and accelerations of free fall.

    """
    rates, gravity = ca.SX.sym("dq", *q.shape), ca.SX.sym("g", 3)
    kinetic, potential = ca.SX(0), ca.SX(0)
    for joint, pose in zip(chain.joints, poses, strict=True):
        moments = _second_moments(joint.body)
        moving = ca.jtimes(ca.vec(pose), q, rates).reshape((4, 4))
        kinetic += ca.trace(moving @ moments @ moving.T) / 2
        potential -= ca.dot(gravity, (pose @ moments[:, 3])[:3])
    mass_matrix, momentum = ca.hessian(kinetic, rates)
    stiffness, gradient = ca.hessian(potential, q)
    forces = ca.jtimes(momentum, q, rates) - ca.gradient(kinetic, q) + gradient
    expected = {
        "mass_matrix": mass_matrix,
        "bias_forces": forces,
        "gravity_energy": potential,
        "gravity_gradient": gradient,
        "gravity_joint_stiffness": stiffness,
    }
    function = ca.Function("f", [q, rates, gravity], [ca.densify(each) for each in expected.values()], {})
    values = zip(*(function(*each) for each in zip(*samples, strict=True)), strict=True)
    results = {name: np.array([np.asarray(one) for one in each]) for name, each in zip(expected, values, strict=True)}
    shapes = {"gravity_energy": (), "gravity_gradient": q.shape[:1], "bias_forces": q.shape[:1]}
    return {name: each.reshape(len(each), *shapes.get(name, each.shape[1:])) for name, each in results.items()}
