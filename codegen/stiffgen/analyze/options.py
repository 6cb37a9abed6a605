# SPDX-License-Identifier: MIT
"""Options of an analysis: one record, from which the command line and :func:`stiffgen.analyze` are made."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from stiffgen.options import described, described_in_python, help_of
from stiffgen.symbolic.connection import REPRESENTATIONS, Representation

ShowProgress = Callable[[str, float], None]
_Fields = ParamSpec("_Fields")
_Record = TypeVar("_Record")
_Result = TypeVar("_Result")


COLUMNS = "columns"
EXPORTS = ("npz", "csv", "parquet")
TOPICS = "MCAP"
GROUPS = {
    COLUMNS: "default: time [s] (optional), q_0 ... [rad], wrench_0 ... wrench_5. A prefix finds PREFIX0 ..., PREFIX1 "
    "... or PREFIX with the joints' names (wrench: fx fy fz mx my mz)",
    TOPICS: "topics are needed where there are several of their type",
}


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


def _silent(step: str, done: float) -> None:
    pass


@dataclass(frozen=True)
class AnalysisOptions:
    """Options of an analysis: recording, robot, task stiffness, and how to read them."""

    # More than twelve fields: every option stands here and nowhere else.
    log: str | Path = field(
        metadata=described(
            "recording with q and wrench: .csv, .tsv, .txt, .npz, .parquet or .mcap (ROS 2)", metavar="LOG"
        )
    )
    robot: str | Path = field(metadata=described("folder that 'stiffgen generate' wrote", metavar="DIR"))
    task_stiffness: ArrayLike = field(
        metadata=described(
            "six diagonal values or a symmetric 6x6 matrix (on the command line a CSV file with it), linear first "
            "[N/m, N, N m/rad]",
            nargs="+",
            metavar="K",
        )
    )
    _: KW_ONLY
    representation: Representation = field(
        default="hybrid",
        metadata=described(
            "representation of wrenches and task stiffness: axes and point of reference (hybrid: base axes, moment "
            "about the tip's origin) (default: hybrid)",
            choices=REPRESENTATIONS,
        ),
    )
    negate_wrench: bool = field(
        default=False, metadata=described("recorded wrenches are those that the robot applies to the environment")
    )
    calibration: str | Path | None = field(
        default=None,
        metadata=described("recorded wrenches are a sensor's readings; file of 'stiffgen calibrate'", metavar="FILE"),
    )
    tip: str | None = field(default=None, metadata=described("tip link, for a robot with several tips", metavar="LINK"))
    q: str | None = field(
        default=None, metadata=described("prefix of the columns with joint positions", group=COLUMNS, metavar="PREFIX")
    )
    wrench: str | None = field(
        default=None, metadata=described("prefix of the columns with the wrench", group=COLUMNS, metavar="PREFIX")
    )
    q_columns: Sequence[str] | None = field(
        default=None,
        metadata=described(
            "columns with joint positions [rad or m] (default: q_0 ...; NPZ: one array q; MCAP: joint names, "
            "default: the robot's)",
            group=COLUMNS,
            type=_names,
            metavar="A,B,...",
        ),
    )
    wrench_columns: Sequence[str] | None = field(
        default=None,
        metadata=described(
            "six columns, force [N], then moment [N m] (default: wrench_0 ...; NPZ: one array wrench)",
            group=COLUMNS,
            type=_names,
            metavar="FX,...",
        ),
    )
    time_column: str | None = field(
        default=None,
        metadata=described(
            "column with time [s], '' for none (default: time, if there is one)", group=COLUMNS, metavar="NAME"
        ),
    )
    q_topic: str | None = field(
        default=None,
        metadata=described("topic of the joint positions, sensor_msgs/msg/JointState", group=TOPICS, metavar="TOPIC"),
    )
    wrench_topic: str | None = field(
        default=None,
        metadata=described("topic of the wrenches, geometry_msgs/msg/WrenchStamped", group=TOPICS, metavar="TOPIC"),
    )
    tolerance: float = field(
        default=0.01,
        metadata=described(
            "largest time from joint positions to their wrench [s] (default: 0.01)",
            group=TOPICS,
            type=float,
            metavar="S",
        ),
    )
    output: str | Path | None = field(
        default=None,
        metadata=described("folder to write (default: analysis/NAME, with the recording's name)", metavar="DIR"),
    )
    figures: bool = field(
        default=True,
        metadata=described(
            "write figures and report.html (default: True)", "write summary.json only, without figures and report.html"
        ),
    )
    export: str | None = field(
        default=None,
        metadata=described(
            "also write the corrected joint stiffness of each row: joint_stiffness.npz, .csv or .parquet",
            choices=EXPORTS,
        ),
    )
    dask: str | None = field(
        default=None,
        metadata=described(
            "address of a Dask scheduler, or 'local' for processes on this machine (they import the calling "
            "script, which must guard its calls by if __name__ == '__main__')",
            metavar="ADDRESS",
        ),
    )
    block_rows: int = field(default=8192, metadata=described_in_python("rows per block"))
    progress: ShowProgress = field(
        default=_silent, metadata=described_in_python("called with a few words and the completed share (0 ... 1)")
    )


def taking(record: Callable[_Fields, _Record]) -> Callable[[Callable[[_Record], _Result]], Callable[_Fields, _Result]]:
    """Turn a function of a record into a function of the record's fields, with their signature and meanings.

    The meanings replace ``{arguments}`` in the docstring.
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
        meaning = help_of(each).meaning
        lines += textwrap.wrap(f"{each.name}: {meaning}.", 108, initial_indent=8 * " ", subsequent_indent=12 * " ")
    return text.replace("{arguments}", "\n".join(["Args:", *lines]))
