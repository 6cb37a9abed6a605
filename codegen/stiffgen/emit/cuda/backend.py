# SPDX-License-Identifier: MIT
"""Describe NAME.cu and NAME_cuda.h: the kernels that have a batch, one configuration per thread."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffgen.emit.backend import Backend, Request
from stiffgen.emit.c import CFunction, VariantCode
from stiffgen.emit.c.backend import StoredResult, one_configuration, stored_result
from stiffgen.emit.pages import Definition, shared_functions
from stiffgen.emit.texts import extents, prototype, wrapped
from stiffgen.errors import ChainError
from stiffgen.lower.variant import CUDA as VARIANT
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kernels import MAX_BATCH_JOINTS, Kernel
from stiffgen.symbolic.program import Array


@dataclass(frozen=True)
class ThreadPage:
    """A CUDA kernel. Every configuration has its own vectors and cotangents; other matrices are shared by all.

    A varying matrix has a stride of its own, 0 for a shared one.

    Attributes:
        definition: function of one thread.
        kernel: prototype of the function that runs it for all configurations.
        prototype: launch function.
        qualified_name: name of the kernel.
        own: arguments of which every configuration has its own.
        varying: arguments of which every configuration may have its own.
        arrays: arguments of the kernel in the launch function: arrays, strides, and results.
        values: arguments of the thread's function.
        results: results, and the part of them that is written.
        documentation: comment above the launch function, in lines.

    """

    definition: Definition
    kernel: str
    prototype: str
    qualified_name: str
    own: list[Array]
    varying: list[Array]
    arrays: list[str]
    values: list[str]
    results: list[StoredResult]
    documentation: list[str]

    @property
    def moved(self) -> int:
        """Numbers read and written per configuration."""
        return sum(result.stored for result in self.results) + sum(array.size for array in self.own)


def _thread_page(request: Request, code: VariantCode, kernel: Kernel, function: CFunction) -> ThreadPage:
    chain, number = request.chain, code.variant.number
    arguments = list(zip(kernel.arguments, function.inputs, strict=True))
    own = [array for argument, array in arguments if len(array.shape) == 1 or argument.per_configuration]
    varying = [array for argument, array in arguments if argument.varying]
    parameters, arrays = [], []
    for array in function.inputs:
        parameters.append(f"const {number} *{array.name}")
        arrays.append(array.name)
        if array in varying:
            parameters.append(f"size_t {array.name}_stride")
            arrays.append(f"{array.name}_stride")
    parameters += [f"{number} *{array.name}" for array in function.outputs]
    arrays += [array.name for array in function.outputs]
    apart = [text.replace("*", "*__restrict__ ") for text in parameters]
    sizes = ["size_t count", "size_t stride"]
    return ThreadPage(
        definition=one_configuration(code.variant, kernel, function),
        kernel=prototype(f"KERNEL {kernel.qualified_name}_kernel(", sizes + apart),
        prototype=prototype(f"int {request.name}_{kernel.qualified_name}_cuda(", [*sizes, *parameters, "void *stream"]),
        qualified_name=kernel.qualified_name,
        own=own,
        varying=varying,
        arrays=arrays,
        values=[f"{a.name}_of_one" if a in own or a in varying else a.name for a in function.inputs],
        results=[stored_result(chain, result, result.packed()) for result in kernel.results],
        documentation=_documentation(chain, kernel),
    )


def _documentation(chain: Chain, kernel: Kernel) -> list[str]:
    """Return the comment above a launch function's prototype."""
    lines = [kernel.summary, *wrapped(kernel.equation), *(wrapped(kernel.note) if kernel.note else []), ""]
    for argument in (*kernel.arguments, *kernel.results):
        shape = argument.array(chain).shape
        text = extents(shape)
        if argument in kernel.results:
            triangle = "upper triangle of " if argument.symmetric else ""
            text = f"{argument.packed().array(chain).size} per configuration: {triangle}{text}"
        elif argument.varying:
            text += f" per configuration, {argument.name}_stride apart; with {argument.name}_stride 0, shared"
        else:
            text += " per configuration" if len(shape) == 1 or argument.per_configuration else ", shared"
        lines += wrapped(f"{argument.name} ({text}) [{argument.unit}]: {argument.meaning}", indent="    ")
    return lines


def _variables(request: Request) -> dict[str, Any]:
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
    }


def _files(request: Request) -> dict[str, str]:
    if not request.options.cuda:
        return {}
    return {f"{request.name}_cuda.h": "cuda.h.j2", f"{request.name}.cu": "cuda.cu.j2"}


CUDA = Backend(Path(__file__).parent, _files, _variables)
