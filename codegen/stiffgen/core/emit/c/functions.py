# SPDX-License-Identifier: MIT
"""Print the kernel table as C functions.

Every kernel is printed for one configuration; what runs over joints runs over vectors of joints there
(templates/lanes.c). Kernels with a batch are printed once more with every number replaced by a vector of
configurations, and, where CUDA is asked for, with plain numbers: one configuration per thread.
"""

from __future__ import annotations

from dataclasses import dataclass

from stiffgen.core.emit.c.printer import Printer
from stiffgen.core.lower.form import Function, Scope
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.lowering import LoweredKernels
from stiffgen.core.lower.steps import lowered
from stiffgen.core.lower.variant import Variant
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.program import Array


@dataclass(frozen=True)
class CFunction:
    """A C function: name without prefix, parameters, lines in its braces, operations, and the helpers it calls."""

    name: str
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    lines: tuple[str, ...]
    operations: Operations
    calls: frozenset[str]
    meaning: str = ""
    columns: frozenset[str] = frozenset()
    """Names of the parameters of an internal function that are columns of joints."""


@dataclass(frozen=True)
class VariantCode:
    """The functions printed for a variant: one per kernel, and the internal functions that these share."""

    variant: Variant
    scopes: tuple[Scope, ...]
    shared: tuple[tuple[Scope, CFunction], ...]
    kernels: tuple[tuple[Kernel, CFunction], ...]
    lowered: LoweredKernels
    """The lowered form that was printed."""

    @property
    def calls(self) -> frozenset[str]:
        """The helpers in C (templates) that the functions call."""
        return frozenset().union(*(function.calls for _, function in (*self.shared, *self.kernels)))


def print_kernels(chain: Chain, name: str, variant: Variant, options: KernelOptions) -> VariantCode:
    """Print the kernels of a chain for a variant; ``name`` is the prefix of public functions."""
    table = [kernel for kernel in chain_kernels(chain, options) if kernel.batch or not variant.batches]
    code = lowered(chain, variant)
    functions = [code.kernel(kernel) for kernel in table]
    printed: dict[int, CFunction] = {}

    def print_function(function: Function) -> CFunction:
        """Print a function once, those that it calls first: their operations count among its own."""
        if id(function) not in printed:
            printer = Printer(function, variant, lambda called: print_function(called).operations, name)
            lines = tuple(printer.print())
            printed[id(function)] = CFunction(
                function.name,
                function.inputs,
                function.outputs,
                lines,
                printer.operations,
                frozenset(printer.calls),
                function.meaning,
                function.columns,
            )
        return printed[id(function)]

    shared = tuple((function.scope, print_function(function)) for function in code.shared.values())
    kernels = tuple((kernel, print_function(function)) for kernel, function in zip(table, functions, strict=True))
    return VariantCode(variant, tuple(code.scopes.values()), shared, kernels, code)
