# SPDX-License-Identifier: MIT
"""stiffgen analyze: recordings and options that are refused, each with a message that names the fault."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

import stiffgen
from stiffgen.core.errors import StiffgenError
from support import recordings
from support.analysis import JOINTS, ROWS, K, command, run


def asymmetric(here):
    matrix = np.diag(np.array(K, dtype=float))
    matrix[0, 4] = 12.0
    np.savetxt(here / "K.csv", matrix, delimiter=",")
    return ["K.csv"]


TWICE = ["--topic", "/wrench", "--topic", "/left"]
REFUSALS = [
    (lambda here, log: (log, {"stiffness": [1, 2, 3]}), "six numbers or a 6x6 matrix"),
    (lambda here, log: (log, {"stiffness": ["x"]}), "--task-stiffness x"),
    (lambda here, log: (log, {"stiffness": [1, 2, 3, 4, 5, "x"]}), "six numbers"),
    (lambda here, log: (log, {"stiffness": [1, 2, 3, 4, 5, "nan"]}), "not a finite number"),
    (lambda here, log: (log, {"stiffness": asymmetric(here)}), "not symmetric: entry (0, 4) is 12"),
    (lambda here, log: (here / "absent.csv", {}), "is no file"),
    (lambda here, log: (here, {}), "not ''"),
    (lambda here, log: (log, {"options": ["--q", "a,b"]}), "2 names, but the robot has 7"),
    (lambda here, log: (log, {"options": ["--wrench", "q_"]}), "needs 6 columns, q_0 ... q_5 or q_fx"),
    (lambda here, log: (log, {"options": ["--q", "wrench_"]}), "needs 7 columns"),
    (lambda here, log: (log, {"options": ["--q", "joint"]}), "the file has time, q_0"),
    (lambda here, log: (log, {"options": ["--q", "time"]}), "1 names, but the robot has 7"),
    (lambda here, log: (log, {"options": ["--wrench", "a,b"]}), "2 names, but a wrench has 6"),
    (lambda here, log: (log, {"options": ["--time-column", "clock"]}), "no column clock; it has time, q_0"),
    (lambda here, log: (log, {"options": ["--q", "a,b,c,d,e,f,q_0"]}), "no column a, b, c, d, e, f;"),
    (lambda here, log: (log, {"options": ["--tip", "hand"]}), "--tip hand"),
    (lambda here, log: (log, {"options": ["--tolerance", "-1"]}), "--tolerance"),
    (lambda here, log: (log, {"options": ["--output", "taken"]}), "taken: exists and is not an analysis"),
    (lambda here, log: (log, {"robot": "taken"}), "stiffgen generate"),
    (lambda here, log: (write(here / "n.csv", b"1,2,3\n4,5,6\n"), {}), "numbers where the columns' names"),
    (lambda here, log: (write(here / "e.csv", b""), {}), "is empty"),
    (lambda here, log: (write(here / "b.csv", b"\xff" * 3_000_000), {}), "has a line of over"),
    (lambda here, log: (write(here / "x.npz", b"PK nonsense"), {}), "is no NPZ file (BadZipFile"),
    (lambda here, log: (write(here / "x.parquet", b"PAR1 nonsense"), {}), "is no Parquet file (ArrowInvalid"),
    (lambda here, log: (write(here / "x.mcap", b"nonsense"), {}), "is no MCAP file (InvalidMagic"),
    (lambda here, log: (saved(here, q=ROWS[:, 1:8]), {}), "no array wrench_0"),
    (lambda here, log: (saved(here, q=ROWS[:, 1:8].T, wrench=ROWS[:, 8:]), {}), "transpose it"),
    (lambda here, log: (saved(here, q=ROWS[:9, 1:8], wrench=ROWS[:, 8:]), {}), "differ in length (q 9, wrench 300)"),
    (lambda here, log: (saved(here, q=ROWS[:, 1:8].astype(str), wrench=ROWS[:, 8:]), {}), "not numbers"),
    (lambda here, log: (saved(here, q=np.array([None] * 7), wrench=ROWS[:, 8:]), {}), "not numbers"),
    (lambda here, log: (text_parquet(here), {}), "column q_0 holds values of type string"),
    (
        lambda here, log: (recordings.write_mcap(here / "j.mcap", ROWS[:5], tuple("abcdefg")), {}),
        "the messages have finger, g",
    ),
    (lambda here, log: (two_wrenches(here), {}), "choose one with --topic: /left, /wrench"),
    (lambda here, log: (two_wrenches(here), {"options": ["--topic", "/nothing"]}), "is no topic of type sensor_msgs"),
    (lambda here, log: (two_wrenches(here), {"options": TWICE}), "choose one with --topic: /left, /wrench"),
    (lambda here, log: (cut_off(here), {}), "'mcap recover'"),
]


def write(path, content):
    path.write_bytes(content)
    return path


def saved(here, **arrays):
    np.savez(here / "s.npz", **arrays)
    return here / "s.npz"


def text_parquet(here):
    columns = dict(zip(recordings.NAMES, ROWS.T, strict=True)) | {"q_0": ["a"] * len(ROWS)}
    pa.parquet.write_table(pa.table(columns), here / "t.parquet")
    return here / "t.parquet"


def two_wrenches(here):
    return recordings.write_mcap(here / "two.mcap", ROWS[:5], JOINTS, extra_topics=("/left",))


def cut_off(here):
    whole = recordings.write_mcap(here / "whole.mcap", ROWS, JOINTS).read_bytes()
    return write(here / "cut.mcap", whole[: len(whole) // 2])


@pytest.mark.parametrize(("case", "named"), REFUSALS, ids=[named for _, named in REFUSALS])
def test_refusals(case, named, here, robot_folder, capsys):
    """Give recordings and options that cannot be analysed: exit code 2, the reason, and no file."""
    (here / "taken").mkdir()
    log, rest = case(here, recordings.write_csv(here / "log.csv", ROWS[:20]))
    before = sorted(here.iterdir())
    options = rest.pop("options", ())
    code, out, err = run(capsys, *command(rest.pop("robot", robot_folder), log, *options, **rest))
    assert (code, out) == (2, "")
    assert named in err
    assert "Traceback" not in err
    assert sorted(here.iterdir()) == before


IN_PYTHON = [  # keywords, and the words of the refusal
    ({"task_stiffness": [1, 2]}, r"^task_stiffness=\.\.\.: six numbers or a 6x6 matrix"),
    ({"task_stiffness": np.diag([1, 2, 3, 4, 5, np.nan])}, r"^task_stiffness=\.\.\.: has an entry"),
    ({"representation": "world"}, r"^representation='world': choose one of"),
    ({"export": "xlsx"}, r"^export='xlsx': choose one of"),
    ({"tip": "left hand"}, r"^tip='left hand': is no tip"),
    ({"tolerance": -1}, r"^tolerance=\.\.\.: must be a time"),
    ({"q": ["a", "b"]}, r"^q=\.\.\.: 2 names, but"),
    ({"q": "joint:"}, r"log.csv: q='joint:': needs 7 columns"),
    ({"wrench": "q_"}, r"log.csv: wrench='q_': needs 6 columns"),
    ({"time_column": "clock"}, r"Name others with q=\.\.\., wrench=\.\.\. .* and time_column="),
    ({"topics": ["/a"]}, r"leave out the options of MCAP files: topics=\.\.\., tolerance=\.\.\.$"),
    ({"log": "two.mcap"}, r"choose one with topics=\.\.\.: /left, /wrench"),
    ({"log": "two.mcap", "topics": ["/no"]}, r"two.mcap: topics=\['/no'\]: is no topic of type"),
    ({"log": "two.mcap", "wrench": "f"}, r"^wrench=\.\.\. and time_column=\.\.\. do not .* with topics=\.\.\.$"),
    ({"calibration": "a.json"}, r"^calibration='a.json': the robot has no sensor .* with sensor=\.\.\.$"),
    ({"calibration": "a.json", "negate_wrench": True}, r"^calibration=.*leave out negate_wrench=True and rep"),
    ({"output": "taken"}, r"taken: exists .* choose another output=\.\.\.$"),
    ({"robot": "taken"}, r"stiffgen\.generate\(\)"),
    ({"robot": "two.urdf"}, r"one with tip=.* options: stiffgen\.generate\(\), then give its folder here$"),
    ({"dask": "nowhere:1"}, r"^dask='nowhere:1': no scheduler answers"),
]


@pytest.mark.parametrize(("options", "words"), IN_PYTHON, ids=[words for _, words in IN_PYTHON])
def test_python_is_refused_in_python(options, words, here, robot_folder, monkeypatch):
    """Keywords in place of options, functions in place of commands; the command line has its own words above."""
    monkeypatch.setattr("distributed.Client", unreachable)
    (here / "taken").mkdir()
    two_wrenches(here)
    leaf = '<joint name="{0}" type="continuous"><parent link="b"/><child link="{0}"/></joint><link name="{0}"/>'
    (here / "two.urdf").write_text(f'<robot name="r"><link name="b"/>{leaf.format("x")}{leaf.format("y")}</robot>')
    recordings.write_csv(here / "log.csv", ROWS[:20])
    with pytest.raises(StiffgenError, match=words) as refusal:
        stiffgen.analyze(**{"log": "log.csv", "robot": robot_folder, "task_stiffness": K, "figures": False} | options)
    assert "--" not in str(refusal.value) and "'stiffgen generate'" not in str(refusal.value)


def unreachable(address, **_):
    raise TimeoutError


@pytest.mark.parametrize("name", ["d.npz", "d.parquet"])
def test_damage_in_the_middle_leaves_nothing(name, here, robot_folder, capsys):
    """Zero 5000 bytes in the middle of a recording: exit code 2, and no folder is left."""
    recordings.write_npz(here / "d.npz", recordings.draw(20_000), compressed=True)
    recordings.write_parquet(here / "d.parquet", recordings.draw(20_000), compression="gzip")
    content = bytearray((here / name).read_bytes())
    middle = len(content) // 2
    content[middle : middle + 5000] = bytes(5000)
    write(here / name, content)
    before = sorted(here.iterdir())
    code, out, err = run(capsys, *command(robot_folder, here / name))
    assert (code, out) == (2, "")
    assert "is damaged" in err
    assert sorted(here.iterdir()) == before
