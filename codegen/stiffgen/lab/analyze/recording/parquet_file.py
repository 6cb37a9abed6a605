# SPDX-License-Identifier: MIT
"""Parquet files, read by pyarrow page by page; partitions consist of row groups."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.errors import RecordingError, printable
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.recording import PARTITION_ROWS, Block, Recording, RecordingRequest, extra

_BUFFER = 1 << 18


@dataclass(frozen=True)
class ParquetPartition:
    """Consecutive row groups; ``row`` is the number of their first row."""

    path: Path
    groups: tuple[int, ...]
    row: int
    rows: int
    names: tuple[str, ...]

    @property
    def work(self) -> float:
        """Return the number of rows."""
        return float(self.rows)

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the row groups in blocks of at most ``most`` rows."""
        row = self.row
        with _opened(self.path) as file:
            for batch in file.iter_batches(
                batch_size=most, row_groups=list(self.groups), columns=list(self.names), use_threads=False
            ):
                columns = [batch.column(name) for name in self.names]
                missing = None
                if any(column.null_count for column in columns):
                    missing = np.stack([c.is_null().to_numpy(zero_copy_only=False) for c in columns], axis=1)
                values = np.stack([_numbers(column) for column in columns], axis=1)
                yield Block(np.arange(row, row + len(values)), values, missing, work=len(values))
                row += len(values)
        if row != self.row + self.rows:
            raise EOFError(f"{row - self.row} rows where the footer says {self.rows}")


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


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the columns in the schema, and join row groups into partitions of some 10^5 rows."""
    pa = extra("pyarrow", "reading Parquet")
    progress(f"reading the footer of {path.name}")
    with _opened(path) as file:
        schema, metadata = file.schema_arrow, file.metadata
    columns = request.table_columns(path, schema.names)
    for name in columns.names:
        kind = schema.field(name).type
        number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
        if not number and not (name == columns.time and pa.types.is_timestamp(kind)):
            raise RecordingError(
                f"{path}: column {name} holds values of type {printable(str(kind))}, not numbers; convert it"
            )
    partitions: list[ParquetPartition] = []
    groups: list[int] = []
    row = rows = 0
    for group in range(metadata.num_row_groups):
        groups.append(group)
        rows += metadata.row_group(group).num_rows
        if rows >= PARTITION_ROWS or group == metadata.num_row_groups - 1:
            partitions.append(ParquetPartition(path, tuple(groups), row, rows, columns.names))
            groups, row, rows = [], row + rows, 0
    return Recording(path, columns, tuple(partitions))
