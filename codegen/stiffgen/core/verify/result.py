# SPDX-License-Identifier: MIT
"""Describe the result of a check, and compute relative errors of arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from stiffgen.core.errors import BuildError, NoCompilerError
from stiffgen.core.robot.geometry import FloatArray

Kernels = Mapping[str, Callable[..., Any]]
"""Functions by qualified name ("hybrid_joint_stiffness"), taking stacks of arguments."""

Conclusion = Literal["ok", "FAILED", "not compared"]

NO_ORACLE = "no oracle"
"""Oracle's name in the table for a kernel whose values nothing independent confirms."""
BOUND = 1e-12
_FLOAT_BOUND = 1e-4


@dataclass(frozen=True)
class Check:
    """Row of the table: subject, oracle, and worst relative error over the samples.

    Where nothing is measured, ``error`` counts faults and ``bound`` is 0. ``detail`` says what is wrong, if known.
    ``errors`` are the relative errors of all samples, where they are kept. ``is_compared`` is false for a comparison
    that the folder calls for and that could not be made.
    """

    kernel: str
    oracle: str
    error: float
    bound: float
    detail: str = ""
    errors: FloatArray | None = field(default=None, compare=False, repr=False)
    is_compared: bool = True

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the bound, or the user accepts that nothing was compared."""
        return self.error <= self.bound

    @property
    def verdict(self) -> Conclusion:
        """The row's last word in the table."""
        if not self.is_compared:
            return "not compared"
        return "ok" if self.passed else "FAILED"


def bound_of(value: Any) -> float:
    """Return the tolerance of a number type relative to the largest entry: 1e-12, and 1e-4 for floats."""
    return _FLOAT_BOUND if np.asarray(value).dtype == np.float32 else BOUND


def compared(kernel: str, oracle: str, value: Any, reference: FloatArray) -> Check:
    """Check that ``value`` is ``reference`` within its type's bound."""
    errors = relative_errors(value, reference)
    return Check(kernel, oracle, _largest(errors), bound_of(value), _missing_numbers(value, reference), errors)


def _missing_numbers(value: Any, reference: FloatArray) -> str:
    """Return a sentence about states in which the reference or the result is NaN; "" if none is."""
    of_value, of_reference = (
        np.isnan(np.asarray(each, dtype=float)).reshape(len(reference), -1).any(axis=1) for each in (value, reference)
    )
    if of_reference.any():
        return f"the reference is NaN in {of_reference.sum()} of {len(reference)} states: nothing is compared there"
    if of_value.any():
        return f"the result is NaN in {of_value.sum()} of {len(reference)} states, the reference is a number"
    return ""


def faultless(kernel: str, oracle: str, faults: list[str]) -> Check:
    """Check that there are no faults; the first ones are named."""
    more = f" and {len(faults) - 3} more" if len(faults) > 3 else ""
    return Check(kernel, oracle, float(len(faults)), 0.0, "; ".join(faults[:3]) + more)


def left_out(kernel: str, reason: str) -> Check:
    """Return a row that passes, for a comparison that the folder does not call for."""
    return Check(kernel, f"nothing to compare: {reason}", 0.0, 0.0)


def not_compared(kernel: str, oracle: str, reason: str, *, is_accepted: bool = False) -> Check:
    """Return a row for a comparison that could not be made; it passes only if the user accepts that."""
    return Check(kernel, oracle, 0.0 if is_accepted else math.inf, 0.0, reason, is_compared=False)


def attempted(title: str, step: Callable[[], list[Check]]) -> list[Check]:
    """Return the rows of a step, or the row that tells why it ended before its end."""
    try:
        return step()
    except NoCompilerError as error:
        return [not_compared(title, "C", str(error))]
    except BuildError as error:
        return [Check(title, "compiles", math.inf, 0.0, str(error))]
    except (ValueError, TypeError, IndexError, KeyError, AttributeError) as error:
        # A folder that does not accept its own arguments has failed; the input is not to blame.
        return [Check(title, "runs", math.inf, 0.0, f"{type(error).__name__}: {error}")]


def relative_errors(value: Any, reference: FloatArray) -> FloatArray:
    """Return for every sample the largest difference over the largest entry of its reference; NaN if any is NaN."""
    if len(reference) == 0:
        return np.zeros(0)
    difference = np.abs(np.asarray(value, dtype=float) - reference).reshape(len(reference), -1).max(axis=1)
    scale = np.abs(reference).reshape(len(reference), -1).max(axis=1)
    scale[scale == 0] = 1.0
    return np.asarray(difference / scale, dtype=float)


def relative_error(value: Any, reference: FloatArray) -> float:
    """Return the largest difference of any sample over the largest entry of its reference; NaN if any is NaN."""
    return _largest(relative_errors(value, reference))


def _largest(errors: FloatArray) -> float:
    return float(errors.max()) if len(errors) else 0.0


def as_results(value: Any) -> tuple[Any, ...]:
    """Return the results of a function that returns one, or several in a tuple."""
    return tuple(value) if isinstance(value, (tuple, list)) else (value,)


def one_by_one(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of stacks that calls ``kernel`` once for each configuration: never its batch."""

    def call(*stacks: FloatArray) -> Any:
        rows = [as_results(kernel(*each)) for each in zip(*stacks, strict=True)]
        stacked = tuple(np.stack(column) for column in zip(*rows, strict=True))
        return stacked if len(stacked) > 1 else stacked[0]

    return call
