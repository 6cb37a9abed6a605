# SPDX-License-Identifier: MIT
"""The hybrid joint stiffness as a user of JAX or PyTorch writes it: automatic differentiation.

A chain is any object with revolute ``joints`` (rotation, translation, axis) and ``tip_translation``: this module knows
nothing of stiffgen, so that it runs in a Python that has a framework alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def automatic(chain: Any, xp: Any, stack: Callable[..., Any]) -> tuple[Any, Any]:
    """Jacobian (6, 7) of q, and the matrix [v], in a framework's own operations; ``stack(columns, axis)``."""

    def skew(v: Any) -> Any:
        zero = 0 * v[0]
        rows = [stack(row, 0) for row in ([zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero])]
        return stack(rows, 0)

    def jacobian(q: Any, constant: Any) -> Any:
        rotation, origin, axes, origins = constant(np.eye(3)), constant(np.zeros(3)), [], []
        for k, joint in enumerate(chain.joints):
            axis = np.array(joint.axis)
            cross = np.cross(np.eye(3), axis)  # [axis]
            origin = origin + rotation @ constant(np.array(joint.translation))
            turn = constant(np.eye(3)) + xp.sin(q[k]) * constant(cross) + (1 - xp.cos(q[k])) * constant(cross @ cross)
            rotation = rotation @ constant(np.array(joint.rotation)) @ turn
            axes.append(rotation @ constant(axis))
            origins.append(origin)
        tip = origin + rotation @ constant(np.array(chain.tip_translation))
        linear = stack([skew(a) @ (tip - o) for a, o in zip(axes, origins, strict=True)], 1)
        return xp.concatenate([linear, stack(axes, 1)], 0)

    return jacobian, skew


def jax_functions(chain: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return joint stiffness (q, F, K) and Hessian dJ/dq (q) of one configuration, by JAX's forward mode."""
    import jax
    import jax.numpy as jnp

    plain, skew = automatic(chain, jnp, jnp.stack)

    def jacobian(q: Any) -> Any:
        return plain(q, jnp.asarray)

    def stiffness(q: Any, F: Any, K: Any) -> Any:
        A = K.at[3:, 3:].add(-skew(F[3:] / 2))
        return jax.jacfwd(lambda x: jacobian(x).T @ F)(q) + jacobian(q).T @ A @ jacobian(q)

    def hessian(q: Any) -> Any:
        return jnp.transpose(jax.jacfwd(jacobian)(q), (2, 1, 0))

    return stiffness, hessian


def torch_functions(chain: Any, K: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return joint stiffness (q, F) and Hessian dJ/dq (q) of one configuration, by torch.func; K is a tensor (6, 6)."""
    import torch

    plain, skew = automatic(chain, torch, lambda values, axis: torch.stack(list(values), axis))
    place = {"dtype": torch.float64, "device": K.device}
    empty, corner = torch.zeros((3, 6), **place), torch.zeros((3, 3), **place)

    def jacobian(q: Any) -> Any:
        return plain(q, lambda values: torch.as_tensor(values, **place))

    def stiffness(q: Any, F: Any) -> Any:
        moment = torch.cat([corner, skew(F[3:] / 2)], 1)
        J = jacobian(q)
        return torch.func.jacfwd(lambda x: jacobian(x).T @ F)(q) + J.T @ (K - torch.cat([empty, moment])) @ J

    def hessian(q: Any) -> Any:
        return torch.func.jacfwd(jacobian)(q).permute(2, 1, 0)

    return stiffness, hessian
