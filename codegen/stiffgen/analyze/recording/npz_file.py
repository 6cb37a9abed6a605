# SPDX-License-Identifier: MIT
"""NPZ files: arrays are read from the zip archive as a stream, compressed or not."""

from __future__ import annotations

import math
import struct
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, cast

import numpy as np

from stiffgen.analyze.recording import NAME_OTHERS, PARTITION_ROWS, Block, Columns, Recording, RecordingRequest
from stiffgen.errors import RecordingError, listed
from stiffgen.robot.geometry import FloatArray

_LOCAL_HEADER = 30
_BYTES_AT_ONCE = 1 << 22


@dataclass(frozen=True)
class _StoredArray:
    """Array of the archive. ``data`` is the offset of its first number: in the member, or (if stored) in the file."""

    name: str
    shape: tuple[int, ...]
    fortran: bool
    dtype: str
    data: int
    stored: bool

    @property
    def columns(self) -> int:
        return self.shape[1] if len(self.shape) == 2 else 1

    @property
    def streams(self) -> int:
        """Return the number of streams that read at once: one per column if columns are contiguous, else one."""
        return self.columns if self.fortran else 1

    def offset(self, stream: int, row: int) -> int:
        size = np.dtype(self.dtype).itemsize
        return self.data + size * (stream * self.shape[0] + row if self.fortran else row * self.columns)


@dataclass(frozen=True)
class NpzPartition:
    """Rows ``start`` to ``stop`` of some arrays side by side."""

    path: Path
    members: tuple[_StoredArray, ...]
    start: int
    stop: int

    @property
    def work(self) -> float:
        """Return the number of rows."""
        return float(self.stop - self.start)

    def blocks(self, most: int) -> Iterator[Block]:
        """Read the rows in blocks of at most ``most`` rows."""
        with ExitStack() as stack:
            opened = [(member, self._streams(member, stack)) for member in self.members]
            for row in range(self.start, self.stop, most):
                count = min(most, self.stop - row)
                values = np.concatenate([_rows(m, streams, count) for m, streams in opened], axis=1)
                yield Block(np.arange(row, row + count), values, work=count)

    def _streams(self, member: _StoredArray, stack: ExitStack) -> list[IO[bytes]]:
        streams: list[IO[bytes]] = []
        for index in range(member.streams):
            if member.stored:
                stream: IO[bytes] = stack.enter_context(self.path.open("rb"))
            else:
                archive = stack.enter_context(zipfile.ZipFile(self.path))
                stream = stack.enter_context(archive.open(f"{member.name}.npy"))
            _skip(stream, member.offset(index, self.start), member.stored)
            streams.append(stream)
        return streams


def _skip(stream: IO[bytes], offset: int, seekable: bool) -> None:
    if seekable:
        stream.seek(offset)
        return
    while offset:
        offset -= len(_exactly(stream, min(offset, _BYTES_AT_ONCE)))


def _exactly(stream: IO[bytes], size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise EOFError("the file ends within an array")
    return data


def _rows(member: _StoredArray, streams: Sequence[IO[bytes]], count: int) -> FloatArray:
    dtype = np.dtype(member.dtype)
    width = member.columns // len(streams)
    parts = [
        np.frombuffer(_exactly(stream, count * width * dtype.itemsize), dtype).reshape(count, width)
        for stream in streams
    ]
    return np.concatenate(parts, axis=1).astype(float)


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the arrays: ``q`` (N, n), ``wrench`` (N, 6) and ``time`` (N,), or one array (N,) per column."""
    progress(f"checking the arrays of {path.name}")
    with zipfile.ZipFile(path) as archive, path.open("rb") as file:
        names = [info.filename[:-4] for info in archive.infolist() if info.filename.endswith(".npy")]
        time, q, wrench = _chosen(path, request, names)
        members = {name: _member(archive, file, name, path) for name in (*time, *q, *wrench)}
    for group, width, what in ((time, 1, "time"), (q, request.dof, "q"), (wrench, 6, "wrench")):
        _check_shapes(path, [members[name] for name in group], width, what)
    lengths = {name: member.shape[0] for name, member in members.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordingError(f"{path}: the arrays differ in length ({shown}); write arrays with one entry per row")
    columns = Columns(time[0] if time else None, _column_names(q, request.dof), _column_names(wrench, 6))
    rows = next(iter(lengths.values()))
    # A compressed array can be read only from its beginning.
    step = PARTITION_ROWS if all(member.stored for member in members.values()) else max(rows, 1)
    ordered = tuple(members[name] for name in (*time, *q, *wrench))
    partitions = (NpzPartition(path, ordered, start, min(start + step, rows)) for start in range(0, rows, step))
    return Recording(path, columns, tuple(partitions))


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


def _member(archive: zipfile.ZipFile, file: BinaryIO, name: str, path: Path) -> _StoredArray:
    info = archive.getinfo(f"{name}.npy")
    if info.flag_bits & 1:
        raise RecordingError(f"{path}: is encrypted; write it without a password")
    stored = info.compress_type == zipfile.ZIP_STORED
    with archive.open(info) as stream:
        shape, fortran, dtype = _header(cast(BinaryIO, stream))
        data = stream.tell()
        if dtype.kind not in "fiu":
            raise RecordingError(f"{path}: array {name} holds values of type {dtype}, not numbers; convert it first")
        if info.file_size - data != math.prod(shape) * dtype.itemsize or min(shape, default=0) < 0:
            raise RecordingError(
                f"{path}: array {name} has {info.file_size - data} bytes, but its header says shape {shape} of "
                f"{dtype}; the array is cut short or damaged: write it again with numpy.savez"
            )
        while stored and stream.read(1 << 16):  # zipfile compares the checksum at the end of the member
            pass
    if stored:
        file.seek(info.header_offset)
        lengths = struct.unpack_from("<HH", _exactly(file, _LOCAL_HEADER), 26)  # of the name and the extra field
        data += info.header_offset + _LOCAL_HEADER + sum(lengths)
    return _StoredArray(name, shape, fortran and len(shape) == 2, dtype.str, data, stored)


def _header(stream: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Read the header of an array: shape, whether columns are contiguous, and type."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    if version not in ((2, 0), (3, 0)):  # 3.0 differs in the names of fields, which numbers do not have
        raise ValueError(f"version {version[0]}.{version[1]} of the NPY format is not known")
    return np.lib.format.read_array_header_2_0(stream)


def _check_shapes(path: Path, members: Sequence[_StoredArray], width: int, what: str) -> None:
    for member in members:
        shape = member.shape
        if shape[1:] == ((width,) if len(members) == 1 and what != "time" else ()) and len(shape) >= 1:
            continue
        wanted = "(N,)" if what == "time" or len(members) > 1 else f"(N, {width})"
        turned = "; transpose it" if len(shape) == 2 and shape[0] == width else ""
        raise RecordingError(f"{path}: array {member.name} is of shape {shape}, but {what} is {wanted}{turned}")


def _column_names(names: tuple[str, ...], width: int) -> tuple[str, ...]:
    return names if len(names) == width else tuple(f"{names[0]}[{i}]" for i in range(width))
