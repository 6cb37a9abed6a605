# SPDX-License-Identifier: MIT
"""NPZ files, read whole by ``numpy.load``: for recordings larger than the memory there are CSV, Parquet and MCAP."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.errors import RecordingError, listed
from stiffgen.lab.analyze.recording import NAME_OTHERS, Block, Columns, Recording, RecordingRequest


@dataclass(frozen=True)
class NpzPartition:
    """All rows of some arrays side by side."""

    path: Path
    names: tuple[str, ...]
    rows: int

    @property
    def work(self) -> float:
        """Return the number of rows."""
        return float(self.rows)

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the file, and yield its rows in blocks of at most ``most`` rows."""
        with zipfile.ZipFile(self.path) as archive:
            values = np.column_stack([_array(self.path, archive, name).astype(float) for name in self.names])
        yield from Block(np.arange(self.rows), values, work=self.rows).split(most)


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the arrays: ``q`` (N, n), ``wrench`` (N, 6) and ``time`` (N,), or one array (N,) per column."""
    progress(f"checking the arrays of {path.name}")
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        time, q, wrench = _chosen(path, request, names)
        arrays = {name: _array(path, archive, name) for name in (*time, *q, *wrench)}
    for group, width, what in ((time, 1, "time"), (q, request.dof, "q"), (wrench, 6, "wrench")):
        _check_shapes(path, {name: arrays[name].shape for name in group}, width, what)
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordingError(f"{path}: the arrays differ in length ({shown}); write arrays with one entry per row")
    columns = Columns(time[0] if time else None, _column_names(q, request.dof), _column_names(wrench, 6))
    rows = next(iter(lengths.values()))
    return Recording(path, columns, (NpzPartition(path, (*time, *q, *wrench), rows),) if rows else ())


def _array(path: Path, archive: zipfile.ZipFile, name: str) -> NDArray[np.generic]:
    """Return an array of numbers; refuse objects, other types, and bytes beyond the array's end."""
    with archive.open(f"{name}.npy") as stream:
        try:
            array: NDArray[np.generic] = np.load(stream, allow_pickle=False)
        except ValueError as error:
            if "allow_pickle" in str(error):
                raise RecordingError(
                    f"{path}: array {name} holds Python objects, not numbers; convert it first"
                ) from error
            raise
        if stream.read(1):
            raise RecordingError(
                f"{path}: array {name} has more bytes than its header says ({array.shape} of {array.dtype}); "
                "write it again with numpy.savez"
            )
    if array.dtype.kind not in "fiu":
        raise RecordingError(f"{path}: array {name} holds values of type {array.dtype}, not numbers; convert it first")
    return array


def _chosen(path: Path, request: RecordingRequest, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return the names of the arrays with time, q and wrench: one two-dimensional array, or one array per column."""
    q, wrench = request.names_found(path, names)
    q = q or (("q",) if "q" in names else tuple(f"q_{i}" for i in range(request.dof)))
    wrench = wrench or (("wrench",) if "wrench" in names else tuple(f"wrench_{i}" for i in range(6)))
    default_time = "time" if "time" in names else ""
    time_name = default_time if request.time is None else request.time
    time = (time_name,) if time_name else ()
    for option, chosen, width in (("--q", q, request.dof), ("--wrench", wrench, 6)):
        if len(chosen) not in (1, width):
            raise RecordingError(f"{option}: name one array (N, {width}), or {width} arrays (N,)")
    absent = [name for name in (*time, *q, *wrench) if name not in names]
    if absent:
        raise RecordingError(f"{path}: has no array {listed(absent)}; it has {listed(names, 40)}. {NAME_OTHERS}")
    return time, q, wrench


def _check_shapes(path: Path, shapes: Mapping[str, tuple[int, ...]], width: int, what: str) -> None:
    for name, shape in shapes.items():
        if shape[1:] == ((width,) if len(shapes) == 1 and what != "time" else ()) and len(shape) >= 1:
            continue
        wanted = "(N,)" if what == "time" or len(shapes) > 1 else f"(N, {width})"
        turned = "; transpose it" if len(shape) == 2 and shape[0] == width else ""
        raise RecordingError(f"{path}: array {name} is of shape {shape}, but {what} is {wanted}{turned}")


def _column_names(names: tuple[str, ...], width: int) -> tuple[str, ...]:
    return names if len(names) == width else tuple(f"{names[0]}[{i}]" for i in range(width))
