# SPDX-License-Identifier: MIT
"""The hybrid joint stiffness as a user of JAX or PyTorch writes it: automatic differentiation, or a formula by hand.

A chain is any object with revolute ``joints`` (rotation, translation, axis) and ``tip_translation``: this module knows
nothing of stiffgen, so that it runs in a Python that has a framework alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


def _times(a: Any, b: Any) -> Any:
    """Multiply two numbers or arrays; constant zeros and ones cost nothing."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float) and one in (0.0, 1.0):
            return 0.0 if one == 0.0 else other
    return a * b


def _plus(a: Any, b: Any) -> Any:
    """Add two numbers or arrays; constant zeros cost nothing."""
    if isinstance(a, float) and a == 0.0:
        return b
    return a if isinstance(b, float) and b == 0.0 else a + b


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    total: Any = 0.0
    for x, y in zip(a, b, strict=True):
        total = _plus(total, _times(x, y))
    return total


def _cross(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [
        _plus(_times(a[i], b[j]), _times(-1.0, _times(a[j], b[i])))
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]  # fmt: skip


def by_hand(chain: Any, xp: Any, q: Sequence[Any], wrench: Sequence[Any], K: Any) -> list[Any]:
    """Return the upper triangle of the joint stiffness, row by row, each entry an array over the configurations.

    The formula is written out: dJ_i/dq_j is a cross product of columns of J. Entries that are constant zeros or ones
    are left out, so that a framework can fuse what remains into one loop over the configurations.

    Args:
        chain: the arm.
        xp: the framework's module, for sin and cos.
        q: an array of positions per joint.
        wrench: an array per entry.
        K: task stiffness (6, 6), an array of the framework.

    """
    rotation: list[list[Any]] = np.eye(3).tolist()
    origin: list[Any] = [0.0, 0.0, 0.0]
    axes, origins = [], []
    for k, joint in enumerate(chain.joints):
        axis = np.array(joint.axis, dtype=float)
        cross = np.cross(np.eye(3), axis)
        sine, versine = xp.sin(q[k]), 1.0 - xp.cos(q[k])
        origin = [_plus(o, _dot(row, list(joint.translation))) for o, row in zip(origin, rotation, strict=True)]
        square = cross @ cross
        turn = [
            [
                _plus(float(i == j), _plus(_times(sine, float(cross[i, j])), _times(versine, float(square[i, j]))))
                for j in range(3)
            ]
            for i in range(3)
        ]  # fmt: skip
        for matrix in (np.array(joint.rotation).tolist(), turn):
            rotation = [[_dot(row, [each[j] for each in matrix]) for j in range(3)] for row in rotation]
        axes.append([_dot(row, axis.tolist()) for row in rotation])
        origins.append(origin)
    tip = [_plus(o, _dot(row, list(chain.tip_translation))) for o, row in zip(origin, rotation, strict=True)]
    linear = [
        _cross(a, [_plus(t, _times(-1.0, o)) for t, o in zip(tip, each, strict=True)])
        for a, each in zip(axes, origins, strict=True)
    ]
    force, moment = list(wrench[:3]), list(wrench[3:])
    columns = [v + a for v, a in zip(linear, axes, strict=True)]
    loaded = []
    for v, a in zip(linear, axes, strict=True):  # (K + Gamma F) J_j
        product = [_dot([K[min(i, k), max(i, k)] for k in range(6)], v + a) for i in range(6)]
        twist = _cross(moment, a)
        loaded.append([*product[:3], *(_plus(p, _times(-0.5, t)) for p, t in zip(product[3:], twist, strict=True))])
    entries = []
    for i in range(len(axes)):
        for j in range(i, len(axes)):  # (dJ_i/dq_j) . F for j >= i: a_i x v_j, and half of the turning axes
            kinematic = _dot(_cross(axes[i], linear[j]), force)
            entries.append(_plus(_dot(columns[i], loaded[j]), kinematic))
    return entries
