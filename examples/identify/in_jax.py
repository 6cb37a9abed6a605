# SPDX-License-Identifier: MIT
"""Compute the loss and its gradient in JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from examples.identify.recording import LOWER, POSTURE_STIFFNESS, SCALE, Array, Recording


def unpacked(parameters: Any) -> tuple[Any, Any]:
    """Return task stiffness (6, 6), positive definite by construction, and tool (3,) from 24 parameters."""
    factor = jnp.zeros((6, 6)).at[LOWER].set(parameters[:21]) * SCALE[:, None]
    return factor @ factor.T, 0.1 * parameters[21:]


def objective(robot: Any, recording: Recording) -> Callable[[Array], tuple[float, Array]]:
    """Return the loss of :mod:`examples.identify.recording` and its gradient; ``robot`` is NAME.jax."""
    q, wrench, push, deflection = map(
        jnp.asarray, (recording.q, recording.wrench, recording.push, recording.deflection)
    )

    def loss(parameters: Any) -> Any:
        stiffness, tool = unpacked(parameters)
        pose = jnp.eye(4).at[:3, 3].set(tool)
        joint = robot.hybrid.joint_stiffness(q, pose, wrench, stiffness) + POSTURE_STIFFNESS * jnp.eye(q.shape[1])
        jacobian = robot.hybrid.jacobian(q, pose)
        left = jnp.einsum("nij,nj->ni", joint, deflection) - jnp.einsum("nki,nk->ni", jacobian, push)
        covariance = joint * recording.deflection_variance @ joint + jacobian.mT * recording.push_variance @ jacobian
        factor = jnp.linalg.cholesky(covariance + recording.load_covariance)
        white = jax.scipy.linalg.solve_triangular(factor, left[:, :, None], lower=True)
        logarithms = jnp.log(jnp.diagonal(factor, axis1=1, axis2=2))
        return ((white**2).sum() / 2 + logarithms.sum()) / len(q)

    compiled = jax.jit(jax.value_and_grad(loss))

    def evaluated(parameters: Array) -> tuple[float, Array]:
        value, gradient = compiled(parameters)
        return float(value), np.asarray(gradient)

    return evaluated
