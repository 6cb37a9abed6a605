# SPDX-License-Identifier: MIT
"""Oracle of the gradient along a direction."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.poses import jacobian_of, product_of_poses
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH, References, as_columns
from stiffgen.core.verify.kernels.samples import symmetric
from stiffgen.families.derivatives.direction import DIRECTION


def gradient_along(r: References, directions: FloatArray, task_stiffness: FloatArray) -> FloatArray:
    """Return the gradients (samples, n) of v^T Kq v from the terms of Kq, each differentiated along v.

    With Kq of docs/theory.md (3), v^T Kq v is the derivative of v . J^T F along v, plus (J v)^T (K + Gamma F) J v, less
    the connection of a floating base. The base moves three times: for the Jacobian, for its derivative along v, and by
    the place's own motion for the gradient. The first two motions are zero afterwards.
    """
    place, base_joints, size = r.place, r.chain.base_joints, r.chain.dof
    moves_of_jacobian, moves_along_v = ca.SX.sym("t", base_joints), ca.SX.sym("s", base_joints)
    at_rest = ca.DM.zeros(base_joints)
    v, F, K = ca.SX.sym("v", size), ca.SX.sym("F", 6), ca.SX.sym("K", 36)
    pose = product_of_poses(r.chain, place.q, place.base(moves_along_v, moves_of_jacobian)) @ r.mounted
    J = jacobian_of(pose, ca.vertcat(moves_of_jacobian, place.q), "hybrid")
    J = ca.substitute(J, moves_of_jacobian, at_rest)
    torque, twist = J.T @ F, J @ v
    gamma_F = ca.diagcat(ca.SX(3, 3), -ca.skew(F[3:]) / 2)  # docs/theory.md (4)
    form = ca.jtimes(ca.dot(torque, v), ca.vertcat(moves_along_v, place.q), v)
    form += twist.T @ (K.reshape((6, 6)) + gamma_F) @ twist
    if base_joints:  # v^T (Gamma tau) v of the base's body twist (linear, angular) and its generalised force (f, m)
        linear, angular, f, m = v[:3], v[3:6], torque[:3], torque[3:6]
        form -= ca.dot(linear, ca.cross(f, angular)) + ca.dot(angular, ca.cross(m, angular)) / 2
    form = ca.substitute(form, moves_along_v, at_rest)
    stiffness = np.broadcast_to(task_stiffness, (len(directions), 6, 6))
    columns = [as_columns(each) for each in (directions, r.samples[WRENCH], stiffness)]
    return r.evaluate(ca.gradient(form, place.coordinates), [v, F, K], columns)[..., 0]


ORACLES = {
    "hybrid_stiffness_direction_gradient": (
        Oracle(
            "form differentiated along v",
            lambda r: gradient_along(r, r.samples[DIRECTION], symmetric(r.samples[TASK_STIFFNESS])),
        ),
    ),
}
