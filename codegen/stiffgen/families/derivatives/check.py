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
from collections.abc import Callable, Mapping, Sequence
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
"""Weights of the central difference of eighth order, by the number of steps from the centre."""
_SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
_FOURTH = {1: 2 / 3, 2: -1 / 12}
_PLACES = range(-4, 5)
"""Places on a line at which a function is evaluated, in steps from the state; the differences do not read place 0."""
_STEP = 1e-3
"""Step along a direction of about 1 in every angle [rad]; other arguments change in proportion to their size."""
_DIRECTIONS = 3
"""Random directions per state."""
_Arrays = list[FloatArray]
"""One stack (states, ...) per argument, or per result."""
_BOUND = 1e-10
"""Largest error of a product, relative to the sum of its terms' magnitudes."""
_LEAST_SHARE = 1e-3
"""Least size of a product's terms, relative to those of L: where gradients are smaller, the rounding of L counts."""
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
class _ProbedLine:
    """Line through every state along a direction in all arguments together, on which L is differentiated.

    Attributes:
        chain: the robot.
        of: kernel whose results L weighs.
        values: the kernel's arguments in the states.
        cotangents: weights of the results.
        directions: change of each argument per unit of the line's length.

    """

    chain: Chain
    of: Kernel
    values: _Arrays
    cotangents: _Arrays
    directions: _Arrays

    def moved(self, step: float) -> _Arrays:
        """Return every argument after a step along the line."""
        return [
            _moved_base(value, step * direction) if argument.is_base_pose else value + step * direction
            for argument, value, direction in zip(self.of.arguments, self.values, self.directions, strict=True)
        ]

    def differences(self, function: Callable[..., Any]) -> _Differences:
        """Return the differences of L, from the kernel's compiled function."""
        terms = {k: _terms(function, self.moved(k * _STEP), self.cotangents) for k in _PLACES if k}

        def derivative(weights: Mapping[int, float]) -> FloatArray:
            changes = [weight * (terms[k] - terms[-k]).sum(axis=1) for k, weight in weights.items()]
            return np.asarray(np.sum(changes, axis=0) / _STEP)

        size = float(np.nanmax(np.abs(terms[1]).sum(axis=1), initial=1e-300))
        return _Differences(derivative(_EIGHTH), derivative(_SIXTH), derivative(_FOURTH), size)

    def products(self, gradients: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
        """Return the sum of gradients times directions in every state, and the sum of the terms' magnitudes."""
        product, size = np.zeros(len(self.values[0])), np.zeros(len(self.values[0]))
        for gradient, direction in zip(gradients, self.directions, strict=True):
            terms = _per_state(gradient * direction)
            product, size = product + terms.sum(axis=1), size + np.abs(terms).sum(axis=1)
        return product, size

    def noise(self) -> FloatArray:
        """Return the effect of the function's rounding on the difference of eighth order, in every state."""
        per_error = math.sqrt(2 * sum(weight**2 for weight in _EIGHTH.values())) / _STEP
        errors, squares = rounding_errors(self.chain, self.of, self.values) or [], np.zeros(len(self.values[0]))
        for cotangent, error in zip(self.cotangents, errors, strict=bool(errors)):
            squares = squares + ((_per_state(cotangent) * _per_state(error)) ** 2).sum(axis=1)
        return np.asarray(per_error * np.sqrt(squares))

    def keeps_branch(self) -> NDArray[np.bool_]:
        """Return for every state whether the function takes the same branches at all places on the line."""
        states, places = len(self.values[0]), [self.moved(k * _STEP) for k in _PLACES]
        at_all_places = [np.concatenate(stacks) for stacks in zip(*places, strict=True)]  # one place after the other
        branches = choices(self.chain, self.of, at_all_places)
        if branches is None:
            return np.ones(states, dtype=bool)
        by_place = branches.reshape(len(places), states, -1)  # (places, states, conditions)
        same: NDArray[np.bool_] = (by_place == by_place[0]).all(axis=(0, 2))
        return same


@dataclass(frozen=True)
class _Differences:
    """Differences of L of eighth, sixth and fourth order in every state, and the size of the terms of L."""

    eighth: FloatArray
    sixth: FloatArray
    fourth: FloatArray
    terms: float

    def agree(self, size: FloatArray) -> NDArray[np.bool_]:
        """Return for every state whether the orders agree, relative to a size: the line comes near no singularity."""
        from_sixth, from_fourth = np.abs(self.eighth - self.sixth), np.abs(self.eighth - self.fourth)
        agree: NDArray[np.bool_] = (from_sixth <= _AGREE[0] * size) & (from_fourth <= _AGREE[1] * size)
        return agree


def _errors(
    line: _ProbedLine, differences: _Differences, gradients: Sequence[Any]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the relative error of the gradients in every state, and in which states the function is smooth.

    Both questions that take long, rounding and branches, are asked only where an error is beyond its bound.
    """
    product, size = line.products(gradients)
    size = np.maximum(size, _LEAST_SHARE * differences.terms)
    smooth = differences.agree(size)
    difference = np.abs(product - differences.eighth)
    if (difference > _BOUND * size).any():  # contributions that cancel leave their rounding
        difference = beyond_rounding(difference, line.noise())
    error = difference / size
    if (error[smooth] > _BOUND).any():
        smooth = smooth & line.keeps_branch()
    return np.asarray(error), smooth


def _check(kernels: Kernels, of: Kernel, product: Kernel, chain: Chain, pool: Mapping[Argument, FloatArray]) -> Check:
    """Compare the kernel ``product`` with differences of ``of``, in all states in which ``of`` is a number.

    The check fails unless as many differences are smooth as there are states, of ``_DIRECTIONS`` in each.
    """
    random = np.random.default_rng(2)
    function = kernels[of.qualified_name]
    values = [np.asarray(pool[argument], dtype=float) for argument in of.arguments]
    cotangents = [pool[argument] for argument in product.arguments[len(of.arguments) :]]
    closes = np.isfinite(_terms(function, values, cotangents)).all(axis=1)  # NaN: loops do not close
    values, cotangents = [each[closes] for each in values], [each[closes] for each in cotangents]
    gradients = as_results(kernels[product.qualified_name](*values, *cotangents))
    worst, smooth_count = 0.0, 0
    for _ in range(_DIRECTIONS):
        directions = [
            random.uniform(-1, 1, gradient.shape) * _scale(value, argument)
            for gradient, value, argument in zip(gradients, values, of.arguments, strict=True)
        ]
        line = _ProbedLine(chain, of, values, cotangents, directions)
        differences = line.differences(function)
        error, smooth = _errors(line, differences, gradients)
        smooth_count += int(smooth.sum())
        worst = max(worst, float(np.max(error[smooth], initial=0.0)))
        is_number = np.isfinite(differences.eighth)
        if not np.isfinite(error[is_number]).all():  # the function is a number, the product is none
            worst = math.inf
    title = "differences of the function"
    if not closes.any() or smooth_count < closes.sum():
        return Check(product.qualified_name, title, math.inf, _BOUND, f"{smooth_count} states are smooth")
    return Check(product.qualified_name, title, worst, _BOUND)


def _moved_base(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Return poses (states, 4, 4) of the base after a motion by x = (v, w) to p + R v, R exp([w]).

    Rodrigues: exp([w]) = I + sin(a)/a [w] + (1 - cos a)/a^2 [w]^2 with the angle a = |w|.
    """
    v, w = twist[:, :3], twist[:, 3:]
    rotation, angle = pose[:, :3, :3], np.linalg.norm(w, axis=1)[:, None, None]
    turn = np.cross(np.eye(3), w[:, None, :])  # [w]
    sine = np.sinc(angle / np.pi)  # sin(a)/a: NumPy's sinc(x) is sin(pi x)/(pi x)
    cosine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2  # (1 - cos a)/a^2 = 2 sin(a/2)^2/a^2
    moved = pose.copy()
    moved[:, :3, 3] += np.einsum("sij,sj->si", rotation, v)
    moved[:, :3, :3] = rotation @ (np.eye(3) + sine * turn + cosine * (turn @ turn))
    return moved


def _terms(function: Callable[..., Any], values: _Arrays, cotangents: _Arrays) -> FloatArray:
    """Return the terms of L, cotangents times results, (states, terms).

    Terms are subtracted one by one: entries that do not change leave no rounding in a difference of L.
    """
    results = as_results(function(*values))
    return np.concatenate([_per_state(c * r) for c, r in zip(cotangents, results, strict=True)], axis=1)


def _per_state(values: FloatArray) -> FloatArray:
    """Return the entries of each state as a row."""
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _scale(value: FloatArray, argument: Argument) -> FloatArray:
    """Return scales of directions: 1 for angles and rotations, the size of its entries for any other argument."""
    if argument.turns:  # a pose's rotation is differentiated entry by entry, also away from rotations
        return np.ones(1)
    largest = np.abs(_per_state(value)).max(axis=1)  # of each state
    return np.asarray(largest.reshape(-1, *[1] * (value.ndim - 1)))
