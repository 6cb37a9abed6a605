# SPDX-License-Identifier: MIT
"""Recordings of joint positions and wrenches, read as a stream of blocks: CSV, NPZ, Parquet and MCAP files.

A recording is cut into :class:`Partition` objects, which are small, can be sent to another process, and read their own
part of the file as :class:`Block` objects of bounded size. Nothing here holds more than some blocks.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from stiffgen.errors import MissingExtraError, RecordingError, listed, printable

Array = NDArray[np.float64]

PARTITION_ROWS = 1 << 18
"""Rows of a partition, where a file can be cut freely."""


class Problem(NamedTuple):
    """Why a row cannot be used: a category to count by, and a sentence about this one row."""

    category: str
    text: str


@dataclass(frozen=True)
class Block:
    """Some rows of a recording.

    Attributes:
        rows: (N,) row numbers in the file, from 0, ascending.
        values: (N, C) one column for each entry of ``Layout.names``; NaN where nothing could be read.
        missing: (N, C) where a value is absent, or None if none can be.
        problems: by index into the block, rows that could not be read as numbers.
        work: share of the partition's ``work`` that is done with this block.

    """

    rows: NDArray[np.int64]
    values: Array
    missing: NDArray[np.bool_] | None = None
    problems: Mapping[int, Problem] = field(default_factory=dict)
    work: float = 0.0

    def split(self, most: int) -> Iterator[Block]:
        """The same rows in blocks of at most ``most`` rows."""
        if len(self.rows) <= most:
            yield self
            return
        for start in range(0, len(self.rows), most):
            part = slice(start, start + most)
            yield Block(
                rows=self.rows[part],
                values=self.values[part],
                missing=None if self.missing is None else self.missing[part],
                problems={i - start: p for i, p in self.problems.items() if start <= i < start + most},
                work=self.work * len(self.rows[part]) / len(self.rows),
            )


class Partition(Protocol):
    """A part of a recording that can be read on its own, in any process that sees the file."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def work(self) -> float:
        """How much there is to read, in the recording's own measure."""

    def blocks(self, most: int) -> Iterator[Block]:
        """Read it, in blocks of at most ``most`` rows."""


@dataclass(frozen=True)
class Layout:
    """Which columns of a file hold what, in the order of ``Block.values``: time (if there is one), q, wrench."""

    time: str | None
    q: tuple[str, ...]
    wrench: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All columns."""
        return (*((self.time,) if self.time else ()), *self.q, *self.wrench)


@dataclass(frozen=True)
class Request:
    """What is asked of a recording: how many joints, and names of columns where they differ from the convention.

    Attributes:
        joints: names of the robot's coordinates, in the order of q.
        q: names of the columns with q, or None for ``q_0`` ... (NPZ: one array ``q``).
        wrench: names of the six columns of the wrench, or None for ``wrench_0`` ... (NPZ: one array ``wrench``).
        time: name of the column with time [s], None for ``time`` if there is one, "" for no time.
        q_topic, wrench_topic: topics of an MCAP file (default: the only ones of their type).
        tolerance: MCAP: largest time between joint positions and their wrench [s].

    """

    joints: tuple[str, ...]
    q: tuple[str, ...] | None = None
    wrench: tuple[str, ...] | None = None
    time: str | None = None
    q_topic: str | None = None
    wrench_topic: str | None = None
    tolerance: float = 0.01

    @property
    def dof(self) -> int:
        """Number of joint positions of a row."""
        return len(self.joints)

    def flat_layout(self, path: Path, columns: Sequence[str]) -> Layout:
        """The columns of a table by name.

        Raises:
            RecordingError: a column does not exist, or not the right number was named.

        """
        if self.q is not None and len(self.q) != self.dof:
            raise RecordingError(f"--q-columns: {len(self.q)} names, but the robot has {self.dof} joint positions")
        if self.wrench is not None and len(self.wrench) != 6:
            raise RecordingError(f"--wrench-columns: {len(self.wrench)} names, but a wrench has 6 entries")
        layout = Layout(
            time=("time" if "time" in columns else None) if self.time is None else self.time or None,
            q=self.q or tuple(f"q_{i}" for i in range(self.dof)),
            wrench=self.wrench or tuple(f"wrench_{i}" for i in range(6)),
        )
        absent = [name for name in layout.names if name not in columns]
        if absent:
            raise RecordingError(
                f"{path}: has no column {listed(absent)}; it has {listed(columns, 40)}. "
                "Name others with --q-columns, --wrench-columns and --time-column"
            )
        doubled = sorted({name for name in layout.names if list(columns).count(name) > 1})
        if doubled:
            raise RecordingError(f"{path}: has several columns {listed(doubled)}; rename all but one of each")
        return layout


@dataclass(frozen=True)
class Recording:
    """An opened recording.

    Attributes:
        path: the file.
        layout: names of the columns.
        partitions: parts of the file, in order.
        first_line: for text files, the line on which row 0 stands; rows are named by line then.
        notes: what a reader of the results should know about the file, one sentence each.

    """

    path: Path
    layout: Layout
    partitions: tuple[Partition, ...]
    first_line: int | None = None
    notes: tuple[str, ...] = ()

    def row_name(self, row: int) -> str:
        """How a row is called in messages: "line 18" of a text file, else "row 17" counted from 0."""
        return f"row {row}" if self.first_line is None else f"line {row + self.first_line}"


def open_recording(
    path: str | Path, request: Request, *, progress: Callable[[str], None] = lambda step: None
) -> Recording:
    """Open a recording and find its columns; no rows are held.

    Args:
        path: a file named ``.csv``, ``.tsv`` or ``.txt``, ``.npz``, ``.parquet`` or ``.mcap``.
        request: which columns are wanted.
        progress: called with a few words before something long.

    Raises:
        RecordingError: the file cannot be read, or does not have the columns.
        MissingExtraError: a package for this format is not installed.

    """
    path = Path(path).absolute()  # workers have other working directories
    formats = {
        ".csv": "csv_file",
        ".tsv": "csv_file",
        ".txt": "csv_file",
        ".npz": "npz_file",
        ".parquet": "parquet_file",
        ".mcap": "mcap_file",
    }
    reader = formats.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(
            f"{path}: recordings are read from files named {listed(sorted(formats))}, not '{printable(path.suffix)}'"
        )
    try:
        readable = path.is_file()
    except OSError as error:  # a name too long
        raise RecordingError(f"{printable(str(path), 200)}: cannot be read ({error.strerror})") from error
    if not readable:
        raise RecordingError(f"{path}: is no file; name a recording")
    topics = request.q_topic or request.wrench_topic or request.tolerance != Request.tolerance
    if reader != "mcap_file" and topics:
        raise RecordingError(f"{path}: --q-topic, --wrench-topic and --tolerance are of MCAP files; leave them out")
    try:
        opened: Recording = importlib.import_module(f"{__name__}.{reader}").open_file(path, request, progress)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from error
    return opened


def extra(module: str, purpose: str) -> Any:
    """Import a module that comes with the ``analyze`` extra.

    Raises:
        MissingExtraError: it is not installed.

    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs {module.partition('.')[0]}, which is not installed; pip install 'stiffgen[analyze]'"
        ) from error


__all__ = [
    "PARTITION_ROWS",
    "Array",
    "Block",
    "Layout",
    "Partition",
    "Problem",
    "Recording",
    "Request",
    "extra",
    "open_recording",
]
