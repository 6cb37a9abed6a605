# SPDX-License-Identifier: MIT
"""Branches that a kernel takes: comparisons and choices of its CasADi function, state by state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.rounding import OPERATIONS, entries_of_stacks, run, truth

_CONDITIONS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
_PIECES: dict[int, Callable[..., FloatArray]] = {
    ca.OP_FMIN: lambda a, b: truth(a <= b), ca.OP_FMAX: lambda a, b: truth(a >= b),
    ca.OP_FABS: lambda a: truth(a >= 0), ca.OP_SIGN: lambda a: truth(a >= 0),
}  # fmt: skip


def choices(chain: Chain, kernel: Kernel, stacks: Sequence[FloatArray]) -> FloatArray | None:
    """Return which branches a kernel takes in each state: an array (states, conditions) of truth values.

    None where a user's potential has a function that has no rule here.
    """
    function, count = casadi_function(chain, kernel), len(stacks[0])
    made = [np.zeros(count)]

    def result(operation: int, *values: FloatArray) -> FloatArray:
        value = OPERATIONS[operation](*values)
        if operation in _CONDITIONS:
            made.append(value)
        elif operation in _PIECES:
            made.append(_PIECES[operation](*values))
        return value

    arguments = [list(entries.T) for entries in entries_of_stacks(function, stacks)]
    operations = {operation: partial(result, operation) for operation in OPERATIONS}
    try:
        with np.errstate(all="ignore"):
            run(function, arguments, partial(np.full, count), operations)
    except KeyError:
        return None
    return np.stack(made, axis=1)
