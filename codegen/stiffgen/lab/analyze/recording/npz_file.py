# SPDX-License-Identifier: MIT
"""NPZ files, read as a stream of rows. The headers of the arrays are looked at before any number is.

A compressed file of a few megabytes may hold gigabytes: nothing is allocated by a size that a header states alone.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from stiffgen.core.errors import RecordingError, listed
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.recording import Block, Columns, Recording, RecordingRequest

_MAGIC = 8
"""Bytes of an array's file before the length of its header: the word NUMPY, and the version."""
_START = 12
"""Bytes of an array's file with the length of its header, in every version of the format."""
_LONGEST_HEADER = 10_000  # as numpy's own limit
_PIECE = 1 << 20
_MOST_TURNED = 1 << 30
"""Largest array that is stored column by column, which is read whole."""


class Header(NamedTuple):
    """Header of an array: ``is_turned`` if the array is stored column by column."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    is_turned: bool


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
        """Read the rows in blocks of at most ``most`` rows."""
        with ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(self.path))
            columns = []
            for name in self.names:
                stream = stack.enter_context(archive.open(f"{name}.npy"))
                header = _header(self.path, archive, name, stream)
                columns.append(_rows(header, stream, most))
            row = 0
            for parts in zip(*columns, strict=True):
                values = np.column_stack(parts)
                yield Block(np.arange(row, row + len(values)), values, work=len(values))
                row += len(values)


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the arrays: ``q`` (N, n), ``wrench`` (N, 6) and ``time`` (N,), or one array (N,) per column."""
    progress(f"checking the arrays of {path.name}")
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        time, q, wrench = _chosen(path, request, names)
        arrays = {}
        for name in (*time, *q, *wrench):
            with archive.open(f"{name}.npy") as stream:
                arrays[name] = _header(path, archive, name, stream)
    for group, width, what in ((time, 1, "time"), (q, request.dof, "q"), (wrench, request.readings, "wrench")):
        _check_shapes(path, {name: arrays[name].shape for name in group}, width, what)
    lengths = {name: array.shape[0] for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordingError(f"{path}: the arrays differ in length ({shown}); write arrays with one entry per row")
    columns = Columns(time[0] if time else None, _column_names(q, request.dof), _column_names(wrench, request.readings))
    rows = next(iter(lengths.values()))
    _check_sums(path, tuple(arrays))
    return Recording(path, columns, (NpzPartition(path, (*time, *q, *wrench), rows),) if rows else ())


def _header(path: Path, archive: zipfile.ZipFile, name: str, stream: IO[bytes]) -> Header:
    """Read the header of an array of numbers; refuse other types, and a size that is not the file's."""
    start = stream.read(_START)
    version, _ = np.lib.format.read_magic(io.BytesIO(start))
    width = 2 if version == 1 else 4  # bytes of the length
    length = int.from_bytes(start[_MAGIC : _MAGIC + width], "little")
    if length > _LONGEST_HEADER:
        raise RecordingError(f"{path}: array {name} has a header of {length} bytes; write it again with numpy.savez")
    begin = _MAGIC + width + length  # of the numbers
    whole = io.BytesIO(start + stream.read(begin - _START))
    whole.seek(_MAGIC)
    if version == 1:
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(whole)
    else:  # version 3.0 differs in the names of fields, which no array of numbers has
        shape, is_fortran, dtype = np.lib.format.read_array_header_2_0(whole)
    if dtype.hasobject:
        raise RecordingError(f"{path}: array {name} holds Python objects, not numbers; convert it first")
    if dtype.kind not in "fiu":
        raise RecordingError(f"{path}: array {name} holds values of type {dtype}, not numbers; convert it first")
    stated = math.prod(shape) * dtype.itemsize if min(shape, default=0) >= 0 else -1
    found = archive.getinfo(f"{name}.npy").file_size - begin
    if stated != found:
        which = "more" if stated < found else "fewer"
        raise RecordingError(
            f"{path}: is damaged: array {name} has {which} bytes than its header says ({shape} of {dtype}); "
            "write it again with numpy.savez"
        )
    is_turned = is_fortran and len(shape) > 1
    if is_turned and stated > _MOST_TURNED:
        raise RecordingError(
            f"{path}: array {name} is stored column by column and has {stated / 2**30:.1f} GiB; write it again with "
            "numpy.ascontiguousarray"
        )
    return Header(shape, dtype, is_turned)


def _rows(header: Header, stream: IO[bytes], most: int) -> Iterator[FloatArray]:
    """Yield the rows of an array in blocks of at most ``most`` rows, from the stream behind the header.

    An array that is stored column by column is read whole.
    """
    rows, *width = header.shape
    itemsize = header.dtype.itemsize
    if header.is_turned:
        whole = np.frombuffer(_exactly(stream, math.prod(header.shape) * itemsize), header.dtype)
        array = whole.reshape(header.shape, order="F")
        for start in range(0, rows, most):
            yield array[start : start + most].astype(float)
        return
    for start in range(0, rows, most):
        count = min(most, rows - start)
        data = _exactly(stream, count * math.prod(width) * itemsize)
        yield np.frombuffer(data, header.dtype).reshape(count, *width).astype(float)


def _check_sums(path: Path, names: Sequence[str]) -> None:
    """Read arrays to their ends, piece by piece, so that the archive compares their checksums."""
    with zipfile.ZipFile(path) as archive:
        for name in names:
            with archive.open(f"{name}.npy") as stream:
                while stream.read(_PIECE):
                    pass


def _exactly(stream: IO[bytes], size: int) -> bytes:
    """Read ``size`` bytes, of an archive that states more than it holds no more than it holds."""
    data = stream.read(size)
    if len(data) != size:
        raise EOFError(f"{len(data)} bytes where the archive says {size}")
    return data


def _chosen(path: Path, request: RecordingRequest, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return the names of the arrays with time, q and wrench: one two-dimensional array, or one array per column."""
    q, wrench = request.names_found(path, names)
    q = q or (("q",) if "q" in names else tuple(f"q_{i}" for i in range(request.dof)))
    wrench = wrench or (("wrench",) if "wrench" in names else tuple(f"wrench_{i}" for i in range(request.readings)))
    default_time = "time" if "time" in names else ""
    time_name = default_time if request.time is None else request.time
    time = (time_name,) if time_name else ()
    for option, chosen, width in ((request.flags[0], q, request.dof), (request.flags[1], wrench, request.readings)):
        if len(chosen) not in (1, width):
            raise RecordingError(f"{option}: name one array (N, {width}), or {width} arrays (N,)")
    absent = [name for name in (*time, *q, *wrench) if name not in names]
    if absent:
        raise RecordingError(f"{path}: has no array {listed(absent)}; it has {listed(names, 40)}. {request.remedy}")
    return time, q, wrench


def _check_shapes(path: Path, shapes: Mapping[str, tuple[int, ...]], width: int, what: str) -> None:
    """Refuse arrays that are neither (N, width), where there is one of them, nor (N,) each; time is (N,)."""
    has_columns = len(shapes) == 1 and what != "time"
    behind_rows = (width,) if has_columns else ()
    wanted = f"(N, {width})" if has_columns else "(N,)"
    for name, shape in shapes.items():
        if shape[1:] == behind_rows and len(shape) >= 1:
            continue
        turned = "; transpose it" if len(shape) == 2 and shape[0] == width else ""
        raise RecordingError(f"{path}: array {name} is of shape {shape}, but {what} is {wanted}{turned}")


def _column_names(names: tuple[str, ...], width: int) -> tuple[str, ...]:
    return names if len(names) == width else tuple(f"{names[0]}[{i}]" for i in range(width))
