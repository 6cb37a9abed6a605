# SPDX-License-Identifier: MIT
"""Parquet files, read by pyarrow page by page; partitions consist of row groups.

A column of lists, as LeRobot writes them, counts as columns of numbers: ``state0``, ``state1`` ... of ``state``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.errors import RecordingError, printable
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.recording import PARTITION_ROWS, Block, Recording, RecordingRequest, extra

_BUFFER = 1 << 18
_LONGEST = 1000
"""Entries of a list that count as columns; a recording's lists are shorter."""


@dataclass(frozen=True)
class ParquetPartition:
    """Consecutive row groups; ``row`` is the number of their first row."""

    path: Path
    groups: tuple[int, ...]
    row: int
    rows: int
    names: tuple[str, ...]
    entries: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    """Names that are entries of lists: their column, and the place in the list."""

    @property
    def work(self) -> float:
        """Return the number of rows."""
        return float(self.rows)

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the row groups in blocks of at most ``most`` rows."""
        row = self.row
        read = list(dict.fromkeys(self.entries.get(name, (name, 0))[0] for name in self.names))
        with _opened(self.path) as file:
            for batch in file.iter_batches(
                batch_size=most, row_groups=list(self.groups), columns=read, use_threads=False
            ):
                columns = [self._column(batch, name) for name in self.names]
                missing = None
                if any(column.null_count for column in columns):
                    missing = np.stack([c.is_null().to_numpy(zero_copy_only=False) for c in columns], axis=1)
                values = np.stack([_numbers(column) for column in columns], axis=1)
                yield Block(np.arange(row, row + len(values)), values, missing, work=len(values))
                row += len(values)
        if row != self.row + self.rows:
            raise EOFError(f"{row - self.row} rows where the footer says {self.rows}")

    def _column(self, batch: Any, name: str) -> Any:
        """Return a column of a batch, or the entries at one place of its lists; null where a list is too short."""
        if name not in self.entries:
            return batch.column(name)
        column, place = self.entries[name]
        pa, pc = (extra(module, "reading Parquet") for module in ("pyarrow", "pyarrow.compute"))
        lists = batch.column(column)
        if not pa.types.is_fixed_size_list(lists.type):
            short = pc.less_equal(pc.list_value_length(lists), place)
            lists = pc.if_else(short, pa.scalar(None, lists.type), lists)
        return pc.list_element(lists, place)


def _opened(path: Path) -> Any:
    # Without pre-buffering and with a buffer per column, pyarrow reads page by page: row groups may have any size
    # (one of 45 MB takes 6 MB; pyarrow.dataset holds all of it).
    parquet = extra("pyarrow.parquet", "reading Parquet")
    return parquet.ParquetFile(path, pre_buffer=False, buffer_size=_BUFFER, page_checksum_verification=True)


def _numbers(column: Any) -> FloatArray:
    """Return a column as numbers, NaN where one is missing; timestamps become seconds."""
    pa = extra("pyarrow", "reading Parquet")
    if pa.types.is_timestamp(column.type):
        nanoseconds = column.cast(pa.timestamp("ns", tz=column.type.tz)).cast(pa.int64())
        seconds: FloatArray = (
            np.asarray(nanoseconds.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)) * 1e-9
        )
        return seconds
    numbers: FloatArray = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return numbers


def _entries(path: Path, schema: Any) -> dict[str, tuple[str, int]]:
    """Return a name for each entry of each column of lists; a list's length is that of the schema or the first row."""
    pa = extra("pyarrow", "reading Parquet")
    found: dict[str, tuple[str, int]] = {}
    for each in schema:
        if pa.types.is_fixed_size_list(each.type):
            length = each.type.list_size
        elif pa.types.is_list(each.type):
            with _opened(path) as file:
                first = next(file.iter_batches(batch_size=1, columns=[each.name]), None)
            length = len(first.column(0)[0].as_py() or ()) if first is not None and len(first) else 0
        else:
            continue
        found |= {f"{each.name}{place}": (each.name, place) for place in range(min(length, _LONGEST))}
    return {name: place for name, place in found.items() if name not in schema.names}


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the columns in the schema, and join row groups into partitions of some 10^5 rows."""
    pa = extra("pyarrow", "reading Parquet")
    progress(f"reading the footer of {path.name}")
    with _opened(path) as file:
        schema, metadata = file.schema_arrow, file.metadata
    entries = _entries(path, schema)
    lists = {column for column, _ in entries.values()}  # a column of lists counts as one column for each entry
    columns = request.table_columns(path, [*(name for name in schema.names if name not in lists), *entries])
    for name in columns.names:
        column, _ = entries.get(name, (name, 0))
        kind = schema.field(column).type
        kind = kind.value_type if column in lists else kind
        number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
        if not number and not (name == columns.time and pa.types.is_timestamp(kind)):
            raise RecordingError(
                f"{path}: column {name} holds values of type {printable(str(kind))}, not numbers; convert it"
            )
    # join row groups until they have enough rows; row: first of the partition, rows: how many
    partitions: list[ParquetPartition] = []
    groups: list[int] = []
    row = rows = 0
    for group in range(metadata.num_row_groups):
        groups.append(group)
        rows += metadata.row_group(group).num_rows
        if rows >= PARTITION_ROWS or group == metadata.num_row_groups - 1:
            partitions.append(ParquetPartition(path, tuple(groups), row, rows, columns.names, entries))
            groups, row, rows = [], row + rows, 0
    return Recording(path, columns, tuple(partitions))
