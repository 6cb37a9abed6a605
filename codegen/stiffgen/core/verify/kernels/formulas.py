# SPDX-License-Identifier: MIT
"""Compare kernels with the CasADi functions from which they were printed: printer and compiler, no derivation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument, Q
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.comparison import KernelCall, but_for_rounding
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import Check, Kernels, as_results

FAR = (1.5e4, -1.0e6, 3.0e9)
"""Angles beyond the range that the generated code reduces itself."""


def check_far_angles(kernels: Kernels, chain: Chain, seed: int, options: KernelOptions | None = None) -> list[Check]:
    """Compare kernels with the CasADi functions, with one joint many turns away at a time.

    Chains with mimic joints are left out: either code rounds multiplied and shifted positions in its own way.
    """
    turning = [k for k, coordinate in enumerate(chain.coordinates) if coordinate.type != "prismatic"]
    if chain.coupled or not turning:
        return []
    pool = argument_samples(chain, len(FAR) * len(turning), seed, options)
    for row, (angle, joint) in enumerate((angle, joint) for angle in FAR for joint in turning):
        pool[Q][row, joint] += math.tau * round(angle / math.tau)  # whole turns: closed loops remain closed
    return [replace(check, oracle="CasADi, many turns away") for check in compare(kernels, chain, pool, options)]


def check_against_casadi(
    kernels: Kernels, chain: Chain, count: int, seed: int, options: KernelOptions | None = None
) -> list[Check]:
    """Compare kernels with the CasADi functions of the same chain (the C printing and the compiler)."""
    pool = argument_samples(chain, count, seed, options)
    return compare(kernels, chain, pool, options)


@lru_cache(maxsize=1)
def _formulas(chain: Chain, options: KernelOptions | None) -> list[tuple[Kernel, Callable[..., Any]]]:
    """Return every kernel with its CasADi function; making the functions takes as long as all comparisons."""
    return [(kernel, function_of_stacks(chain, kernel)) for kernel in chain_kernels(chain, options)]


def compare(
    kernels: Kernels, chain: Chain, pool: dict[Argument, FloatArray], options: KernelOptions | None
) -> list[Check]:
    """Compare kernels with the CasADi functions at given arguments."""
    checks = []
    for kernel, function in _formulas(chain, options):
        call = KernelCall(kernels, chain, kernel, [pool[argument] for argument in kernel.arguments])
        for k, reference in enumerate(as_results(function(*call.arguments))):
            errors = partial(call.errors_of, k)
            checks.append(but_for_rounding(call.title(k), "closed form in CasADi", call.values[k], reference, errors))
    return checks
