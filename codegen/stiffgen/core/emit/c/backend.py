# SPDX-License-Identifier: MIT
"""Describe the C library: single calls in NAME.c, batches in NAME_batch.c, and the header."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.c import CFunction, suffix_of
from stiffgen.core.emit.c.dispatch import DispatchedFunction, batch_function, batch_self_check, single_functions
from stiffgen.core.emit.pages import Definition, shared_functions
from stiffgen.core.emit.texts import declared, definition_comment, prototype, wrapped
from stiffgen.core.library import Library
from stiffgen.core.lower.variant import Variant
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.program import Array

SENSOR = Library(Path(__file__).parent / "library", "sensor.h", ("sensor.c",), inline=True)
"""Inline functions of every NAME_sensor.h."""


@dataclass(frozen=True)
class StoredResult:
    """A result of ``size`` numbers, of which ``stored`` are written.

    ``rows`` counts the rows of a matrix whose upper triangle is written; 0 for any other result.
    """

    name: str
    size: int
    stored: int
    rows: int


@dataclass(frozen=True)
class BatchPage:
    """Batches of a kernel.

    Attributes:
        definition: the function for one vector of configurations.
        qualified_name: name of the kernel.
        inputs, outputs: arrays of one configuration.
        functions: public functions that loop over vectors: prototype, and the results that they write.

    """

    definition: Definition
    qualified_name: str
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    functions: list[tuple[str, list[StoredResult]]]


def stored_result(chain: Chain, result: Argument, stored: Argument) -> StoredResult:
    """Describe a result and the part of it that is written."""
    whole, part = result.array(chain), stored.array(chain)
    return StoredResult(whole.name, whole.size, part.size, whole.shape[0] if part.shape != whole.shape else 0)


def one_configuration(variant: Variant, kernel: Kernel, function: CFunction) -> Definition:
    """Return the internal function that computes a kernel in a variant: one configuration per lane or thread."""
    parameters = [f"const {variant.number} {declared(array)}" for array in function.inputs]
    parameters += [f"{variant.number} {declared(array)}" for array in function.outputs]
    opening = f"{variant.qualifier} void {kernel.qualified_name}{suffix_of(variant)}("
    return Definition(definition_comment(kernel, function), prototype(opening, parameters), function.lines)


def _batch_page(chain: Chain, name: str, variant: Variant, kernel: Kernel, function: CFunction) -> BatchPage:
    """Describe the batches of a kernel; ``name`` is the robot's."""
    number, parameters = variant.scalar.name, ["size_t count"]
    for array in function.inputs:
        parameters += [f"const {number} *{array.name}", f"ptrdiff_t {array.name}_step"]
    parameters += [f"{number} *{array.name}" for array in function.outputs]
    functions = []
    for batch in kernel.batches:
        results = [stored_result(chain, *each) for each in zip(kernel.results, batch.results, strict=True)]
        functions.append((prototype(f"void {name}_{kernel.qualified_name}{batch.suffix}(", parameters), results))
    return BatchPage(
        one_configuration(variant, kernel, function),
        kernel.qualified_name,
        function.inputs,
        function.outputs,
        functions,
    )


def _with_called_helpers(calls: frozenset[str]) -> frozenset[str]:
    """Add the helpers that other helpers of macros.j2 call."""
    return calls | {"masked", "same"} if calls & {"pack_rows", "weigh_triangle"} else calls


def _in_lines(names: Iterable[str]) -> list[str]:
    return wrapped(", ".join(names), width=98)


def _public_functions(request: Request, batches: list[BatchPage]) -> list[DispatchedFunction]:
    """Return what NAME_dispatch.c defines: single calls, batches, and the self-check of each file."""
    name = request.name
    functions = list(single_functions(name, request.kernels))
    for page in batches:
        names = [array.name for array in page.inputs], [array.name for array in page.outputs]
        functions += [batch_function(name, opening, *names) for opening, _ in page.functions]
    return [*functions, batch_self_check(name)] if batches else functions


def _variables(request: Request) -> dict[str, Any]:
    """Return what the templates of C read: pages of functions, constants and shared helpers."""
    single, batch = request.single, request.batch
    batch_names = [
        f"{kernel.qualified_name}{each.suffix}" for kernel, _ in batch.kernels for each in kernel.batches
    ]  # fmt: skip
    batches = [_batch_page(request.chain, request.name, batch.variant, *each) for each in batch.kernels]
    return {
        "scopes": single.scopes,
        "shared": shared_functions(single),
        "batch_shared": shared_functions(batch),
        "batches": batches,
        "takes_symmetric_parts": any(array.symmetric_part for page in batches for array in page.inputs),
        "dispatched": _public_functions(request, batches),
        "kernel_names": _in_lines(kernel.qualified_name for kernel, _ in single.kernels),
        "batch_names": _in_lines(batch_names),
        "single": single.variant,
        "many": batch.variant,
        "calls": _with_called_helpers(single.calls | batch.calls),
        "rounding": request.ranges.lines(request.scalar),
        "digits": request.scalar.digits,
        "sensor_functions": SENSOR.functions(request.name),
        "sensor_text": json.dumps(request.chain.sensor.text) if request.chain.sensor else "",
    }


def _files(request: Request) -> dict[str, str]:
    """Return the C files of a request with their templates."""
    name = request.name
    files = {f"{name}.h": "header.h.j2", f"{name}_lanes.h": "lanes.h.j2", f"{name}.c": "source.c.j2"}
    if request.has_widths:
        files[f"{name}_dispatch.c"] = "dispatch.c.j2"
    if request.batch.kernels:
        files[f"{name}_batch.c"] = "batch.c.j2"
    if request.has_sensor_header:
        files[f"{name}_sensor.h"] = "sensor.h.j2"
    return files


BACKEND = Backend(Path(__file__).parent, _files, _variables)
