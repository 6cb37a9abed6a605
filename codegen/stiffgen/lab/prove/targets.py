# SPDX-License-Identifier: MIT
"""Write and read measurements of a folder's C on other processors (docs/guarantees.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from stiffgen.core.errors import OutputError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.lab.prove.verdict import read_content


@dataclass(frozen=True)
class Target:
    """Measurements on one machine.

    Attributes:
        machine: its name.
        compiler: the program and its flags.
        emulator: program that ran the code.
        compared: reference of the values.
        right: whether the values agreed to 1e-12 of the largest.
        states: number of states at which instructions were counted.
        instructions: fewest and most of every function.
        step: fewest and most of the controller's step; None for a robot without controller.
        longest_step: most instructions if every eigenvalue takes all permitted iterations.
        flash, ram: of NAME.c without batches [bytes].
        stack: deepest stack of a function of NAME.c without batches [bytes]; None if the compiler does not tell.
        step_stack: deepest stack of the controller's step [bytes]; None without a controller.
        controller_flash, controller_ram: of NAME_impedance.c, in addition [bytes]; None without a controller.
        controller_stacks: stack of each public function of NAME_impedance.c, without the robot's name [bytes].

    """

    # More than twelve fields: one for each figure of docs/guarantees.md.
    machine: str
    compiler: str
    emulator: str
    compared: str
    right: bool
    states: int
    instructions: Mapping[str, tuple[int, int]]
    step: tuple[int, int] | None
    longest_step: int | None
    flash: int
    ram: int
    stack: int | None
    step_stack: int | None = None
    controller_flash: int | None = None
    controller_ram: int | None = None
    controller_stacks: Mapping[str, int] = field(default_factory=dict)

    @property
    def controller_stack(self) -> int | None:
        """Deepest stack of a function of the controller [bytes]; None where none was measured."""
        return max(self.controller_stacks.values(), default=None)

    @property
    def varying(self) -> list[str]:
        """Functions whose count depends on the input."""
        return [name for name, (fewest, most) in self.instructions.items() if fewest != most]


def write_targets(file: Path, robot: GeneratedRobot, targets: Sequence[Target]) -> None:
    """Write targets as JSON, with the digests of their C sources."""
    content = {
        "robot": robot.name,
        "sources": robot.source_digests(),
        "targets": [asdict(target) for target in targets],
    }
    file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_targets(file: Path) -> tuple[dict[str, str], tuple[Target, ...]]:
    """Read the targets and the digests of their sources from a file of :func:`write_targets`.

    Raises:
        OutputError: the file cannot be read, or holds something else.

    """
    try:
        content = read_content(file)
        targets = tuple(_target(row) for row in content["targets"])
        return dict(content["sources"]), targets
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(f"{file}: holds no targets ({error}); docs/guarantees.md says how to measure") from error


def _target(row: Any) -> Target:
    """Return a row as a target; ValueError or TypeError if a field has another type."""
    target = Target(**row)
    texts = (target.machine, target.compiler, target.emulator, target.compared)
    numbers = (target.states, target.flash, target.ram)
    own = target.controller_stacks
    if not isinstance(own, dict) or not all(
        isinstance(name, str) and isinstance(size, int) for name, size in own.items()
    ):
        raise ValueError("the controller's stacks are no numbers by name")
    stacks = (target.stack, target.step_stack, target.controller_flash, target.controller_ram)
    if (
        not all(isinstance(text, str) for text in texts)
        or not all(isinstance(number, int) for number in numbers)
        or not all(number is None or isinstance(number, int) for number in stacks)
    ):
        raise ValueError("a field has another type")
    if not isinstance(target.right, bool):
        raise ValueError(f"right {target.right!r} is neither true nor false")
    counts = {name: _count(pair) for name, pair in target.instructions.items()}
    step = None if target.step is None else _count(target.step)
    return replace(target, instructions=counts, step=step)


def _count(pair: Any) -> tuple[int, int]:
    """Return the fewest and the most instructions; ValueError if there are not two integers."""
    fewest, most = pair
    if not isinstance(fewest, int) or not isinstance(most, int):
        raise ValueError(f"{pair!r} is no count of instructions")
    return fewest, most
