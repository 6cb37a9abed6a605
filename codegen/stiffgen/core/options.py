# SPDX-License-Identifier: MIT
"""Options of generation: one record, read by the Python API, the command line and the manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffgen.core.described import option, python_option, with_attributes
from stiffgen.core.errors import ChainError, OptionError, listed
from stiffgen.core.given import checked_path, shown
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.symbolic.choices import ALL, KernelOptions


@dataclass(frozen=True, kw_only=True)
class GenerationOptions(ChainOptions, KernelOptions):
    """Options of :func:`stiffgen.generate` and of ``stiffgen generate``: those of chain and kernels, and of output."""

    name: str | None = option(
        "prefix of C names and name of the module (default: the robot's name)", default=None, group="output"
    )
    output: str | Path = option(
        "folder that receives the robot's folder (default: generated)",
        default="generated",
        group="output",
        metavar="DIR",
        type=Path,
    )
    force: bool = python_option(
        "replace a folder whose robot has another source, other joints, tips or arguments", default=False
    )
    controller: bool = option(
        "generate the impedance controller", default=True, negative="omit the impedance controller", group="output"
    )
    python: bool = option("generate the Python module", default=True, negative="omit the Python module", group="output")
    build: bool = option(
        "compile the Python module", default=True, negative="write the sources, compile nothing", group="output"
    )
    cuda: bool = option("also generate NAME.cu: batches of functions on a GPU", default=False, group="output")
    scalar: str = option(
        "type of all numbers (default: double); float excludes the controller and --derivatives",
        default=DOUBLE.name,
        group="output",
        choices=list(SCALARS),
    )
    ranges: Ranges = option(
        "largest argument for which the header states rounding bounds; repeatable (defaults: see the header)",
        factory=Ranges,
        flag="--range",
        group="output",
        record=Ranges,
    )
    progress: Callable[[str], None] = python_option(
        "function that is called with a few words before each step", default=lambda step: None
    )

    def __post_init__(self) -> None:
        """Check what both records have, and the types of output and ranges."""
        ChainOptions.__post_init__(self)
        KernelOptions.__post_init__(self)
        if "\0" in str(checked_path(self.output, "--output")):
            raise OptionError(f"--output: no folder's name holds a NUL byte, as {shown(self.output)} does")
        if not isinstance(self.ranges, Ranges):
            raise OptionError(
                f"--range: takes a record stiffgen.core.lower.ranges.Ranges(...), not {shown(self.ranges)}"
            )

    @property
    def number(self) -> Scalar:
        """Type of a number.

        Raises:
            ChainError: there is no such type, or options exclude each other.

        """
        if self.scalar not in SCALARS:
            raise ChainError(f"--scalar {self.scalar}: is not one of {listed(list(SCALARS))}")
        if self.cuda and not self.batches:
            raise ChainError("--cuda is made from the batches, which --no-batches omits; leave out one of the two")
        needs_doubles = {
            "--derivatives": self.derivatives,
            "--spring rotation_vector": "rotation_vector" in self.springs,  # its series is cut off for doubles
        }
        for flag, is_chosen in needs_doubles.items():
            if is_chosen and self.scalar != DOUBLE.name:
                raise ChainError(
                    f"--scalar {self.scalar} does not go with {flag}, which is made for doubles; leave out one of "
                    "the two, or generate a second folder of doubles with another --name"
                )
        return SCALARS[self.scalar]

    def to_manifest(self) -> dict[str, Any]:
        """Return the options that decide which files a folder has; the manifest states the others elsewhere."""
        return {
            "kernels": list(self.groups) or ALL,
            "batches": self.batches,
            "controller": self.controller,
            "python": self.python,
            "cuda": self.cuda,
        }


GenerationOptions.__doc__ = with_attributes(GenerationOptions)


def options_of_manifest(content: Mapping[str, Any], kernels: KernelOptions) -> GenerationOptions:
    """Return the options that a folder was printed with; those that select the chain have their defaults."""
    printed = {
        "scalar": content.get("scalar", DOUBLE.name),
        "ranges": Ranges(**content["rounding"]["ranges"]),
    }
    return GenerationOptions(**vars(kernels) | content["options"] | printed)
