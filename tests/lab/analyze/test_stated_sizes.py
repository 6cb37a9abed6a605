# SPDX-License-Identifier: MIT
"""Sizes that a header states are looked at before memory is taken: recordings, MJCF files."""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stiffgen.core.errors import DescriptionError, RecordingError
from stiffgen.core.loading import describe
from stiffgen.lab.analyze.recording import RecordingRequest, open_recording, read_blocks
from stiffgen.lab.analyze.recording.mcap_file import _check_chunks

JOINTS = tuple(f"j{k}" for k in range(7))
READER = """
import resource, sys
from stiffgen.core.errors import RecordingError
from stiffgen.lab.analyze.recording import RecordingRequest, open_recording, read_blocks
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    recording = open_recording(sys.argv[1], RecordingRequest(joints=tuple(f"j{k}" for k in range(7))))
    rows = sum(len(block.rows) for each in recording.partitions for block in read_blocks(each, 1 << 14))
    print(rows)
except RecordingError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10)
"""


def packed(file: Path, rows: int, kind: str = "<f8", shape: tuple[int, ...] = ()) -> Path:
    """Write an archive of zeros: q (rows, 7), wrench (rows, 6); ``shape`` is what the header of q states."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, width in (("q", 7), ("wrench", 6)):
            stream = io.BytesIO()
            stated = shape if shape and name == "q" else (rows, width)
            header = {"descr": kind if name == "q" else "<f8", "fortran_order": False, "shape": stated}
            np.lib.format.write_array_header_1_0(stream, header)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as target:
                target.write(stream.getvalue())
                for start in range(0, rows, 1 << 16):
                    target.write(bytes(8 * width * min(1 << 16, rows - start)))
    return file


def read(file: Path) -> tuple[str, int]:
    """Return what a process of its own says about a recording, and the memory that it took [MiB]."""
    done = subprocess.run([sys.executable, "-c", READER, str(file)], capture_output=True, text=True, check=True)
    said, taken = done.stdout.splitlines()
    return said, int(taken)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "shape", "words"),
    [
        ("<f8", (), "2000000"),
        ("<c8", (), "values of type complex64, not numbers"),
        ("<f8", (14_000_000,), "shape (14000000,), but q is (N, 7)"),
        ("<f8", (10**12, 7), "array q has fewer bytes than its header says"),
        ("<f8", (1, 7), "array q has more bytes than its header says"),
    ],
)
def test_an_archive_takes_no_memory_by_its_size(kind: str, shape: tuple[int, ...], words: str, tmp_path: Path) -> None:
    """0.2 MB of archive hold 208 MB; before, opening them took as much, whatever the header said."""
    log = packed(tmp_path / "log.npz", 2_000_000, kind, shape)
    assert log.stat().st_size < 1 << 20
    said, taken = read(log)
    assert words in said
    assert taken < 60


@pytest.mark.slow
def test_a_long_header_is_not_read(tmp_path: Path) -> None:
    """State a header of 200 MB: refused, and at most 60 MB of memory taken."""
    with zipfile.ZipFile(tmp_path / "log.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("q", "wrench"):
            with archive.open(f"{name}.npy", "w") as target:
                target.write(b"\x93NUMPY\x02\x00" + (200_000_000).to_bytes(4, "little"))
                for _ in range(200):
                    target.write(bytes(1_000_000))
    said, taken = read(tmp_path / "log.npz")
    assert "array q has a header of 200000000 bytes" in said
    assert taken < 60


def test_an_array_by_columns_is_read_whole_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read an array stored by columns: turned if small, else refused with what to do."""
    q, wrench = np.arange(70.0).reshape(10, 7), np.arange(60.0).reshape(10, 6)
    np.savez(tmp_path / "log.npz", q=np.asfortranarray(q), wrench=wrench)
    recording = open_recording(tmp_path / "log.npz", RecordingRequest(joints=JOINTS))
    (values,) = [block.values for block in read_blocks(recording.partitions[0], 100)]
    np.testing.assert_array_equal(values, np.column_stack([q, wrench]))
    monkeypatch.setattr("stiffgen.lab.analyze.recording.npz_file._MOST_TURNED", 100)
    with pytest.raises(RecordingError, match=r"column by column .* numpy\.ascontiguousarray"):
        open_recording(tmp_path / "log.npz", RecordingRequest(joints=JOINTS))


def test_a_large_chunk_of_mcap_is_refused_by_its_index() -> None:
    _check_chunks(Path("log.mcap"), [SimpleNamespace(uncompressed_size=1 << 22)])
    with pytest.raises(RecordingError, match=r"has a chunk of 4\.0 GiB"):
        _check_chunks(Path("log.mcap"), [SimpleNamespace(uncompressed_size=size) for size in (1 << 22, 1 << 32)])


MODEL = (
    "<mujoco>{0}<worldbody><body name='a'><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/><joint name='j'/></body>"
    "</worldbody>{1}</mujoco>"
)
SIZES = {
    "a height field": ("<asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/></asset>", "cells"),
    "one side": ("<asset><hfield name='h' nrow='2' ncol='1e9' size='1 1 1 1'/></asset>", "cells"),
    "a texture": ("<asset><texture name='t' builtin='flat' width='100000' height='100000'/></asset>", "cells"),
    "user data": ("<size nuserdata='300000000'/>", "nuserdata.*above 10000; lower it"),
    "user data of bodies": ("<size nuser_body='300000000'/>", "nuser_body.*above 10000; lower it"),
    "a mesh": ("<asset><mesh name='m' builtin='supertorus' params='90000 0.3 1 1'/></asset>", "params.*above"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES)
def test_a_model_that_states_a_size_is_refused_before_it_is_parsed(name: str, tmp_path: Path) -> None:
    """State a huge size in a model: refused within 400 MB of memory."""
    pytest.importorskip("mujoco")
    text, words = SIZES[name]
    (tmp_path / "arm.xml").write_text(MODEL.format(text, ""))
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    with pytest.raises(DescriptionError, match=words):
        describe(tmp_path / "arm.xml")
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss <= max(before, 400 << 10)


def test_a_size_in_an_included_file_counts(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(MODEL.format("<include file='part.xml'/>", ""))
    (tmp_path / "part.xml").write_text(f"<mujocoinclude>{SIZES['a height field'][0]}</mujocoinclude>")
    with pytest.raises(DescriptionError, match="cells, and stiffgen uses none; remove the <hfield>"):
        describe(tmp_path / "arm.xml")


def test_usual_sizes_are_read(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    usual = (
        "<size nuserdata='100' nuser_body='3' nkey='4'/><asset><hfield name='h' nrow='200' ncol='300' size='1 1 1 1'/>"
    )
    (tmp_path / "arm.xml").write_text(MODEL.format(f"{usual}</asset>", ""))
    assert "a" in describe(tmp_path / "arm.xml").links
