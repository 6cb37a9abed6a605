# SPDX-License-Identifier: MIT
"""Damage recordings and check that a reader returns rows of the file or a clear message.

``tests/campaigns/fuzz_recordings.py`` reads many of them, a test some.
"""

from __future__ import annotations

import io
import re
import struct
import tempfile
import zipfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pyarrow as pa

from stiffgen.core.errors import RecordingError
from stiffgen.lab.analyze.recording import Block, RecordingRequest, open_recording, read_blocks
from support import recordings

JOINTS = tuple(f"A{i}" for i in range(1, 8))
ROWS = recordings.draw(12)
EXTREMES = (0, 1, 2, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)


def originals(folder: Path) -> list[Path]:
    """Write sound recordings of a dozen rows in every format."""
    flat = dict(zip(recordings.NAMES, ROWS.T, strict=True))
    np.savez(folder / "flat.npz", **flat)
    quoted = folder / "quoted.csv"
    quoted.write_text("\n".join(",".join(f'"{cell}"' for cell in row) for row in (recordings.NAMES, *ROWS.tolist())))
    return [
        recordings.write_csv(folder / "plain.csv", ROWS),
        quoted,
        recordings.write_npz(folder / "stored.npz", ROWS),
        recordings.write_npz(folder / "packed.npz", ROWS, compressed=True),
        recordings.write_npz(folder / "fortran.npz", ROWS, fortran=True),
        folder / "flat.npz",
        recordings.write_parquet(folder / "plain.parquet", ROWS, compression="none"),
        recordings.write_parquet(folder / "groups.parquet", ROWS, row_group_size=5),
        recordings.write_mcap(folder / "packed.mcap", ROWS, JOINTS),
        recordings.write_mcap(folder / "plain.mcap", ROWS, JOINTS, compressed=False),
    ]


def damage(content: bytes, random: np.random.Generator) -> bytes:
    """Return the content with one to four faults, mostly one: bits, bytes, numbers, cuts, copies, insertions."""
    data = bytearray(content)
    for _ in range(int(random.choice([1, 1, 1, 2, 4]))):
        size = max(len(data), 1)
        # headers stand at the beginning or the end of a file: half of the faults fall there
        at = int(
            random.choice([random.integers(size), random.integers(min(size, 200)), -random.integers(min(size, 900))])
        )
        at %= size
        length = int(random.integers(1, 40))
        kind = int(random.integers(8))
        if kind == 0 and data:
            data[at] ^= 1 << int(random.integers(8))
        elif kind == 1 and data:
            data[at] = int(random.integers(256))
        elif kind == 2:
            number = struct.pack("<Q", int(random.choice(np.array(EXTREMES, dtype=object))))
            width = int(random.choice([1, 2, 4, 8]))
            data[at : at + width] = number[:width]
        elif kind == 3:
            del data[at:]
        elif kind == 4:
            del data[at : at + length]
        elif kind == 5:
            data[at:at] = random.bytes(length)
        elif kind == 6:
            data[at : at + length] = bytes(length)
        else:
            other = int(random.integers(size))
            data[at : at + length] = data[other : other + length]
    return bytes(data)


def check(path: Path) -> str:
    """Read a recording; return "rows" or "refused".

    Raises:
        AssertionError: a value is not the file's, or a message is no clear sentence.

    """
    request, said = RecordingRequest(joints=JOINTS), io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            recording = open_recording(path, request)
            blocks = [block for part in recording.partitions for block in read_blocks(part, 5)]
    except RecordingError as error:
        assert str(path) in str(error) and len(str(error)) < 3000, str(error)
        assert all(c.isprintable() or c == "\n" for c in str(error)), str(error)
        assert not said.getvalue(), said.getvalue()
        return "refused"
    assert not said.getvalue(), said.getvalue()
    oracle = {".npz": _npz, ".parquet": _parquet, ".csv": _csv, ".mcap": _mcap}[path.suffix]
    oracle(path, recording.columns.names, blocks)
    return "rows"


def _values(blocks: list[Block], width: int) -> np.ndarray:
    return np.concatenate([np.empty((0, width)), *(block.values for block in blocks)])


def _npz(path: Path, names: tuple[str, ...], blocks: list[Block]) -> None:
    """Compare with NumPy's reader of arrays; it does not need the archive's first bytes."""
    parts = []
    with zipfile.ZipFile(path) as archive:
        for name in dict.fromkeys(name.partition("[")[0] for name in names):
            with archive.open(f"{name}.npy") as stream:
                parts.append(np.lib.format.read_array(stream))
    np.testing.assert_array_equal(_values(blocks, len(names)), np.column_stack(parts).astype(float))


def _parquet(path: Path, names: tuple[str, ...], blocks: list[Block]) -> None:
    """Compare with pyarrow's reader of whole tables."""
    table = pa.parquet.read_table(path, columns=list(names))
    values = _values(blocks, len(names))
    assert len(values) == table.num_rows
    whole = np.stack([table.column(n).cast(pa.float64(), safe=False).to_numpy() for n in names], axis=1)
    np.testing.assert_array_equal(values[:, 1:], whole[:, 1:])  # a time stamp may have become seconds


def _csv(path: Path, names: tuple[str, ...], blocks: list[Block]) -> None:
    """Find every finite number in the cells of its line."""
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    lines = text.split("\n")
    first = next(k for k, line in enumerate(lines) if line.strip().removeprefix("#").strip()) + 1
    for block in blocks:
        for row, values in zip(block.rows, block.values, strict=True):
            numbers = {_float(cell.replace('"', "")) for cell in re.split("[,;\t]", lines[first + row])}
            assert all(value in numbers for value in values[np.isfinite(values)]), (row, values)


def _float(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _mcap(path: Path, names: tuple[str, ...], blocks: list[Block]) -> None:
    """Find every finite number among the original ones, or as eight bytes in the file."""
    content, known = path.read_bytes(), {*ROWS.ravel().tolist(), 0.5, 1.0}
    for value in _values(blocks, len(names))[:, 1:].ravel().tolist():
        assert not np.isfinite(value) or value in known or struct.pack("<d", value) in content, value


def run(first: int, count: int) -> dict[str, int]:
    """Damage and read ``count`` files; count the outcomes by format."""
    outcomes: dict[str, int] = {}
    with tempfile.TemporaryDirectory(prefix="damaged-") as name:
        folder = Path(name)
        files = [(file.suffix, file.read_bytes()) for file in originals(folder)]
        for number in range(first, first + count):
            suffix, content = files[number % len(files)]
            path = folder / f"damaged{suffix}"
            path.write_bytes(damage(content, np.random.default_rng(number)))
            try:
                outcome = f"{suffix} {check(path)}"
            except Exception as error:
                raise AssertionError(f"file {number} ({suffix}): {type(error).__name__}: {error}") from error
            outcomes[outcome] = outcomes.get(outcome, 0) + 1
    return outcomes
