# SPDX-License-Identifier: MIT
"""Evaluate functions that a folder lacks (--kernels), because comparisons of other functions may need their values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.choices import ALL
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.result import as_results


def missing_functions(robot: GeneratedRobot) -> dict[str, Callable[..., Any]]:
    """Return a CasADi function of stacks for each function that the folder lacks, by qualified name."""
    if not robot.springs.groups:
        return {}
    present = {kernel.qualified_name for kernel in robot.table}
    everything = chain_kernels(robot.chain, replace(robot.springs, kernels=ALL))
    return {
        kernel.qualified_name: function_of_stacks(robot.chain, kernel)
        for kernel in everything
        if kernel.qualified_name not in present
    }


def function_of_stacks(chain: Chain, kernel: Kernel) -> Callable[..., Any]:
    """Return CasADi's function of a kernel, taking stacks of arguments."""
    function = casadi_function(chain, kernel)
    folds = [folded(argument.array(chain).shape) for argument in kernel.arguments]  # shapes in CasADi
    shapes = [result.array(chain).shape for result in kernel.results]

    def of_state(*values: FloatArray) -> tuple[FloatArray, ...]:
        """Return the results of one state in their shapes."""
        inputs = (value.reshape(fold) for value, fold in zip(values, folds, strict=True))
        results = zip(as_results(function(*inputs)), shapes, strict=True)
        return tuple(np.asarray(result).reshape(shape) for result, shape in results)

    def call(*stacks: FloatArray) -> Any:
        """Evaluate the CasADi function state by state and stack its results."""
        states = [of_state(*values) for values in zip(*stacks, strict=True)]
        results = tuple(np.stack(of_result) for of_result in zip(*states, strict=True))
        return results if len(results) > 1 else results[0]

    return call
