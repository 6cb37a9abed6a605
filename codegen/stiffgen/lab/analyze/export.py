# SPDX-License-Identifier: MIT
"""Corrected joint stiffness of every analysed row, written as NPZ, CSV or Parquet while the recording is read again."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.measures import judged
from stiffgen.lab.analyze.recording import Recording, extra, read_blocks
from stiffgen.lab.analyze.task import Task

NAME = "joint_stiffness"


@dataclass(frozen=True)
class Rows:
    """Consecutive analysed rows: numbers in the recording, times [s] (NaN without time), stiffness (N, n, n)."""

    rows: NDArray[np.int64]
    time: FloatArray
    stiffness: FloatArray


def export(
    folder: Path,
    kind: str,
    robot: ModuleType,
    task: Task,
    recording: Recording,
    good: int,
    most: int,
    advance: Callable[[float], None],
) -> None:
    """Write ``joint_stiffness`` with the ending ``kind`` into a folder; memory does not grow with the rows.

    Args:
        folder: an existing folder.
        kind: "npz", "csv" or "parquet".
        robot: the generated module.
        task: the computation that was done.
        recording: the recording.
        good: number of analysed rows.
        most: rows per block.
        advance: called with the number of rows that were written.

    """
    write = {"npz": _npz, "csv": _csv, "parquet": _parquet}[kind]
    write(folder / f"{NAME}.{kind}", _rows(robot, task, recording, most, advance), good, len(recording.columns.q))


def _rows(
    robot: ModuleType, task: Task, recording: Recording, most: int, advance: Callable[[float], None]
) -> Iterator[Rows]:
    """Yield the good rows of each block with their corrected stiffness; time is NaN in a recording without it."""
    timed = recording.columns.time is not None
    for partition in recording.partitions:
        for block in read_blocks(partition, most):
            good, q, wrench, *_ = judged(robot, task, recording.columns, block)
            time = block.values[good, 0] if timed else np.full(int(good.sum()), np.nan)
            K = task.functions_of(robot).joint_stiffness(q[good], wrench[good], task.task_stiffness)
            yield Rows(block.rows[good], time, K)
            advance(len(time))


def columns(count: int) -> list[str]:
    """Return the names of the columns of a table: row, time, and the entries of K row by row."""
    return ["row", "time", *(f"K_{i}_{j}" for i in range(count) for j in range(count))]


def _npz(file: Path, parts: Iterator[Rows], good: int, count: int) -> None:
    """Write arrays of ``good`` rows to files of their own, part by part, and pack these into one."""
    arrays = {"row": ("<i8", (good,)), "time": ("<f8", (good,)), NAME: ("<f8", (good, count, count))}
    members = {name: file.with_suffix(f".{name}.npy") for name in arrays}
    opened = {
        name: np.lib.format.open_memmap(members[name], mode="w+", dtype=np.dtype(kind), shape=shape)
        for name, (kind, shape) in arrays.items()
    }
    at = 0
    for part in parts:
        end = at + len(part.rows)
        for name, values in zip(arrays, (part.rows, part.time, part.stiffness), strict=True):
            opened[name][at:end] = values
        at = end
    opened.clear()  # closes the files
    with zipfile.ZipFile(file, "w", allowZip64=True) as archive:
        for name, member in members.items():
            archive.write(member, f"{name}.npy")
            member.unlink()


def _table(part: Rows) -> FloatArray:
    flat = part.stiffness.reshape(len(part.rows), -1)
    return np.column_stack([part.time, flat])


def _csv(file: Path, parts: Iterator[Rows], good: int, count: int) -> None:
    with file.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(columns(count)) + "\n")
        for part in parts:
            for row, values in zip(part.rows.tolist(), _table(part).tolist(), strict=True):
                out.write(f"{row}," + ",".join(map(repr, values)) + "\n")


def _parquet(file: Path, parts: Iterator[Rows], good: int, count: int) -> None:
    """Write row numbers, times and stiffness entries to a Parquet file, part by part."""
    pa, parquet = extra("pyarrow", "--export parquet"), extra("pyarrow.parquet", "--export parquet")
    names = columns(count)
    schema = pa.schema([(names[0], pa.int64()), *((name, pa.float64()) for name in names[1:])])
    with ExitStack() as stack:
        writer = stack.enter_context(parquet.ParquetWriter(file, schema))
        for part in parts:
            arrays = [part.rows, *np.ascontiguousarray(_table(part).T)]
            writer.write_table(pa.table(arrays, schema=schema))
