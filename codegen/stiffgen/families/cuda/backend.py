# SPDX-License-Identifier: MIT
"""Describe NAME.cu and NAME_cuda.h: the kernels that have a batch, one configuration per thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.c import CFunction, VariantCode
from stiffgen.core.emit.c.backend import StoredResult, one_configuration, stored_result
from stiffgen.core.emit.pages import Definition, shared_functions
from stiffgen.core.emit.texts import extents, prototype, wrapped
from stiffgen.core.errors import ChainError
from stiffgen.core.lower.variant import CUDA as VARIANT
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import MAX_BATCH_JOINTS, Kernel
from stiffgen.core.symbolic.program import Array


@dataclass(frozen=True)
class Launch:
    """A CUDA kernel and the function that launches it.

    Each configuration has its own vectors and cotangents. A varying argument has a stride of its own, 0 for one that
    all configurations share; all configurations share every other argument.

    Attributes:
        name: name of the kernel and its launch function, without the suffixes.
        kernel: prototype of the function that runs all configurations.
        prototype: launch function.
        own: arguments of which every configuration has its own.
        varying: arguments of which every configuration may have its own.
        symmetric: stiffnesses that all configurations share; each block of threads takes their symmetric parts once.
        arrays: arguments of the kernel in the launch function: arrays, strides, and results.
        values: arguments of the thread's function.
        traffic: numbers read and written per configuration, in words.
        documentation: comment above the launch function, in lines.

    """

    name: str
    kernel: str
    prototype: str
    own: list[Array]
    varying: list[Array]
    symmetric: list[Array]
    arrays: list[str]
    values: list[str]
    traffic: str
    documentation: list[str]


@dataclass(frozen=True)
class ThreadPage:
    """The function of one thread, and the CUDA kernels that call it.

    Attributes:
        definition: function of one thread.
        qualified_name: name of the kernel.
        results: results, and the part of them that is written.
        launches: kernel with shared matrices and, where there are any, the kernel with matrices per configuration.

    """

    definition: Definition
    qualified_name: str
    results: list[StoredResult]
    launches: list[Launch]


def _is_own(argument: Argument) -> bool:
    """Return whether every configuration has its own value in any case: vectors, cotangents."""
    return len(argument.shape) == 1 or argument.per_configuration


def _thread_page(request: Request, code: VariantCode, kernel: Kernel, function: CFunction) -> ThreadPage:
    """Describe a kernel; a second CUDA kernel, NAME_each, is made where the first shares a matrix."""
    # matrices that all configurations share in NAME, except those that may vary there, too, such as the equilibrium
    shared = [a for a in kernel.arguments if not _is_own(a)]
    varying = [a for a in shared if a.varying]
    launches = [_launch(request, kernel, function, kernel.qualified_name, varying)]
    if varying != shared:
        launches.append(_launch(request, kernel, function, f"{kernel.qualified_name}_each", shared))
    return ThreadPage(
        definition=one_configuration(code.variant, kernel, function),
        qualified_name=kernel.qualified_name,
        results=[stored_result(request.chain, result, result.packed()) for result in kernel.results],
        launches=launches,
    )


def _launch(request: Request, kernel: Kernel, function: CFunction, name: str, varying: list[Argument]) -> Launch:
    """Describe a CUDA kernel; ``varying`` are the matrices that have a stride."""
    number, strides = request.scalar.name, {argument.name for argument in varying}
    parameters, arrays = _parameters(function, number, strides)
    without_aliases = [text.replace("*", "*__restrict__ ") for text in parameters]
    sizes = ["size_t count", "size_t stride"]
    own = [a for argument, a in zip(kernel.arguments, function.inputs, strict=True) if _is_own(argument)]
    with_stride = [array for array in function.inputs if array.name in strides]
    loaded = {array.name for array in (*own, *with_stride)}  # of which a thread copies its configuration's values
    symmetric = [array for array in function.inputs if array.symmetric_part and array.name not in loaded]
    suffixes = dict.fromkeys(loaded, "_of_one") | {array.name: "_of_all" for array in symmetric}
    stored = [result.packed().array(request.chain) for result in kernel.results]
    return Launch(
        name=name,
        kernel=prototype(f"KERNEL {name}_kernel(", sizes + without_aliases),
        prototype=prototype(f"int {request.name}_{name}_cuda(", [*sizes, *parameters, "void *stream"]),
        own=own,
        varying=with_stride,
        symmetric=symmetric,
        arrays=arrays,
        values=[a.name + suffixes.get(a.name, "") for a in function.inputs],
        traffic=_traffic([*own, *stored], with_stride, number),
        documentation=_documentation(request.chain, kernel, varying),
    )


def _parameters(function: CFunction, number: str, strides: set[str]) -> tuple[list[str], list[str]]:
    """Return the parameters of a launch function, and their names: arrays, each with its stride, then results."""
    parameters, arrays = [], []
    for array in function.inputs:
        parameters.append(f"const {number} *{array.name}")
        arrays.append(array.name)
        if array.name in strides:
            parameters.append(f"size_t {array.name}_stride")
            arrays.append(f"{array.name}_stride")
    parameters += [f"{number} *{array.name}" for array in function.outputs]
    return parameters, arrays + [array.name for array in function.outputs]


def _traffic(moved: Sequence[Array], with_stride: Sequence[Array], number: str) -> str:
    """Return in words how many numbers a configuration reads and writes."""
    text = f"{sum(array.size for array in moved)} {number}s per configuration"
    if with_stride:
        text += f", at most {sum(array.size for array in with_stride)} more with arguments that are not shared"
    return text


def _documentation(chain: Chain, kernel: Kernel, varying: list[Argument]) -> list[str]:
    """Return the comment above a launch function's prototype."""
    lines = [kernel.summary, *wrapped(kernel.equation), *(wrapped(kernel.note) if kernel.note else []), ""]
    for argument in (*kernel.arguments, *kernel.results):
        shape = argument.array(chain).shape
        text = extents(shape)
        if argument in kernel.results:
            triangle = "upper triangle of " if argument.symmetric else ""
            text = f"{argument.packed().array(chain).size} per configuration: {triangle}{text}"
        elif argument in varying:
            text += f" per configuration, {argument.name}_stride apart; with {argument.name}_stride 0, shared"
        else:
            text += " per configuration" if _is_own(argument) else ", shared"
        lines += wrapped(f"{argument.name} ({text}) [{argument.unit}]: {argument.meaning}", indent="    ")
    return lines


def _variables(request: Request) -> dict[str, Any]:
    """Return what the templates of CUDA read; refuse chains too long for its registers."""
    code = request.print(VARIANT)
    if not code.kernels:
        raise ChainError(
            f"--cuda: the chain has {len(request.chain.joints)} moving joints, and CUDA kernels are made for at most "
            f"{MAX_BATCH_JOINTS}; leave out --cuda, or shorten the chain with --tip, --base or --lock"
        )
    return {
        "variant": code.variant,
        "scopes": code.scopes,
        "calls": code.calls,
        "shared": shared_functions(code),
        "threads": [_thread_page(request, code, kernel, function) for kernel, function in code.kernels],
        "takes_symmetric_parts": any(a.symmetric_part for _, function in code.kernels for a in function.inputs),
    }


def _files(request: Request) -> dict[str, str]:
    if not request.options.cuda:
        return {}
    return {f"{request.name}_cuda.h": "cuda.h.j2", f"{request.name}.cu": "cuda.cu.j2"}


BACKEND = Backend(Path(__file__).parent, _files, _variables)
