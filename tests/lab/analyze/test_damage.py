# SPDX-License-Identifier: MIT
"""stiffgen analyze on damaged recordings: a sentence or the file's own rows, never a traceback or foreign bytes."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from stiffgen.cli import main
from stiffgen.core.errors import RecordingError
from stiffgen.lab.analyze.recording import RecordingRequest, csv_file, open_recording
from support import damaged_recordings, recordings


@pytest.mark.slow
def test_damaged_files_of_every_format():
    """A fixed seed of the campaign ``tests/campaigns/fuzz_recordings.py``."""
    outcomes = damaged_recordings.run(0, 2000)
    assert sum(outcomes.values()) == 2000
    for suffix in (".csv", ".npz", ".parquet", ".mcap"):
        assert outcomes[f"{suffix} rows"] > 5 and outcomes[f"{suffix} refused"] > 50, outcomes


def archive(path, compression, **counts):
    """Write arrays whose headers promise ``counts`` rows; the arrays have 10 rows, and all checksums are right."""
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, width in (("time", ()), ("q", (7,)), ("wrench", (6,))):
            stream = io.BytesIO()
            header = {"descr": "<f8", "fortran_order": False, "shape": (counts.get(name, 10), *width)}
            np.lib.format.write_array_header_1_0(stream, header)
            file.writestr(f"{name}.npy", stream.getvalue() + np.zeros((10, *width)).tobytes())
    return path


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_an_array_whose_length_is_not_what_its_header_says(tmp_path, compression):
    """Lie in an array's header: refused, whether longer or shorter."""
    request = RecordingRequest(joints=damaged_recordings.JOINTS)
    assert open_recording(archive(tmp_path / "good.npz", compression), request).partitions[0].rows == 10
    for rows, found in ((24, "is damaged"), (9, "array time has more bytes than its header says"), (-1, "is damaged")):
        log = archive(tmp_path / "short.npz", compression, time=rows, q=rows, wrench=rows)
        with pytest.raises(RecordingError, match=found):
            open_recording(log, request)


def test_a_stored_array_whose_checksum_is_wrong(tmp_path):
    """Flip one bit of a stored array: refused by its checksum."""
    log = recordings.write_npz(tmp_path / "log.npz", damaged_recordings.ROWS)
    content = bytearray(log.read_bytes())
    place = content.find(damaged_recordings.ROWS[5, 1:8].tobytes())
    content[place + 3] ^= 16
    log.write_bytes(content)
    with pytest.raises(RecordingError, match="Bad CRC-32"):
        open_recording(log, RecordingRequest(joints=damaged_recordings.JOINTS))


@pytest.mark.slow
def test_no_control_character_reaches_the_terminal(tmp_path, monkeypatch, robot_folder, capfd):
    """Neither from the name of a file nor from its content, be it good or damaged; nor is a name refused."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    for number, name in enumerate(("a\x1b[31m\rb", "c\nd", b"e\xff".decode("utf-8", "surrogateescape"))):
        good = recordings.write_csv(tmp_path / f"{name}.csv", damaged_recordings.ROWS)
        cut = tmp_path / "other" / f"{name}.mcap"
        content = recordings.write_mcap(cut, damaged_recordings.ROWS, damaged_recordings.JOINTS, compressed=False)
        cut.write_bytes(content.read_bytes().replace(b"float64 x", b"float64 \x1b"))
        options = ["--robot", str(robot_folder), "--task-stiffness", *"123456"]
        assert main(["analyze", str(good), *options]) == 0
        assert main(["analyze", str(cut), *options]) == 2
        out, err = capfd.readouterr()
        assert {c for c in out + err if not c.isprintable()} == {"\n"}, number
        assert "Traceback" not in err and "is damaged" in err


@pytest.mark.parametrize("cell", ["\x1d1.5", "1.5\x1f", "\u00a01.5", "\u0661", "0x1", "1_5", "1.5.", "1e", "--1"])
def test_a_cell_that_is_no_number(cell):
    """Python's float() takes the first four and 1_5: a sign that became a control character would vanish."""
    assert csv_file._number(cell) is None


@pytest.mark.parametrize("cell", ["1", "-1.5", "+.5e-3", "1.E+5", "NaN", "-inf", "Infinity", repr(1e-300)])
def test_a_cell_that_is_a_number(cell):
    np.testing.assert_equal(csv_file._number(cell), float(cell))
