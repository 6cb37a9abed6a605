# SPDX-License-Identifier: MIT
"""Write the C text of every proof, from the kernel table and the table of the controller's fields."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import prod

from stiffgen.core.errors import OutputError
from stiffgen.core.lower.graph import LIBM, LIBM_OF_TWO
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.rendering import environment
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.rooms import optional

MOST = 3
"""Configurations in a batch with one lane: a first, a middle, a last (docs/guarantees.md has the argument)."""

_EXACT = {"fabs"}
"""Functions that ESBMC computes itself; all others of libm may return any value."""


STATES = (
    ("its_own", "any_state()"),
    ("overwritten_below", "any_bytes(0u, READY - 1)"),
    ("overwritten_above", "any_bytes(READY + 1, 4294967295u)"),
)
STEPS = tuple(f"step_{state}" for state, _ in STATES)
SERVICES = ("step_without", "init", "reset", "default_config", "error_text")
"""Entries of the controller's harness in which a contract replaces validate."""
PAPER = ("paper_step", "paper_step_without", "paper_validate", "paper_default_config")
"""Entries of the harness of the paper's law."""


def kernels_bits(robot: GeneratedRobot, kernels: Sequence[Kernel]) -> str:
    """Return all kernels for ESBMC: symmetry, bounds and loops, in IEEE arithmetic; includes :func:`bodies_apart`."""
    libm = ["sin", "cos", *(each for each in LIBM if each not in _EXACT)]
    return _render(robot, "kernels_bits.c.j2", kernels=kernels, libm=libm, libm_of_two=LIBM_OF_TWO)


def bodies_apart(kernels: Sequence[Kernel], text: str) -> str:
    """Return the kernels' C file with the bodies of batches renamed: a harness defines the result of their calls."""
    for each in kernels:
        if each.batches:
            body = f"{each.qualified_name}_lanes("
            # A body may also call the body of another kernel, whose results contain its own.
            calls = len(re.findall(rf"\b{re.escape(body)}", text)) - 1
            if text.count(f"static void {body}") != 1 or calls < len(each.batches):
                raise OutputError(
                    f"{body}): not defined once and called by {len(each.batches)} batches; generate the folder again"
                )
            text = text.replace(f"static void {body}", f"static void {each.qualified_name}_body(")
    return text


def kernels_memory(robot: GeneratedRobot, kernels: Sequence[Kernel], entries: Sequence[str]) -> str:
    """Return all kernels for Frama-C: memory, undefined behaviour, uninitialised reads."""
    return _render(
        robot,
        "kernels_memory.c.j2",
        kernels=kernels,
        entries=entries,
        most=MOST,
        batched=robot.has_batches,
    )


def contracts(robot: GeneratedRobot, kernels: Sequence[Kernel]) -> str:
    """Return the contracts of the kernels that the controller relies on."""
    return _render(robot, "contracts.h.j2", kernels=kernels)


def comparisons(robot: GeneratedRobot) -> str:
    """Return the proof, for ESBMC, of the property of comparisons that the contracts admit."""
    return _render(robot, "comparisons.c.j2")


def with_comparisons(robot: GeneratedRobot, text: str) -> str:
    """Return the controller's C file with what :func:`comparisons` proves of larger and smaller in their place.

    Frama-C does not infer that a true comparison has no NaN operand.
    """
    for sign in "><":
        returned = f"return x {sign} y ? x : y;"
        if text.count(returned) != 1:
            raise OutputError(f"{robot.folder}: '{returned}' not found once; generate the folder again")
        text = text.replace(returned, f"return x {sign} y ? number(x) : y;")
    return text


def controller(robot: GeneratedRobot, entries: Sequence[str], *, by_contract: bool) -> str:
    """Return the controller for Frama-C; ``by_contract``: a contract replaces validate."""
    config, memory = optional("control.core.config"), optional("control.core.memory")
    if config is None or memory is None:
        raise OutputError(f"{robot.folder}: this stiffgen has no tables of the controller; prove other parts")
    return _render(
        robot,
        "controller.c.j2",
        entries=entries,
        by_contract=by_contract,
        integers=[field for field in config.CONFIG if field.type == "int"],
        invariant=memory.RANGES,
        states=STATES,
    )


def paper(robot: GeneratedRobot) -> str:
    """Return the paper's law for Frama-C."""
    return _render(robot, "paper.c.j2", entries=PAPER)


def widths(robot: GeneratedRobot, kernels: Sequence[Kernel], most: int) -> str:
    """Return a program that calls every kernel in arrays of exactly their sizes, for every number of lanes."""
    return _render(robot, "widths.c.j2", batched=robot.has_batches, kernels=kernels, most=most)


def _prefixed(text: str, prefix: str) -> str:
    return prefix + text


def _render(robot: GeneratedRobot, template: str, **context: object) -> str:
    """Render a template of C; stiffgen has checked that names in it are identifiers."""

    def size(argument: Argument) -> int:
        return prod(argument.array(robot.chain).shape)

    def rows(result: Argument) -> int:
        """Return the rows of a square matrix that is claimed to be symmetric; 0 for others."""
        return result.array(robot.chain).shape[-1] if result.symmetric else 0

    filters: dict[str, Callable[..., object]] = {"prefixed": _prefixed, "size": size, "rows": rows}
    return environment("stiffgen.lab.prove", filters).get_template(template).render(name=robot.name, **context)
