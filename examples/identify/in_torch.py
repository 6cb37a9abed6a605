# SPDX-License-Identifier: MIT
"""Compute the loss and its gradient in PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from examples.identify.recording import LOWER, POSTURE_STIFFNESS, SCALE, Array, Recording


def unpacked(parameters: Any) -> tuple[Any, Any]:
    """Return task stiffness (6, 6), positive definite by construction, and tool (3,) from 24 parameters."""
    lower = torch.zeros((6, 6), dtype=torch.float64).index_put(tuple(map(torch.as_tensor, LOWER)), parameters[:21])
    factor = lower * torch.as_tensor(SCALE)[:, None]
    return factor @ factor.T, 0.1 * parameters[21:]


def objective(robot: Any, recording: Recording) -> Callable[[Array], tuple[float, Array]]:
    """Return the loss of :mod:`examples.identify.recording` and its gradient; ``robot`` is NAME.torch."""
    q, wrench, push, deflection, deflection_variance, push_variance, load_covariance = map(
        torch.as_tensor,
        (
            recording.q, recording.wrench, recording.push, recording.deflection,
            recording.deflection_variance, recording.push_variance, recording.load_covariance,
        ),
    )  # fmt: skip
    eye = torch.eye(4, dtype=torch.float64)

    def evaluated(parameters: Array) -> tuple[float, Array]:
        given = torch.tensor(parameters, requires_grad=True)
        stiffness, tool = unpacked(given)
        pose = torch.cat([eye[:, :3], torch.cat([tool, eye[3, 3:]])[:, None]], dim=1)
        joint = robot.hybrid.joint_stiffness(q, pose, wrench, stiffness)
        joint = joint + POSTURE_STIFFNESS * torch.eye(q.shape[1], dtype=torch.float64)
        jacobian = robot.hybrid.jacobian(q, pose)
        left = torch.einsum("nij,nj->ni", joint, deflection) - torch.einsum("nki,nk->ni", jacobian, push)
        covariance = joint * deflection_variance @ joint + jacobian.mT * push_variance @ jacobian
        factor = torch.linalg.cholesky(covariance + load_covariance)
        white = torch.linalg.solve_triangular(factor, left[:, :, None], upper=False)
        logarithms = factor.diagonal(dim1=1, dim2=2).log()
        loss = ((white**2).sum() / 2 + logarithms.sum()) / len(q)
        loss.backward()
        assert given.grad is not None
        return float(loss.detach()), given.grad.numpy()

    return evaluated
