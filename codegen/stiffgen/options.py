# SPDX-License-Identifier: MIT
"""Options of generation: one record, read by the Python API, the command line and the manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from stiffgen.errors import ChainError, listed
from stiffgen.lower.rounding import Ranges
from stiffgen.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.robot.chain import ChainOptions, Sensor, Tool
from stiffgen.robot.description import Reading
from stiffgen.symbolic.kernels import ALL
from stiffgen.symbolic.potentials import SpringOptions


@dataclass(frozen=True)
class Help:
    """Description of an option, for the docstring and for --help.

    Attributes:
        meaning: a phrase with unit and default.
        negative: meaning of the flag --no-NAME, for an option that is True by default.
        command: keyword arguments of argparse; None where the command line has no such option.
        flag: name on the command line; "" for the field's own.
        group: heading of the option in --help; "" for none.

    """

    meaning: str
    negative: str = ""
    command: Mapping[str, Any] | None = field(default_factory=dict)
    flag: str = ""
    group: str = ""


def described(meaning: str, negative: str = "", flag: str = "", group: str = "", **command: Any) -> dict[str, Help]:
    """Return the metadata of a field that is an option in Python and on the command line."""
    return {"help": Help(meaning, negative, command, flag, group)}


def described_in_python(meaning: str) -> dict[str, Help]:
    """Return the metadata of a field that the command line does not have."""
    return {"help": Help(meaning, command=None)}


def help_of(option: Field[Any]) -> Help:
    """Return the description of a field of a record of options."""
    metadata = option.metadata["help"]
    assert isinstance(metadata, Help)
    return metadata


_RANGES = tuple(each.name for each in fields(Ranges))


@dataclass(frozen=True, kw_only=True)
class GenerationOptions:
    """Options of :func:`stiffgen.generate` and of ``stiffgen generate``."""

    # More than twelve fields: every option stands here and nowhere else.
    tip: str | Sequence[str] | None = field(
        default=None,
        metadata=described(
            "tip link; repeat it for several tips (default: the only leaf)", metavar="LINK", action="append"
        ),
    )
    base: str | None = field(
        default=None, metadata=described("first link of the chain (default: the root link)", metavar="LINK")
    )
    floating_base: bool = field(
        default=False, metadata=described("free the base: functions take its pose, its twist precedes the joint rates")
    )
    lock: Mapping[str, float] | None = field(
        default=None,
        metadata=described("hold a joint at a position [rad or m]; repeatable", metavar="JOINT=VALUE", action="append"),
    )
    ignore: Sequence[str] = field(
        default=(),
        metadata=described(
            "unknown element or attribute that is no misspelling; repeatable", metavar="ELEMENT", action="append"
        ),
    )
    accept_inertia: Sequence[str] = field(
        default=(),
        metadata=described(
            "use an inertia that no rigid body has; repeatable (all: of every link)", metavar="LINK", action="append"
        ),
    )
    arguments: Mapping[str, str] | None = field(
        default=None, metadata=described_in_python("values of a xacro template's arguments, by name")
    )
    package_path: Sequence[str | Path] = field(
        default=(),
        metadata=described(
            "folder of ROS packages that a xacro template includes; repeatable", metavar="DIR", action="append"
        ),
    )
    close_loops: bool = field(
        default=False, metadata=described("close the loops of an MJCF file: adds functions in motor coordinates")
    )
    loop: Sequence[str] = field(
        default=(),
        metadata=described(
            "close a loop: two points of two links coincide [m]; repeatable",
            metavar="LINK:X,Y,Z=LINK:X,Y,Z",
            action="append",
        ),
    )
    actuated: str | Sequence[str] = field(
        default=(),
        metadata=described("joints of closed loops with a motor, with commas (default: as in MJCF)", metavar="JOINTS"),
    )
    tool: Tool | None = field(default=None, metadata=described_in_python("tool mounted on the tip link"))
    runtime_tool: bool = field(
        default=False, metadata=described_in_python("pass the tool's pose to the functions, as an argument after q")
    )
    sensor: Sensor | None = field(
        default=None, metadata=described_in_python("force-torque sensor that moves rigidly with a tip")
    )
    name: str | None = field(
        default=None, metadata=described("prefix of C names and name of the module (default: the robot's name)")
    )
    output: str | Path = field(
        default="generated",
        metadata=described("folder that receives the robot's folder (default: generated)", metavar="DIR", type=Path),
    )
    force: bool = field(
        default=False, metadata=described("replace a folder whose robot has other joints, tips or arguments")
    )
    kernels: str | Sequence[str] = field(
        default=ALL,
        metadata=described(
            "groups of functions, separated by commas, such as hybrid,spring (default: all); all,compliance adds the "
            "tip's compliance; pose and the controller's functions are always included",
            metavar="GROUPS",
        ),
    )
    batches: bool = field(
        default=True, metadata=described("generate functions for many configurations per call", "omit NAME_batch.c")
    )
    masses: bool = field(
        default=True,
        metadata=described("generate the functions that need masses", "ignore masses; omit their functions"),
    )
    controller: bool = field(
        default=True, metadata=described("generate the impedance controller", "omit the impedance controller")
    )
    python: bool = field(default=True, metadata=described("generate the Python module", "omit the Python module"))
    build: bool = field(
        default=True, metadata=described("compile the Python module", "write the sources, compile nothing")
    )
    cuda: bool = field(default=False, metadata=described("also generate NAME.cu: batches of functions on a GPU"))
    scalar: str = field(
        default=DOUBLE.name,
        metadata=described(
            "type of all numbers (default: double); float excludes the controller and --derivatives",
            choices=list(SCALARS),
        ),
    )
    springs: SpringOptions | None = field(
        default=None, metadata=described_in_python("additional springs, their axes and centre, potentials, derivatives")
    )
    ranges: Ranges | None = field(
        default=None,
        metadata=described(
            f"largest argument for which the header states rounding bounds; NAME is one of {', '.join(_RANGES)}; "
            "repeatable (defaults: see the header)",
            metavar="NAME=VALUE",
            action="append",
            flag="--range",
        ),
    )
    progress: Callable[[str], None] = field(
        default=lambda step: None,
        metadata=described_in_python("function that is called with a few words before each step"),
    )

    @property
    def chain(self) -> ChainOptions:
        """Options that select the chain."""
        return ChainOptions(
            self.tip,
            self.base,
            self.masses,
            self.tool,
            self.runtime_tool,
            self.lock,
            self.floating_base,
            Reading(self.arguments or {}, tuple(self.package_path), tuple(self.ignore), tuple(self.accept_inertia)),
            self.close_loops,
            tuple(self.loop),
            tuple(self.actuated.split(",") if isinstance(self.actuated, str) else self.actuated),
            self.sensor,
        )

    @property
    def number(self) -> Scalar:
        """Type of a number.

        Raises:
            ChainError: there is no such type, or options exclude each other.

        """
        if self.scalar not in SCALARS:
            raise ChainError(f"--scalar {self.scalar}: is not one of {listed(list(SCALARS))}")
        springs = self.springs or SpringOptions()
        if self.cuda and not self.batches:
            raise ChainError("--cuda is made from the batches, which --no-batches omits; leave out one of the two")
        needs_doubles = {
            "--derivatives": springs.derivatives,
            "--spring rotation_vector": "rotation_vector" in springs.kinds,  # its series is cut off for doubles
        }
        for option, is_chosen in needs_doubles.items():
            if is_chosen and self.scalar != DOUBLE.name:
                raise ChainError(
                    f"--scalar {self.scalar} does not go with {option}, which is made for doubles; leave out one of "
                    "the two, or generate a second folder of doubles with another --name"
                )
        return SCALARS[self.scalar]

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of functions that were chosen; none for all but those on request."""
        chosen = self.kernels.split(",") if isinstance(self.kernels, str) else self.kernels
        names = tuple(name.strip() for name in chosen)
        return () if set(names) == {ALL} else names

    def to_manifest(self) -> dict[str, Any]:
        """Return the options that decide which files a folder has; the manifest states the others elsewhere."""
        return {
            "kernels": list(self.groups) or ALL,
            "batches": self.batches,
            "controller": self.controller,
            "python": self.python,
            "cuda": self.cuda,
        }


GenerationOptions.__doc__ = "\n".join(
    [
        f"{GenerationOptions.__doc__}\n\nAttributes:",
        *(f"    {option.name}: {help_of(option).meaning}." for option in fields(GenerationOptions)),
    ]
)


def options_of_manifest(content: Mapping[str, Any], springs: SpringOptions) -> GenerationOptions:
    """Return the options that a folder was printed with; those that select the chain have their defaults."""
    return GenerationOptions(
        **content["options"],
        scalar=content.get("scalar", DOUBLE.name),
        springs=springs,
        ranges=Ranges(**content["rounding"]["ranges"]),
    )
