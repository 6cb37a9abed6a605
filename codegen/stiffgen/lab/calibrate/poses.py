# SPDX-License-Identifier: MIT
"""Find the poses of a recording at which the robot stands still, with their mean readings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.errors import RecordingError
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.rooms import optional

_WINDOW = 0.1
"""[s] Time over which the motion is looked at."""
_ROWS = 20
"""Rows of this time for a recording without time."""
_MOTION = 5e-4
"""[rad or m] Largest motion of a joint at rest within the window."""
_LEAST = 5
"""Least duration of a pose in windows."""
_MOST_ROWS = 1 << 24
"""Most rows of a recording: 128 MiB per column."""
_BLOCK_ROWS = 1 << 16
"""Rows that are read at once."""


@dataclass(frozen=True)
class StandingPoses:
    """Poses at rest: joint positions (P, n), mean readings (P, 6), times (P) [s], zeros without time."""

    q: FloatArray
    reading: FloatArray
    time: FloatArray

    def __len__(self) -> int:
        return len(self.q)


def read_rows(
    log: str | Path,
    names: tuple[str, ...],
    q: str | None = None,
    reading: str | None = None,
    *,
    most: int = _MOST_ROWS,
    readings: int = 6,
    positions_flag: str = "--q",
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return positions, readings and time (None without) of all rows without a missing number.

    ``names`` are those of the positions, in order. ``q`` and ``reading`` are prefixes of columns, or their names with
    commas; None for the default names. ``most`` is the largest number of rows, ``readings`` that of numbers in a
    reading. ``positions_flag`` is the caller's option for ``q``.

    Raises:
        RecordingError: the recording cannot be read, is too long, or the reader of recordings has been taken out.

    """
    opened = _opened(log, names, q, reading, readings, positions_flag)
    recording = _reader(log)
    blocks = [block.values for part in opened.partitions for block in recording.read_blocks(part, _BLOCK_ROWS)]
    rows = np.concatenate(blocks) if blocks else np.zeros((0, len(opened.columns.names)))
    if len(rows) > most:
        raise RecordingError(f"{log}: has {len(rows)} rows, of at most {most}: record the poses or the motion alone")
    rows = rows[np.isfinite(rows).all(axis=1)]
    # columns: time, if any, then positions, then readings
    has_time = opened.columns.time is not None
    first_reading = int(has_time) + len(names)
    return opened.columns.positions(rows), rows[:, first_reading:], rows[:, 0] if has_time else None


def has_columns(log: str | Path, names: tuple[str, ...], q: str | None, reading: str | None) -> bool:
    """Return whether a recording opens with these positions and readings; see ``read_rows``."""
    try:
        _opened(log, names, q, reading, 6, "--positions")
    except RecordingError:
        return False
    return True


def _reader(log: str | Path) -> Any:
    """Return the package that reads recordings; its room may have been taken out."""
    recording = optional("lab.analyze.recording")
    if recording is None:
        raise RecordingError(f"{log}: recordings are read with the package's folder analyze/, which is not there")
    return recording


def _opened(
    log: str | Path, names: tuple[str, ...], q: str | None, reading: str | None, readings: int, positions_flag: str
) -> Any:
    """Return a recording with its columns found."""
    recording = _reader(log)
    request = recording.RecordingRequest(
        names,
        q=recording.chosen_names(q),
        wrench=recording.chosen_names(reading),
        readings=readings,
        flags=(positions_flag, "--reading"),
    )
    return recording.open_recording(log, request)


def standing(q: FloatArray, reading: FloatArray, time: FloatArray | None) -> StandingPoses:
    """Return the poses of half a second or more; the first and last window of each are left out."""
    window = _rows_of_window(time)
    found = []
    for rows in _rows_at_rest(q, window):
        at = 0.0 if time is None else float(time[rows].mean())
        found.append((q[rows].mean(axis=0), reading[rows].mean(axis=0), at))
    if not found:
        return StandingPoses(np.zeros((0, q.shape[1])), np.zeros((0, 6)), np.zeros(0))
    postures, readings, times = zip(*found, strict=True)
    return StandingPoses(np.array(postures), np.array(readings), np.array(times))


def _rows_of_window(time: FloatArray | None) -> int:
    """Return the rows in which a motion is looked for: those of 0.1 s, at least 2."""
    if time is None or len(time) < 2:
        return _ROWS
    step = float(np.median(np.diff(time)))
    return max(2, round(_WINDOW / step)) if step > 0 else _ROWS


def _rows_at_rest(q: FloatArray, window: int) -> Iterator[slice]:
    """Yield the rows of each pose without its first and last window; q (N, n) [rad or m].

    Row k is still if q stays the same in the window from k to k + window. A pose is a run of five windows or more of
    such rows.
    """
    if len(q) <= window:
        return
    half = window // 2  # the middle counts, too: a motion there and back does not show at the window's end
    first, middle, last = q[:-window], q[half : len(q) - window + half], q[window:]
    moved = np.maximum(np.abs(last - first), np.abs(middle - first)).max(axis=1)
    is_still = np.concatenate([[False], moved < _MOTION, [False]])  # so that each run begins and ends within
    edges = np.flatnonzero(np.diff(is_still.astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):  # rows start to end - 1 are still
        if end - start >= _LEAST * window:
            yield slice(start + window, end)  # the window of the last still row ends before end + window
