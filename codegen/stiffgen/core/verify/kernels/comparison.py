# SPDX-License-Identifier: MIT
"""Compare kernels with oracles, up to the rounding of contributions that cancel.

Errors are relative to the largest entry of the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from stiffgen.core.lower.scalar import scalar_of
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.verify.kernels.rounding import beyond_rounding, rounding_errors
from stiffgen.core.verify.result import Check, Kernels, as_results, compared


@dataclass(frozen=True)
class Oracle:
    """Independent source of a kernel's values.

    Attributes:
        name: name in the table of ``stiffgen verify``.
        values: function that returns the value of the only result, or a tuple for several, in all states. It takes
            the :class:`~stiffgen.core.verify.kernels.references.References` of the kernel's tip, or of the robot if it
            has none.
        loads: function of the references that returns the kernel's last arguments; without one, they are random.
        rounded: numbers whose rounding counts as in :func:`rounding_errors`, since the oracle uses them in another way.
        errors: function of the references that returns standard errors of the values, relative to a unit of the last
            place, for kernels whose own analysis does not see them.
        bound: tolerance relative to the largest entry of all states, in place of the type's.
        closed: whether ``values`` takes the projection at closed configurations (the family of loops).

    """

    name: str
    values: Callable[[Any], Any]
    loads: Callable[[Any], tuple[FloatArray, ...]] | None = None
    rounded: str = "constants"
    errors: Callable[[Any], FloatArray] | None = None
    bound: float | None = None
    closed: bool = False

    def checks(self, kernels: Kernels, chain: Chain, kernel: Kernel, at: Any) -> list[Check]:
        """Compare every result of a kernel; ``at`` is what ``values`` takes."""
        call = KernelCall(kernels, chain, kernel, self.arguments(kernel, at), self.rounded)
        return [self._check(call, k, reference, at) for k, reference in enumerate(as_results(self.values(at)))]

    def _check(self, call: KernelCall, k: int, reference: Any, at: Any) -> Check:
        """Compare the k-th result: up to its rounding, or within the oracle's own bound."""
        title, value = call.title(k), call.values[k]
        reference = np.reshape(reference, np.shape(value))
        if self.bound is None:
            return but_for_rounding(title, self.name, value, reference, partial(self._errors, call, k, at))
        scale = np.abs(reference).max(initial=0.0) or 1.0
        return Check(title, self.name, float(np.abs(value - reference).max(initial=0.0) / scale), self.bound)

    def _errors(self, call: KernelCall, k: int, at: Any) -> FloatArray:
        """Return the standard errors of the k-th result, as the oracle or the kernel's analysis states them."""
        if self.errors:
            return np.asarray(np.finfo(np.asarray(call.values[k]).dtype).eps * self.errors(at))
        return call.largest_errors(k) if self.rounded else np.zeros(np.shape(call.values[k]))

    def arguments(self, kernel: Kernel, at: Any) -> tuple[FloatArray, ...]:
        """Return the stacks of the kernel's arguments."""
        arguments: tuple[FloatArray, ...] = at.samples.of(kernel.arguments)
        loads = self.loads(at) if self.loads else ()
        return (*arguments[: len(arguments) - len(loads)], *loads)


@dataclass(frozen=True)
class KernelCall:
    """Call of a kernel with stacks of arguments: its results, and their rounding errors once somebody asks for them."""

    kernels: Kernels
    chain: Chain
    kernel: Kernel
    arguments: Sequence[FloatArray]
    rounded: str = ""

    @cached_property
    def values(self) -> tuple[Any, ...]:
        """Results."""
        return as_results(self.kernels[self.kernel.qualified_name](*self.arguments))

    @cached_property
    def errors(self) -> list[FloatArray] | None:
        """Standard errors of the results; None where they are unknown."""
        scalar = scalar_of(self.values[0])
        return rounding_errors(self.chain, self.kernel, list(self.arguments), scalar, rounded=self.rounded)

    def title(self, k: int) -> str:
        """Return the name of the kernel, with that of the result if there are several."""
        results = self.kernel.results
        return self.kernel.qualified_name + (f", {results[k].name}" if len(results) > 1 else "")

    def errors_of(self, k: int) -> FloatArray:
        """Return the standard errors of a result, zero where they are unknown."""
        return np.zeros(np.shape(self.values[k])) if self.errors is None else self.errors[k]

    def largest_errors(self, k: int) -> FloatArray:
        """Return the errors of a result, the largest one of a state for all its entries.

        Entries that are zero for orthonormal rotations are rounding in the reference.
        """
        errors = self.errors_of(k)
        per_state = np.nan_to_num(errors.reshape(len(errors), -1), nan=0.0, posinf=0.0).max(axis=1)
        return np.broadcast_to(per_state.reshape(-1, *[1] * (errors.ndim - 1)), errors.shape)


def but_for_rounding(
    name: str, oracle: str, value: Any, reference: FloatArray, errors: Callable[[], FloatArray]
) -> Check:
    """Compare a value with its reference; ``errors`` are computed where they differ, since contributions may cancel."""
    check = compared(name, oracle, value, reference)
    if check.passed or np.isnan(check.error):
        return check
    rest = beyond_rounding(np.asarray(value) - reference, errors())
    return compared(name, oracle, (reference + rest).astype(np.asarray(value).dtype), reference)


def symmetry(kernel: str, value: Any) -> Check:
    """Check that matrices are symmetric to the last bit."""
    matrices = np.asarray(value)
    difference = np.abs(matrices - np.swapaxes(matrices, 1, 2)).max()
    return Check(kernel, "bitwise symmetry", float(difference), 0.0)
