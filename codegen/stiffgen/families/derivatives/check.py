# SPDX-License-Identifier: MIT
"""Compare vector-Jacobian products with differences of the compiled functions.

The comparison uses no symbolic differentiation. L(x) = sum of cotangents times results is evaluated along a random
direction in all arguments together. Its central difference of eighth order is compared with the sum of gradients times
directions; the error of the difference is some 1e-12 of the summed terms. A floating base moves along a twist in its
own axes, to p + R v, R exp([w]): the gradient with respect to ``base_pose`` belongs to these motions. Some functions
are not eight times differentiable everywhere (the potential of the joint limits at the edges of its zones, the cut
locus of springs), and closed loops have singularities. States are chosen whose direction comes near no such place: the
differences of sixth and fourth order must agree. Where loops do not close, ``close`` is NaN, and nothing is compared.
A difference within the function's rounding is no fault, because contributions that cancel leave only rounding
(:mod:`stiffgen.core.verify.kernels.rounding`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.rounding import beyond_rounding, rounding_errors
from stiffgen.core.verify.result import Check, Kernels, as_results
from stiffgen.families.derivatives.branches import choices

_EIGHTH = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
_SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
_FOURTH = {1: 2 / 3, 2: -1 / 12}
_STEP = 1e-3
"""Step along a direction of about 1 in every angle [rad]; other arguments change in proportion to their size."""
_DIRECTIONS = 3
_Arrays = list[FloatArray]
_BOUND = 1e-10
_AGREE = 1e-9, 1e-6
"""Largest changes from sixth and fourth order to eighth. At a distance d from a singularity of the type 1 / d, they are
36 (h/d)^6 and 4 (h/d)^4 for steps h, and the error of eighth order is 576 (h/d)^8: at most 5e-12."""


def check_derivatives(
    kernels: Kernels, table: tuple[Kernel, ...], chain: Chain, pool: Mapping[Argument, FloatArray]
) -> list[Check]:
    """Compare every NAME_vjp of the kernel table with finite differences of NAME.

    The pool has the states: values of every argument.
    """
    checks = []
    names = {(kernel.path, kernel.name): kernel for kernel in table}
    for kernel in table:
        of = names.get((kernel.path, kernel.product_of))
        if of is not None:
            checks.append(_check(kernels, of, kernel, chain, pool))
    return checks


@dataclass(frozen=True)
class _Differences:
    """Differences of L of eighth, sixth and fourth order in every state, and the size of the terms of L."""

    eighth: FloatArray
    sixth: FloatArray
    fourth: FloatArray
    terms: float

    @staticmethod
    def along(call: Any, of: Kernel, values: _Arrays, cotangents: _Arrays, directions: _Arrays) -> _Differences:
        """Return the differences along directions in all arguments together."""
        steps = [k for k in range(-4, 5) if k != 0]
        moved = {k: _terms(call, _moved(of, values, directions, k * _STEP), cotangents) for k in steps}
        eighth, sixth, fourth = (
            np.sum([w * (moved[k] - moved[-k]).sum(axis=1) for k, w in weights.items()], axis=0) / _STEP
            for weights in (_EIGHTH, _SIXTH, _FOURTH)
        )
        terms = float(np.nanmax(np.abs(moved[1]).sum(axis=1), initial=1e-300))
        return _Differences(eighth, sixth, fourth, terms)

    def errors(
        self, chain: Chain, of: Kernel, at: tuple[_Arrays, _Arrays, _Arrays], gradients: Sequence[Any]
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the relative error of the gradients in every state, and in which states the function is smooth.

        Both questions that take long, rounding and branches, are asked only where an error is beyond its bound.
        """
        values, cotangents, directions = at
        terms = [_per_state(g * d) for g, d in zip(gradients, directions, strict=True)]
        product = sum((each.sum(axis=1) for each in terms), np.zeros(len(self.eighth)))
        size = sum((np.abs(each).sum(axis=1) for each in terms), np.zeros(len(self.eighth)))
        # Where the gradients are small, the rounding of the terms of L sets the scale.
        size = np.maximum(size, 1e-3 * self.terms)
        changes = np.abs(self.eighth - self.sixth), np.abs(self.eighth - self.fourth)
        smooth = (changes[0] <= _AGREE[0] * size) & (changes[1] <= _AGREE[1] * size)
        difference = np.abs(product - self.eighth)
        if (difference > _BOUND * size).any():  # contributions that cancel leave their rounding
            difference = beyond_rounding(difference, _noise(chain, of, values, cotangents))
        error = difference / size
        if (error[smooth] > _BOUND).any():
            smooth = smooth & _keeps_branch(chain, of, values, directions)
        return np.asarray(error), smooth


def _check(kernels: Kernels, of: Kernel, kernel: Kernel, chain: Chain, pool: Mapping[Argument, FloatArray]) -> Check:
    """Compare the product ``kernel`` with differences of ``of``, in all states in which ``of`` is a number.

    The check fails unless as many differences are smooth as there are states, of ``_DIRECTIONS`` in each.
    """
    random = np.random.default_rng(2)
    values = [np.asarray(pool[argument], dtype=float) for argument in of.arguments]
    cotangents = [pool[argument] for argument in kernel.arguments[len(of.arguments) :]]
    closes = np.isfinite(_terms(kernels[of.qualified_name], values, cotangents)).all(axis=1)  # NaN: loops do not close
    values, cotangents = ([each[closes] for each in arrays] for arrays in (values, cotangents))
    gradients = as_results(kernels[kernel.qualified_name](*values, *cotangents))
    worst, used = 0.0, 0
    for _ in range(_DIRECTIONS):
        directions = [
            random.uniform(-1, 1, gradient.shape) * _scale(value, argument)
            for gradient, value, argument in zip(gradients, values, of.arguments, strict=True)
        ]
        differences = _Differences.along(kernels[of.qualified_name], of, values, cotangents, directions)
        error, smooth = differences.errors(chain, of, (values, cotangents, directions), gradients)
        used += int(smooth.sum())
        worst = max(worst, float(np.max(error[smooth], initial=0.0)))
        if not np.isfinite(error[np.isfinite(differences.eighth)]).all():  # the product is none where the function is
            worst = math.inf
    title = "differences of the function"
    if not closes.any() or used < closes.sum():
        return Check(kernel.qualified_name, title, math.inf, _BOUND, f"{used} states are smooth")
    return Check(kernel.qualified_name, title, worst, _BOUND)


def _keeps_branch(
    chain: Chain, of: Kernel, values: list[FloatArray], directions: list[FloatArray]
) -> NDArray[np.bool_]:
    """Return for every state whether the function takes the same branches at all steps along the direction."""
    places = [_moved(of, values, directions, k * _STEP) for k in range(-4, 5)]
    branches = choices(chain, of, [np.concatenate(each) for each in zip(*places, strict=True)])
    if branches is None:
        return np.ones(len(values[0]), dtype=bool)
    by_step = branches.reshape(len(places), len(values[0]), -1)
    same: NDArray[np.bool_] = (by_step == by_step[0]).all(axis=(0, 2))
    return same


def _moved(of: Kernel, values: list[FloatArray], directions: list[FloatArray], step: float) -> list[FloatArray]:
    """Return every argument after a step along its direction."""
    return [
        _moved_base(value, step * direction) if argument.is_base_pose else value + step * direction
        for argument, value, direction in zip(of.arguments, values, directions, strict=True)
    ]


def _moved_base(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Return poses (4, 4) of the base after a motion to p + R v, R exp([w]), by Rodrigues' formula."""
    rotation, angle = pose[:, :3, :3], np.linalg.norm(twist[:, 3:], axis=1)[:, None, None]
    turn = np.cross(np.eye(3), twist[:, None, 3:])  # [w]
    exponential = np.eye(3) + np.sinc(angle / np.pi) * turn + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (turn @ turn)
    moved = pose.copy()
    moved[:, :3, 3] += np.einsum("sij,sj->si", rotation, twist[:, :3])
    moved[:, :3, :3] = rotation @ exponential
    return moved


def _terms(function: object, values: list[FloatArray], cotangents: list[FloatArray]) -> FloatArray:
    """Return the terms of L for every state.

    Terms are subtracted one by one: entries that do not change leave no rounding in a difference of L.
    """
    assert callable(function)
    results = as_results(function(*values))
    return np.concatenate([_per_state(c * r) for c, r in zip(cotangents, results, strict=True)], axis=1)


def _noise(chain: Chain, of: Kernel, values: list[FloatArray], cotangents: list[FloatArray]) -> FloatArray:
    """Return the effect of rounding on the difference of eighth order of L."""
    spread = math.sqrt(2 * sum(weight**2 for weight in _EIGHTH.values())) / _STEP
    errors = rounding_errors(chain, of, values) or []
    squares = [(_per_state(c) * _per_state(e)) ** 2 for c, e in zip(cotangents, errors, strict=bool(errors))]
    return spread * np.sqrt(sum((each.sum(axis=1) for each in squares), np.zeros(len(values[0]))))


def _per_state(values: FloatArray) -> FloatArray:
    """Return the entries of each state as a row."""
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _scale(value: FloatArray, argument: Argument) -> FloatArray:
    """Return scales of directions: 1 for angles and rotations, the size of its entries for any other argument."""
    if argument.turns:  # a pose's rotation is differentiated entry by entry, also away from rotations
        return np.ones(1)
    return np.asarray(np.abs(_per_state(value)).max(axis=1).reshape(-1, *[1] * (value.ndim - 1)))
