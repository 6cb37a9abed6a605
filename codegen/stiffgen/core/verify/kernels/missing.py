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
    folds = [folded(argument.array(chain).shape) for argument in kernel.arguments]
    shapes = [result.array(chain).shape for result in kernel.results]

    def call(*stacks: FloatArray) -> Any:
        """Evaluate the CasADi function row by row and stack its results."""
        rows = [
            as_results(function(*(a.reshape(fold) for a, fold in zip(one, folds, strict=True))))
            for one in zip(*stacks, strict=True)
        ]
        columns = zip(zip(*rows, strict=True), shapes, strict=True)
        results = [np.stack([np.asarray(one).reshape(shape) for one in column]) for column, shape in columns]
        return tuple(results) if len(results) > 1 else results[0]

    return call
