# SPDX-License-Identifier: MIT
"""What an analysis is asked for: one record, and the command line and :func:`stiffgen.analyze` derive from it."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, MISSING, Field, dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from stiffgen.symbolic.connection import REPRESENTATIONS, Representation

Progress = Callable[[str, float], None]
_Fields = ParamSpec("_Fields")
_Record = TypeVar("_Record")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Told:
    """What there is to say of a field, in the docstring and under --help.

    Attributes:
        meaning: a phrase with units; of a field that is True if nothing is said, what False does.
        group: heading under which the command line lists it, "" for none.
        command: what the command line gives to argparse beside it; None if it has no such option.

    """

    meaning: str
    group: str = ""
    command: dict[str, Any] | None = field(default_factory=dict)


COLUMNS = "columns"
TOPICS = "MCAP"
GROUPS = {
    COLUMNS: "default: time [s] (optional), q_0 ... [rad], wrench_0 ... wrench_5",
    TOPICS: "topics are needed where there are several of their type",
}


def told(field: Field[Any]) -> Told:
    """Return the metadata of a field of :class:`AnalysisOptions`."""
    said = field.metadata["told"]
    assert isinstance(said, Told)
    return said


def _told(meaning: str, group: str = "", **command: Any) -> dict[str, Told]:
    return {"told": Told(meaning, group, command)}


def _told_in_python(meaning: str) -> dict[str, Told]:
    return {"told": Told(meaning, command=None)}


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


def _silent(step: str, done: float) -> None:
    pass


@dataclass(frozen=True)
class AnalysisOptions:
    """A recording, a robot, a task stiffness, and how they are taken. The fields say what each is."""

    log: str | Path = field(
        metadata=_told("recording with q and wrench: .csv, .tsv, .txt, .npz, .parquet or .mcap (ROS 2)", metavar="LOG")
    )
    robot: str | Path = field(metadata=_told("folder that 'stiffgen generate' wrote", metavar="DIR"))
    task_stiffness: ArrayLike = field(
        metadata=_told(
            "six diagonal values or a symmetric 6x6 matrix (on the command line a CSV file with it), linear first "
            "[N/m, N, N m/rad]",
            nargs="+",
            metavar="K",
        )
    )
    _: KW_ONLY
    representation: Representation = field(
        default="hybrid",
        metadata=_told("in which wrenches and task stiffness are given (README, Frames)", choices=REPRESENTATIONS),
    )
    negate_wrench: bool = field(
        default=False, metadata=_told("the wrenches are those that the robot applies to the environment")
    )
    tip: str | None = field(default=None, metadata=_told("which tip, of a robot with several", metavar="LINK"))
    q_columns: Sequence[str] | None = field(
        default=None,
        metadata=_told(
            "columns with joint positions [rad or m] (default: q_0 ...; NPZ: one array q; MCAP: names of joints, "
            "default those of the robot)",
            COLUMNS,
            type=_names,
            metavar="A,B,...",
        ),
    )
    wrench_columns: Sequence[str] | None = field(
        default=None,
        metadata=_told(
            "six columns, force [N], then moment [N m] (default: wrench_0 ...; NPZ: one array wrench)",
            COLUMNS,
            type=_names,
            metavar="FX,...",
        ),
    )
    time_column: str | None = field(
        default=None,
        metadata=_told("column with time [s], '' for none (default: time, if there is one)", COLUMNS, metavar="NAME"),
    )
    q_topic: str | None = field(
        default=None,
        metadata=_told("topic of the joint positions, sensor_msgs/msg/JointState", TOPICS, metavar="TOPIC"),
    )
    wrench_topic: str | None = field(
        default=None,
        metadata=_told("topic of the wrenches, geometry_msgs/msg/WrenchStamped", TOPICS, metavar="TOPIC"),
    )
    tolerance: float = field(
        default=0.01,
        metadata=_told("largest time between joint positions and their wrench [s]", TOPICS, type=float, metavar="S"),
    )
    output: str | Path | None = field(
        default=None,
        metadata=_told("folder to write (default: analysis/ and LOG's name without its ending)", metavar="DIR"),
    )
    figures: bool = field(
        default=True, metadata=_told("leave out figures and report.html, write the numbers only (summary.json)")
    )
    dask: str | None = field(
        default=None,
        metadata=_told(
            "address of a Dask scheduler, or 'local' for a cluster of processes on this machine (which import the "
            "calling script: it guards its own calls by if __name__ == '__main__')",
            metavar="ADDRESS",
        ),
    )
    block_rows: int = field(default=8192, metadata=_told_in_python("rows that a thread or worker computes at a time"))
    progress: Progress = field(
        default=_silent, metadata=_told_in_python("called with a few words and the share done (0 ... 1)")
    )


def taking(record: Callable[_Fields, _Record]) -> Callable[[Callable[[_Record], _Result]], Callable[_Fields, _Result]]:
    """Make a function of a record one of the record's fields, with their signature and their meanings.

    ``{arguments}`` in its docstring is where the meanings stand.
    """

    def made(function: Callable[[_Record], _Result]) -> Callable[_Fields, _Result]:
        @wraps(function)
        def call(*arguments: _Fields.args, **options: _Fields.kwargs) -> _Result:
            return function(record(*arguments, **options))

        signature = inspect.signature(record)
        call.__signature__ = signature.replace(  # type: ignore[attr-defined]
            return_annotation=inspect.signature(function).return_annotation
        )
        call.__annotations__ = {name: each.annotation for name, each in signature.parameters.items()}
        call.__doc__ = _with_fields(function.__doc__, record)
        return call

    return made


def _with_fields(text: str | None, record: Any) -> str | None:
    if text is None:  # python -OO
        return None
    lines = []
    for each in fields(record):
        said = told(each).meaning
        said = f"False: {said}" if each.default is True else said
        lines += textwrap.wrap(f"{each.name}: {said}.", 108, initial_indent=8 * " ", subsequent_indent=12 * " ")
    return text.replace("{arguments}", "\n".join(["Args:", *lines]))


def has_default(field: Field[Any]) -> bool:
    """Whether it may be left out."""
    return field.default is not MISSING
