# SPDX-License-Identifier: MIT
"""Comments and signatures of printed functions, in lines."""

from __future__ import annotations

from collections.abc import Sequence

from stiffgen.core.emit.c import CFunction
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.ranges import Stated
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.program import Array


def wrapped(text: str, width: int = 104, indent: str = "") -> list[str]:
    """Break text into lines of at most ``width`` characters; all but the first begin with the indent."""
    lines: list[str] = []
    current = ""
    for word in text.split():
        if current and len(current) + 1 + len(word) > width:
            lines.append(current)
            current = f"{indent}{word}"
        else:
            current = f"{current} {word}" if current else word
    return [*lines, current]


def prototype(opening: str, parameters: list[str], width: int = 110) -> str:
    """Return a C prototype, broken into lines between its parameters."""
    lines = [opening]
    for index, parameter in enumerate(parameters):
        last = index == len(parameters) - 1
        piece = parameter if last else f"{parameter}, "
        if len(lines[-1]) + len(piece) > width:
            lines[-1] = lines[-1].rstrip()
            lines.append(" " * 4 + piece)
        else:
            lines[-1] += piece
    return "\n".join(lines) + ")"


def declared(array: Array) -> str:
    """Return the C declarator of an array."""
    return f"{array.name}[{array.size}]"


def cost(operations: Operations) -> str:
    """Return operation counts in words."""
    return f"{operations.add} additions, {operations.multiply} multiplications, {operations.sincos} sines and cosines"


def definition_comment(kernel: Kernel, function: CFunction) -> list[str]:
    """Return the comment above a kernel's definition: its result, its equation, and its cost."""
    return [kernel.summary, *wrapped(kernel.equation), f"{cost(function.operations)}."]


def documented_arguments(kernel: Kernel) -> tuple[Argument, ...]:
    """Return the arguments that a kernel's documentation explains.

    The arguments of a vector-Jacobian product are explained where its kernel is, the cotangents here.
    """
    return kernel.arguments[len(kernel.results) :] if kernel.product_of else kernel.arguments


def arguments_elsewhere(kernel: Kernel, width: int = 104) -> list[str]:
    """Return the line that refers to the arguments explained elsewhere; none for most kernels."""
    if not kernel.product_of:
        return []
    others = ", ".join(each.name for each in kernel.arguments if each not in documented_arguments(kernel))
    return wrapped(f"{others}: as in {kernel.product_of}", width, indent="    ")


def extents(shape: tuple[int, ...]) -> str:
    """Return a shape in words; a number is one entry."""
    return " x ".join(map(str, shape or (1,)))


def described(chain: Chain, argument: Argument) -> str:
    """Return name, shape, unit and meaning of an argument or a result."""
    shape = extents(argument.array(chain).shape)
    return f"{argument.name} ({shape}) [{argument.unit}]: {argument.meaning}"


def documentation(chain: Chain, kernel: Kernel, bounds: Sequence[Stated]) -> list[str]:
    """Return the comment above a C prototype."""
    lines = [kernel.summary, *wrapped(kernel.equation)]
    if kernel.note:
        lines += wrapped(kernel.note)
    lines += ["", *arguments_elsewhere(kernel)]
    for argument in (*documented_arguments(kernel), *kernel.results):
        lines += wrapped(described(chain, argument), indent="    ")
    if bounds:
        lines += wrapped(f"Rounding: {', '.join(each.text for each in bounds)}.")
    return lines
