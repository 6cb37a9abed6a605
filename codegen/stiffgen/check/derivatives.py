"""Vector-Jacobian products held against differences of the compiled functions that they belong to.

No symbolic differentiation enters: L(x) = sum of cotangents times results is evaluated along a random direction in all
arguments together, and the central difference of eighth order is compared with the sum of gradients times directions.
Its error is some 1e-13 of what is summed. Where a function is not eight times differentiable (the potential of the
joint limits at the edges of its zones, the cut locus of springs), states are chosen along which nothing is crossed: the
difference of sixth order must agree with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from stiffgen.check.result import Array, Check, Kernels, as_results
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kernels import Kernel

_EIGHTH = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
_SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
_STEP = 4e-3
"""Along a direction of about 1 in every angle [rad]; other arguments change by as much of their size."""
_DIRECTIONS = 3
_BOUND = 1e-10
_AGREE = 1e-8


def check_derivatives(kernels: Kernels, table: tuple[Kernel, ...], pool: Mapping[Argument, Array]) -> list[Check]:
    """Every NAME_vjp of the table against differences of NAME, at the states of the pool."""
    checks = []
    names = {kernel.qualified_name: kernel for kernel in table}
    for name, kernel in names.items():
        of = names.get(name.removesuffix("_vjp"))
        if of is not None and of is not kernel:
            checks.append(_check(kernels, of, kernel, pool))
    return checks


def _check(kernels: Kernels, of: Kernel, kernel: Kernel, pool: Mapping[Argument, Array]) -> Check:
    random = np.random.default_rng(2)
    values = [np.asarray(pool[argument], dtype=float) for argument in of.arguments]
    cotangents = [pool[argument] for argument in kernel.arguments[len(of.arguments) :]]
    gradients = as_results(kernels[kernel.qualified_name](*values, *cotangents))
    worst, used = 0.0, 0
    for _ in range(_DIRECTIONS):
        directions = [
            random.uniform(-1, 1, value.shape) * _scale(value, a) for value, a in zip(values, of.arguments, strict=True)
        ]
        losses = {
            k: _loss(kernels[of.qualified_name], values, directions, cotangents, k * _STEP)
            for k in range(-4, 5)
            if k != 0
        }
        eighth, sixth = (
            np.sum([w * (losses[k][0] - losses[-k][0]) for k, w in weights.items()], axis=0) / _STEP
            for weights in (_EIGHTH, _SIXTH)
        )
        terms = [_per_state(g * d) for g, d in zip(gradients, directions, strict=True)]
        products = [each.sum(axis=1) for each in terms]
        size = sum((np.abs(each).sum(axis=1) for each in terms), np.zeros(len(eighth)))
        size = np.maximum(size, 1e-3 * max(map(float, (np.max(losses[1][1]), 1e-300))))
        smooth = np.abs(eighth - sixth) <= _AGREE * size
        error = np.abs(sum(products, np.zeros(len(eighth))) - eighth) / size
        used += int(smooth.sum())
        if smooth.any():
            worst = max(worst, float(np.max(error[smooth])))
        if not np.isfinite(error).all():
            worst = math.inf
    if used < len(values[0]):  # of three directions each
        return Check(
            kernel.qualified_name, "differences of the function", math.inf, _BOUND, f"{used} states are smooth"
        )
    return Check(kernel.qualified_name, "differences of the function", worst, _BOUND)


def _loss(
    function: object, values: list[Array], directions: list[Array], cotangents: list[Array], step: float
) -> tuple[Array, Array]:
    """L and the size of what it sums, of every state, a step along the directions."""
    assert callable(function)
    results = as_results(function(*(v + step * d for v, d in zip(values, directions, strict=True))))
    terms = [_per_state(c * r) for c, r in zip(cotangents, results, strict=True)]
    total = sum((each.sum(axis=1) for each in terms), np.zeros(len(terms[0])))
    return total, sum((np.abs(each).sum(axis=1) for each in terms), np.zeros(len(terms[0])))


def _per_state(values: Array) -> Array:
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _scale(value: Array, argument: Argument) -> Array:
    """Directions of the size of the argument: joints by about 1, anything else by its own entries' size."""
    if argument.name == "q":
        return np.ones(1)
    sizes: Array = np.abs(_per_state(value)).max(axis=1).reshape(-1, *[1] * (value.ndim - 1))
    return np.minimum(sizes, 1.0) if argument.name in _WITH_TURNS else sizes


_WITH_TURNS = ("equilibrium", "equilibria", "tool_pose", "tool_poses")
"""Poses: their rotations are differentiated entry by entry, off the rotations."""
