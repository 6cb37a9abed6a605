# SPDX-License-Identifier: MIT
"""Recordings of joint positions and wrenches, read as a stream of blocks: CSV, NPZ, Parquet and MCAP files.

A recording is divided into :class:`Partition` objects. A partition is small, can be sent to another process, and reads
its part of the file as :class:`Block` objects of bounded size. The readers keep only a few blocks in memory.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.errors import (
    MissingExtraError,
    RecordingError,
    StiffgenError,
    install_command,
    listed,
    printable,
    shell_word,
)
from stiffgen.core.robot.geometry import FloatArray

PARTITION_ROWS = 1 << 18
"""Rows per partition, for formats that can be divided at any row."""

DEGREES = ":deg"
"""Ending of the joint positions' prefix or last name, where they are recorded in degrees."""
_NUMBER = re.compile(r"\d{1,3}\]?", re.ASCII)
_WRENCH_NAMES = (("fx", "fy", "fz", "mx", "my", "mz"), ("fx", "fy", "fz", "tx", "ty", "tz"))


class RowProblem(NamedTuple):
    """Reason why a row cannot be used: a category for the counts, and a sentence about this row."""

    category: str
    text: str


@dataclass(frozen=True)
class Block:
    """Some rows of a recording.

    Attributes:
        rows: (N,) row numbers in the file, from 0, ascending.
        values: (N, C) one column per entry of ``Columns.names``; NaN where no number could be read.
        missing: (N, C) true where a value is absent; None if no value is.
        problems: rows that could not be read as numbers, by index into the block.
        work: share of the partition's ``work`` that this block completes.

    """

    rows: NDArray[np.int64]
    values: FloatArray
    missing: NDArray[np.bool_] | None = None
    problems: Mapping[int, RowProblem] = field(default_factory=dict)
    work: float = 0.0

    def split(self, most: int) -> Iterator[Block]:
        """Yield the same rows in blocks of at most ``most`` rows."""
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
    """Part of a recording that any process with access to the file can read."""

    @property
    def path(self) -> Path:
        """Return the file."""

    @property
    def work(self) -> float:
        """Return the amount to read: bytes, rows or messages, depending on the format."""

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the partition in blocks of at most ``most`` rows; callers use :func:`read_blocks`."""


@dataclass(frozen=True)
class Columns:
    """Columns of a file in the order of ``Block.values``: time (if there is one), q, wrench; q may be in degrees."""

    time: str | None
    q: tuple[str, ...]
    wrench: tuple[str, ...]
    degrees: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all columns."""
        return (*((self.time,) if self.time else ()), *self.q, *self.wrench)

    def positions(self, values: FloatArray) -> FloatArray:
        """Return the joint positions [rad, m] of rows of ``Block.values``."""
        first = int(self.time is not None)
        q = values[:, first : first + len(self.q)]
        return np.radians(q) if self.degrees else q


def chosen_names(chosen: str | Sequence[str] | None) -> tuple[str, ...] | str | None:
    """Return names as a tuple; a text without commas is a prefix."""
    if isinstance(chosen, str):
        return tuple(name.strip() for name in chosen.split(",")) if "," in chosen else chosen
    return None if chosen is None else tuple(chosen)


@dataclass(frozen=True)
class RecordingRequest:
    """Data that the caller wants from a recording: the joints, and columns whose names differ from the convention.

    Attributes:
        joints: names of the robot's coordinates, in the order of q.
        q: names of the columns with q, or their prefix, or None for ``q_0`` ... (NPZ: one array ``q``). An ending
            ``:deg`` says that they are in degrees.
        wrench: names of the six columns of the wrench, or their prefix, or None for ``wrench_0`` ... (NPZ: one array
            ``wrench``).
        time: name of the column with time [s], None for ``time`` if there is one, "" for no time.
        topics: topics of an MCAP file to read, at most one of each type (default: the only ones of their type).
        tolerance: MCAP: largest time between joint positions and their wrench [s].
        readings: numbers in place of a wrench's six, such as a torque per joint; they are named by ``wrench``.
        flags: the caller's options for q, wrench and time, for messages.

    """

    joints: tuple[str, ...]
    q: tuple[str, ...] | str | None = None
    wrench: tuple[str, ...] | str | None = None
    time: str | None = None
    topics: tuple[str, ...] = ()
    tolerance: float = 0.01
    readings: int = 6
    flags: tuple[str, ...] = ("--q", "--wrench", "--time-column")

    @property
    def dof(self) -> int:
        """Return the number of joint positions per row."""
        return len(self.joints)

    @property
    def remedy(self) -> str:
        """Return what to do about columns that are not found."""
        positions, readings, *time = self.flags
        named = f"Name others with {positions}, {readings} (a prefix, or names with commas)"
        return f"{named} and {time[0]}" if time else named

    @property
    def endings(self) -> tuple[tuple[str, ...], ...]:
        """Return the endings of the readings' columns behind a prefix, beside numbers."""
        return (*([self.joints] if self.readings == self.dof else []), *(_WRENCH_NAMES if self.readings == 6 else ()))

    @property
    def degrees(self) -> bool:
        """Return whether the joint positions are recorded in degrees."""
        if not self.q:
            return False
        last = self.q if isinstance(self.q, str) else self.q[-1]
        return last.endswith(DEGREES)

    def without_unit(self) -> RecordingRequest:
        """Return the request with the names as they stand in the file."""
        if not self.degrees or self.q is None:
            return self
        q = self.q.removesuffix(DEGREES) if isinstance(self.q, str) else (*self.q[:-1], self.q[-1][: -len(DEGREES)])
        return replace(self, q=q or None)

    def names_found(self, path: Path, names: Sequence[str]) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None]:
        """Return the names of the columns with q and wrench, also of those that begin with a prefix; None for default.

        Raises:
            RecordingError: the columns of a prefix are not as many as needed.

        """
        q, wrench = self.q, self.wrench
        return (
            _prefixed(path, names, self.flags[0], q, [self.joints]) if isinstance(q, str) else q,
            _prefixed(path, names, self.flags[1], wrench, self.endings) if isinstance(wrench, str) else wrench,
        )

    def table_columns(self, path: Path, names: Sequence[str]) -> Columns:
        """Find the columns of a table by name.

        Raises:
            RecordingError: a column does not exist, or the number of names is wrong.

        """
        q, wrench = self.names_found(path, names)
        if q is not None and len(q) != self.dof:
            raise RecordingError(f"{self.flags[0]}: {len(q)} names, but the robot has {self.dof} joint positions")
        if wrench is not None and len(wrench) != self.readings:
            what = "a wrench" if self.readings == 6 else "a row"
            raise RecordingError(f"{self.flags[1]}: {len(wrench)} names, but {what} has {self.readings} entries")
        time = ("time" if "time" in names else None) if self.time is None else self.time
        columns = Columns(
            time=time or None,
            q=q or tuple(f"q_{i}" for i in range(self.dof)),
            wrench=wrench or tuple(f"wrench_{i}" for i in range(self.readings)),
        )
        _check_columns(path, columns, names, self.remedy)
        return columns


def _prefixed(
    path: Path, columns: Sequence[str], option: str, prefix: str, endings: Sequence[Sequence[str]]
) -> tuple[str, ...]:
    """Return the columns of a prefix: with one of the lists of endings, numbered from 0 or 1, or the one so named."""
    for names in endings:
        named = tuple(prefix + name for name in names)
        if all(name in columns for name in named):
            return named
    count = len(endings[0])
    numbered = {int(rest.removesuffix("]")): name for name in columns if _NUMBER.fullmatch(rest := _rest(name, prefix))}
    first = min(numbered, default=0)
    if first > 1 or sorted(numbered) != list(range(first, first + count)):
        if prefix in columns:
            return (prefix,)
        raise RecordingError(
            f"{path}: {option} {shell_word(prefix)}: needs {count} columns, {printable(prefix)}0 ... "
            f"{printable(prefix)}{count - 1} or {listed([prefix + name for name in endings[0]])}; the file has "
            f"{listed([name for name in columns if name.startswith(prefix)] or columns, 40)}. "
            "Name them one by one, with commas"
        )
    return tuple(numbered[k] for k in range(first, first + count))


def _rest(name: str, prefix: str) -> str:
    return name[len(prefix) :] if name.startswith(prefix) else ""


@dataclass(frozen=True)
class Recording:
    """Opened recording.

    Attributes:
        path: the file.
        columns: names of the columns.
        partitions: parts of the file, in order.
        first_line: for text files, the line that holds row 0; messages then name rows by line.
        notes: facts about the file that a reader of the results needs, one sentence each.

    """

    path: Path
    columns: Columns
    partitions: tuple[Partition, ...]
    first_line: int | None = None
    notes: tuple[str, ...] = ()

    def row_name(self, row: int) -> str:
        """Return the name of a row for messages: "line 18" of a text file, else "row 17" (counted from 0)."""
        return f"row {row}" if self.first_line is None else f"line {row + self.first_line}"


class _Format(NamedTuple):
    """A file format: the module that reads it, and what to do about a damaged file."""

    module: str
    name: str
    remedy: str


_CSV = _Format("csv_file", "CSV", "write it again as UTF-8 text with a header line")
_FORMATS = {
    ".csv": _CSV,
    ".tsv": _CSV,
    ".txt": _CSV,
    ".npz": _Format("npz_file", "NPZ", "copy it again, or write it again with numpy.savez"),
    ".parquet": _Format("parquet_file", "Parquet", "copy it again, or write it again"),
    ".mcap": _Format("mcap_file", "MCAP", "copy it again, or repair it with 'mcap recover'"),
}


def open_recording(
    path: str | Path, request: RecordingRequest, *, progress: Callable[[str], None] = lambda step: None
) -> Recording:
    """Open a recording and find its columns; no rows are kept in memory.

    Args:
        path: a file named ``.csv``, ``.tsv`` or ``.txt``, ``.npz``, ``.parquet`` or ``.mcap``.
        request: columns to find.
        progress: called with a few words before each long step.

    Raises:
        RecordingError: the file cannot be read or decoded, or does not have the columns.
        MissingExtraError: a package for this format is not installed.

    """
    path = Path(path).absolute()  # workers have other working directories
    known = _FORMATS.get(path.suffix.lower())
    if known is None:
        raise RecordingError(
            f"{path}: recordings are read from files named {listed(sorted(_FORMATS))}, not '{printable(path.suffix)}'"
        )
    try:
        readable = path.is_file()
    except OSError as error:  # a name too long
        raise RecordingError(f"{printable(str(path), 200)}: cannot be read ({error.strerror})") from error
    if not readable:
        raise RecordingError(f"{path}: is no file; name a recording")
    has_mcap_options = request.topics or request.tolerance != RecordingRequest.tolerance
    if known.name != "MCAP" and has_mcap_options:
        raise RecordingError(f"{path}: leave out the options of MCAP files: --topic, --tolerance")
    reader = importlib.import_module(f"{__name__}.{known.module}")
    with _decoding(path):
        opened: Recording = reader.open_file(path, request.without_unit(), progress)
    return replace(opened, columns=replace(opened.columns, degrees=request.degrees))


def read_blocks(partition: Partition, most: int) -> Iterator[Block]:
    """Read a partition in blocks of at most ``most`` rows.

    Raises:
        RecordingError: the file cannot be read or decoded.

    """
    with _decoding(partition.path):
        yield from partition.blocks(most)


@contextmanager
def _decoding(path: Path) -> Iterator[None]:
    """Turn every failure to decode a file into one RecordingError.

    Decoders raise anything when a file is damaged: KeyError, UnicodeDecodeError, MemoryError, errors of their own.
    """
    try:
        yield
    except StiffgenError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.strerror:  # the system's; pyarrow's have no number and no text
            raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error
        known = _FORMATS[path.suffix.lower()]
        cause = f"{type(error).__name__}: {printable(str(error).strip(), 150)}"
        raise RecordingError(f"{path}: is damaged, or is no {known.name} file ({cause}); {known.remedy}") from error


def extra(module: str, purpose: str) -> Any:
    """Import a module of the ``analyze`` extra.

    Raises:
        MissingExtraError: the module is not installed.

    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs {module.partition('.')[0]}, which is not installed; {install_command('analyze')}"
        ) from error


__all__ = [
    "PARTITION_ROWS",
    "Block",
    "Columns",
    "Partition",
    "Recording",
    "RecordingRequest",
    "RowProblem",
    "extra",
    "open_recording",
    "read_blocks",
]


def _check_columns(path: Path, columns: Columns, names: Sequence[str], remedy: str) -> None:
    """Refuse a table that lacks a column, or has several of one name."""
    absent = [name for name in columns.names if name not in names]
    if absent:
        raise RecordingError(f"{path}: has no column {listed(absent)}; it has {listed(names, 40)}. {remedy}")
    doubled = sorted({name for name in columns.names if list(names).count(name) > 1})
    if doubled:
        raise RecordingError(f"{path}: has several columns {listed(doubled)}; rename all but one of each")
