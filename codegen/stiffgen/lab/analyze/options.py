# SPDX-License-Identifier: MIT
"""Options of an analysis: one record, from which the command line and :func:`stiffgen.analyze` are made."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from stiffgen.core.described import described, meanings, option, python_option
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation

ShowProgress = Callable[[str, float], None]
_Fields = ParamSpec("_Fields")
_Chosen = TypeVar("_Chosen")
_Result = TypeVar("_Result")


COLUMNS = "columns"
EXPORTS = ("npz", "csv", "parquet")
TOPICS = "MCAP"
GROUPS = {
    COLUMNS: "default: time [s] (optional), q_0 ... [rad], wrench_0 ... wrench_5. A prefix finds PREFIX0 ..., PREFIX1 "
    "... or PREFIX with the joints' names (wrench: fx fy fz mx my mz)",
    TOPICS: "topics are needed where there are several of their type",
}


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
    robot: str | Path = field(
        metadata=described(
            "folder that 'stiffgen generate' wrote, or a robot's file or name (no options)", metavar="ROBOT"
        )
    )
    task_stiffness: ArrayLike = field(
        metadata=described(
            "six diagonal values or a symmetric 6x6 matrix (on the command line a CSV file with it), linear first "
            "[N/m, N, N m/rad]",
            nargs="+",
            metavar="K",
        )
    )
    _: KW_ONLY
    representation: Representation = option(
        "representation of wrenches and task stiffness: axes and point of reference (hybrid: base axes, moment "
        "about the tip's origin) (default: hybrid)",
        default="hybrid",
        choices=REPRESENTATIONS,
    )
    negate_wrench: bool = option("recorded wrenches are those that the robot applies to the environment", default=False)
    calibration: str | Path | None = option(
        "recorded wrenches are a sensor's readings; file of 'stiffgen calibrate'", default=None, metavar="FILE"
    )
    tip: str | None = option("tip link, for a robot with several tips", default=None, metavar="LINK")
    q: str | Sequence[str] | None = option(
        "joint positions [rad or m; with the ending :deg in degrees]: prefix of their columns, or names with commas "
        "(default: q_0 ...; NPZ: one array q; MCAP: joint names, default: the robot's)",
        default=None,
        group=COLUMNS,
        metavar="PREFIX|A,B,...",
    )
    wrench: str | Sequence[str] | None = option(
        "force [N], then moment [N m]: prefix of their columns, or six names with commas (default: wrench_0 ...; "
        "NPZ: one array wrench)",
        default=None,
        group=COLUMNS,
        metavar="PREFIX|FX,...",
    )
    time_column: str | None = option(
        "column with time [s], '' for none (default: time, if there is one)",
        default=None,
        group=COLUMNS,
        metavar="NAME",
    )
    topics: Sequence[str] = option(
        "topic to read where several have the type sensor_msgs/msg/JointState or geometry_msgs/msg/WrenchStamped; "
        "repeatable",
        default=(),
        flag="--topic",
        group=TOPICS,
        metavar="TOPIC",
        action="append",
    )
    tolerance: float = option(
        "largest time from joint positions to their wrench [s] (default: 0.01)",
        default=0.01,
        group=TOPICS,
        type=float,
        metavar="S",
    )
    output: str | Path | None = option(
        "folder to write (default: analysis/NAME, with the recording's name)", default=None, metavar="DIR"
    )
    figures: bool = option(
        "write figures and report.html (default: True)",
        default=True,
        negative="write summary.json only, without figures and report.html",
    )
    export: str | None = option(
        "also write the corrected joint stiffness of each row: joint_stiffness.npz, .csv or .parquet",
        default=None,
        choices=EXPORTS,
    )
    dask: str | None = option(
        "address of a Dask scheduler, or 'local' for processes on this machine (they import the calling "
        "script, which must guard its calls by if __name__ == '__main__')",
        default=None,
        metavar="ADDRESS",
    )
    block_rows: int = python_option("rows per block", default=8192)
    progress: ShowProgress = python_option("called with a few words and the completed share (0 ... 1)", default=_silent)


def taking(record: Callable[_Fields, _Chosen]) -> Callable[[Callable[[_Chosen], _Result]], Callable[_Fields, _Result]]:
    """Turn a function of a record into a function of the record's fields, with their signature and meanings.

    The meanings replace ``{arguments}`` in the docstring.
    """

    def made(function: Callable[[_Chosen], _Result]) -> Callable[_Fields, _Result]:
        """Return the function of the fields."""

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
    return text.replace("{arguments}", "\n".join(["Args:", *meanings(record)]))
