# SPDX-License-Identifier: MIT
"""Text files: pyarrow reads pieces without a fault, Python reads the rows of the other pieces one by one."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from stiffgen.core.errors import RecordingError, printable
from stiffgen.lab.analyze.recording import Block, Columns, Recording, RecordingRequest, RowProblem, extra

_PARTITION = 64 << 20
_PIECE = 4 << 20
_LONGEST_LINE = 1 << 20
_SPACE = " \t\r"
"""Space around a cell. Python's strip() and float() also drop control characters, which stand for damage here."""
_BLANKS = " "
"""Delimiter of a file whose cells stand apart by any number of spaces and tabs."""
_RUN = re.compile(rb"[ \t]+")
_EDGE = re.compile(rb"^[ \t]+|[ \t\r]+$", re.MULTILINE)
_STATED = re.compile(r"\w+: [^,;\t]+(, \w+: [^,;\t]+)*")
"""Comment before the names of the columns, such as ``robot: iiwa14, posture_stiffness: 10 N m/rad``."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class CsvPartition:
    """Part of a file in whole lines: bytes ``start`` to ``stop``, beginning with row number ``row``."""

    path: Path
    start: int
    stop: int
    row: int
    delimiter: str
    width: int
    wanted: tuple[int, ...]
    names: tuple[str, ...]

    @property
    def work(self) -> float:
        """Return the number of bytes."""
        return float(self.stop - self.start)

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the lines in blocks of at most ``most`` rows; blank lines are skipped, but count as rows."""
        row = self.row
        with self.path.open("rb") as file:
            file.seek(self.start)
            at = self.start
            while at < self.stop:
                piece = _lines(file, min(_PIECE, self.stop - at), self.path)
                piece = piece[: self.stop - at]
                if not piece:
                    raise RecordingError(f"{self.path}: became shorter while it was read")
                at += len(piece)
                lines = piece.count(b"\n") + (not piece.endswith(b"\n"))
                block = self._fast(piece, row, lines) or self._line_by_line(piece, row)
                row += lines  # blank lines, which no block holds, count
                yield from block.split(most)

    def _fast(self, piece: bytes, row: int, lines: int) -> Block | None:
        """Read a piece with pyarrow; return None if pyarrow does not take every line of it."""
        if piece.count(b"\r") != piece.count(b"\r\n"):
            return None  # pyarrow takes a carriage return alone for the end of a line
        size = len(piece)
        if self.delimiter == _BLANKS:
            piece = _RUN.sub(b" ", _EDGE.sub(b"", piece))
        pa, pacsv = extra("pyarrow", "reading CSV"), extra("pyarrow.csv", "reading CSV")
        columns = [f"c{i}" for i in range(self.width)]  # unused columns may share a name
        wanted = [columns[i] for i in self.wanted]
        try:
            table = pacsv.read_csv(
                pa.BufferReader(piece),
                read_options=pacsv.ReadOptions(column_names=columns, use_threads=False, block_size=len(piece) + 1),
                parse_options=pacsv.ParseOptions(
                    delimiter=self.delimiter, quote_char=False if self.delimiter == _BLANKS else '"'
                ),
                convert_options=pacsv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, pa.float64()), include_columns=wanted, null_values=[""]
                ),
            )
        except pa.ArrowInvalid:
            return None
        if table.num_rows != lines:
            return None
        values = np.stack([column.to_numpy() for column in table.columns], axis=1)
        missing = None
        if any(column.null_count for column in table.columns):
            missing = np.stack([column.is_null().to_numpy() for column in table.columns], axis=1)
        return Block(np.arange(row, row + lines), values, missing, work=size)

    def _line_by_line(self, piece: bytes, row: int) -> Block:
        """Read lines that pyarrow does not take, and say what is wrong with each bad one; blank ones are left out."""
        rows: list[int] = []
        values: list[list[float]] = []
        missing: list[list[bool]] = []
        problems: dict[int, RowProblem] = {}
        for index, line in enumerate(piece.decode("utf-8", errors="replace").split("\n")):
            if not line.strip(_SPACE):
                continue
            numbers, absent, problem = self._read_line(line)
            if problem is not None:
                problems[len(rows)] = problem
            rows.append(row + index)
            values.append(numbers)
            missing.append(absent)
        return Block(
            np.array(rows, dtype=np.int64),
            np.array(values, dtype=float).reshape(len(rows), len(self.wanted)),
            np.array(missing, dtype=bool).reshape(len(rows), len(self.wanted)),
            problems,
            work=len(piece),
        )

    def _read_line(self, line: str) -> tuple[list[float], list[bool], RowProblem | None]:
        """Return the numbers of a line (NaN where there is none), which of them are absent, and the first problem."""
        numbers = [np.nan] * len(self.wanted)
        absent = [False] * len(self.wanted)
        cells = _cells(line.rstrip("\r"), self.delimiter)
        if len(cells) != self.width:
            text = f"{len(cells)} columns, where the header has {self.width}"
            return numbers, absent, RowProblem("wrong number of columns", text)
        problem = None
        for k, column in enumerate(self.wanted):
            absent[k] = not cells[column]
            number = _number(cells[column])
            if number is not None:
                numbers[k] = number
            elif problem is None:
                problem = RowProblem("text", f"{self.names[k]} is '{printable(cells[column], 20)}'")
        return numbers, absent, problem


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == _BLANKS:
        return [cell for cell in re.split(f"[{_SPACE}]+", line) if cell]
    try:
        return [cell.strip(_SPACE) for cell in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error:
        return []  # a cell longer than any number, or an open quote: reported as a wrong number of columns


def _number(cell: str) -> float | None:
    if not cell:
        return float("nan")
    return float(cell) if _NUMBER.fullmatch(cell) else None


def _lines(file: BinaryIO, size: int, path: Path) -> bytes:
    """Read about ``size`` bytes, up to the end of a line."""
    piece = file.read(size)
    if piece and not piece.endswith(b"\n"):
        rest = file.readline(_LONGEST_LINE)
        _refuse_long(rest, path)
        piece += rest
    return piece


def _refuse_long(line: bytes, path: Path) -> None:
    if len(line) == _LONGEST_LINE:
        raise RecordingError(f"{path}: has a line of over {_LONGEST_LINE} bytes; is it a text file?")


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the columns in the header line, and divide the file at line ends."""
    extra("pyarrow.csv", "reading CSV")
    header_line = 0
    stated: list[str] = []
    with path.open("rb") as file:
        header = ""
        while not header:
            line = file.readline(_LONGEST_LINE)
            _refuse_long(line, path)
            if not line:
                raise RecordingError(f"{path}: is empty; its first line names the columns")
            header_line += 1
            # NumPy's savetxt marks the header as a comment.
            header = line.decode("utf-8-sig", errors="replace").strip().removeprefix("#").strip()
            if line.startswith(b"#") and _STATED.fullmatch(header):
                stated.append(header)
                header = ""
        delimiter = _delimiter(header)
        names = _cells(header, delimiter)
        if all(_number(name) is not None for name in names):
            raise RecordingError(
                f"{path}: line {header_line} has numbers where the columns' names must stand: '{printable(header)}'; "
                "add a header line such as time,q_0,...,wrench_5"
            )
        columns = request.table_columns(path, names)
        partitions = []
        progress(f"counting the lines of {path.name}")
        start, row = file.tell(), 0
        while piece := _lines(file, _PARTITION, path):
            stop = start + len(piece)
            partitions.append(_partition(path, start, stop, row, delimiter, names, columns))
            start, row = stop, row + piece.count(b"\n")
    notes = tuple(f"The log states: {printable(text, 200)}." for text in stated)
    return Recording(path, columns, tuple(partitions), first_line=header_line + 1, notes=notes)


def _delimiter(header: str) -> str:
    """Return the separator that gives the most columns: comma, semicolon or tab, or blanks where there is none."""
    best = max(",;\t", key=lambda delimiter: len(_cells(header, delimiter)))
    return best if len(_cells(header, best)) > 1 else _BLANKS


def _partition(
    path: Path, start: int, stop: int, row: int, delimiter: str, names: list[str], columns: Columns
) -> CsvPartition:
    wanted = tuple(names.index(name) for name in columns.names)
    return CsvPartition(path, start, stop, row, delimiter, len(names), wanted, columns.names)
