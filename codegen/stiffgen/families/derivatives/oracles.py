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
    """Return the gradients of v^T Kq v from the terms of Kq, each differentiated along v.

    A floating base moves three times: ``then`` for the Jacobian, ``first`` for its derivative along v, and the place's
    own motion for the gradient. The first two are zero afterwards.
    """
    place, base_joints, size = r.place, r.chain.base_joints, r.chain.dof
    first, then = (ca.SX.sym(name, base_joints) for name in ("s", "t"))
    v, F, K = ca.SX.sym("v", size), ca.SX.sym("F", 6), ca.SX.sym("K", 36)
    pose = product_of_poses(r.chain, place.q, place.base(first, then)) @ r.mounted
    jacobian = jacobian_of(pose, ca.vertcat(then, place.q), "hybrid")
    jacobian = ca.substitute(jacobian, then, ca.DM.zeros(base_joints))
    torque, twist = jacobian.T @ F, jacobian @ v
    connection = ca.diagcat(ca.SX(3, 3), -ca.skew(F[3:]) / 2)  # Gamma F, hybrid
    form = ca.jtimes(ca.dot(torque, v), ca.vertcat(first, place.q), v)
    form += twist.T @ (K.reshape((6, 6)) + connection) @ twist
    if base_joints:  # connection of the base's twist
        w, f = v[3:6], torque[:3]
        form -= ca.dot(v[:3], ca.cross(f, w)) + ca.dot(w, ca.cross(torque[3:6], w)) / 2
    form = ca.substitute(form, first, ca.DM.zeros(base_joints))
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
