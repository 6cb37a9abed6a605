# SPDX-License-Identifier: MIT
"""Describe NAME_dispatch.c: public functions that call the one compiled for the processor's vector width."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from stiffgen.core.emit.pages import KernelPage

_SINGLE, _BATCH = (128, 256, 256), (128, 256, 512)
"""Vector widths [bit] used on processors with SSE2, AVX2 and AVX-512. Single calls are slower with 512 bits."""


@dataclass(frozen=True)
class DispatchedFunction:
    """A public function of C.

    Attributes:
        name: name, less the robot's.
        result: type of the result.
        prototype: the function in C.
        parameters: its parameters.
        call: arguments with which it calls the function of a width.
        widths: vector width [bit] on processors with SSE2, AVX2 and AVX-512.

    """

    name: str
    result: str
    prototype: str
    parameters: str
    call: str
    widths: tuple[int, int, int]


def _dispatched(robot: str, prototype: str, call: Iterable[str], widths: tuple[int, int, int]) -> DispatchedFunction:
    """Describe a function from its prototype; ``call`` are the arguments that it passes on."""
    opening, _, parameters = prototype.partition("(")
    result, _, name = opening.partition(" ")
    return DispatchedFunction(
        name.removeprefix(f"{robot}_"), result, prototype, f"({parameters}", ", ".join(call), widths
    )


def single_functions(robot: str, pages: Iterable[KernelPage]) -> Iterator[DispatchedFunction]:
    """Yield the public functions of NAME.c."""
    for page in pages:
        yield _dispatched(robot, page.definition.prototype, (*page.inputs, *page.outputs), _SINGLE)
    yield _dispatched(robot, f"int {robot}_self_check(void)", (), _SINGLE)


def batch_function(robot: str, prototype: str, inputs: Iterable[str], outputs: Iterable[str]) -> DispatchedFunction:
    """Return a public function of NAME_batch.c."""
    steps = [part for name in inputs for part in (name, f"{name}_step")]
    return _dispatched(robot, prototype, ("count", *steps, *outputs), _BATCH)


def batch_self_check(robot: str) -> DispatchedFunction:
    """Return the check of NAME_batch.c."""
    return _dispatched(robot, f"int {robot}_batch_self_check(void)", (), _BATCH)
