# SPDX-License-Identifier: MIT
"""Compare results with the rounding bounds that the folder's manifest states."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import Scalar
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.rounding import with_more_digits
from stiffgen.core.verify.result import Check, Kernels, as_results, left_out
from stiffgen.families.rounding.bounds import ErrorBounds, argument_sizes, chain_reach, kinds

CERTIFIED = "certified bound of rounding"
"""The oracle's name in the table: errors are fractions of the bound."""
_SLACK = 1.0 + 2.0 * float(np.finfo(np.longdouble).eps / np.finfo(float).eps)
"""Allowance for the reference's own error: the reference runs the same statements in longer numbers."""


def check_folder(
    variants: Sequence[Kernels], robot: GeneratedRobot, pool: Mapping[Argument, FloatArray], printed: str
) -> list[Check]:
    """Compare with the bounds of a folder's manifest, and these with the manifest that was ``printed`` again."""
    fresh = json.loads(printed)["rounding"]
    return check_certified_bounds(
        variants, robot.table, robot.chain, robot.scalar, robot.manifest["rounding"], fresh, pool
    )


def check_certified_bounds(
    variants: Sequence[Kernels],
    table: Sequence[Kernel],
    chain: Chain,
    scalar: Scalar,
    rounding: Mapping[str, Any],
    printed: Mapping[str, Any],
    pool: Mapping[Argument, FloatArray],
) -> list[Check]:
    """Verify that every function keeps to its bound, and that the stated bounds are those of the analysis.

    Args:
        variants: the functions, perhaps more than once (single calls, stacks).
        table: their records.
        chain: the robot.
        scalar: the type of number that the functions have.
        rounding: entry of the folder's manifest.
        printed: the same entry of the manifest that this generator prints.
        pool: random arguments; what is beyond the stated ranges is brought to their ends.

    """
    ranges = Ranges(**rounding["ranges"])
    bounds, checks = ErrorBounds(chain, ranges, scalar), []
    for kernel in table:
        name = kernel.qualified_name
        stated, fresh = (
            {(each["result"], each["what"]): each["bound"] for each in entry["bounds"].get(name, ())}
            for entry in (rounding, printed)
        )
        if stated != fresh:
            checks.append(Check(name, CERTIFIED, np.inf, 1.0, "the manifest's bound is not that of the analysis"))
        elif stated:
            stacks = within(chain, kernel, ranges, scalar, [pool[argument] for argument in kernel.arguments])
            fractions = _fractions([functions[name] for functions in variants], chain, kernel, stacks, stated)
            checks.append(Check(name, CERTIFIED, float(fractions.max()), _SLACK, errors=fractions))
        else:
            checks.append(left_out(name, f"no certified bound: {bounds.hindrance(kernel)}"))
    return checks


def within(
    chain: Chain, kernel: Kernel, ranges: Ranges, scalar: Scalar, stacks: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return stacks of a kernel's arguments in ``scalar``, clipped to the ranges of its bounds.

    Every second state has the largest rates, which the drawn ones do not reach.
    """
    reach = chain_reach(kernel.scope(chain), ranges, scalar)
    clipped = []
    for argument, stack in zip(kernel.arguments, stacks, strict=True):
        most = np.reshape(argument_sizes(chain, argument, ranges, reach, scalar), stack.shape[1:])
        inside = np.clip(stack, -most, most)
        if argument.largest == "rates":
            inside[::2] = np.copysign(most, stack[::2])
        clipped.append(inside.astype(scalar.dtype).astype(float))
    return clipped


def _fractions(
    functions: Sequence[Any],
    chain: Chain,
    kernel: Kernel,
    stacks: list[FloatArray],
    stated: Mapping[tuple[str, str], float],
) -> FloatArray:
    """Return for every state the largest error of any entry, as a fraction of the entry's bound."""
    count = len(stacks[0])
    exact = with_more_digits(chain, kernel, stacks)
    largest = np.zeros(count)
    for function in functions:
        values = [np.reshape(each, (count, -1)) for each in as_results(function(*stacks))]
        start = 0
        for result, value in zip(kernel.results, values, strict=True):
            array = result.array(chain)
            errors = np.abs(value - exact[:, start : start + array.size])
            start += array.size
            for what, _, entries in kinds(result, array):
                error, bound = errors[:, entries].max(axis=1).astype(float), stated[result.name, what]
                fraction = error / bound if bound else np.where(error == 0.0, 0.0, np.inf)
                largest = np.maximum(largest, fraction)  # keeps NaN
    return largest
