# SPDX-License-Identifier: MIT
"""stiffgen analyze: recordings of every format, bad rows, cuts, Dask."""

from __future__ import annotations

import json

import distributed
import numpy as np
import pyarrow as pa
import pytest

import stiffgen
from stiffgen.lab.analyze import analysis
from stiffgen.lab.analyze.options import AnalysisOptions
from stiffgen.lab.analyze.recording import csv_file, parquet_file
from stiffgen.lab.analyze.report import late_rows
from support import recordings
from support.analysis import BAD, JOINTS, ROWS, K, assert_same, bad_csv, command, measured, run
from support.chains import chain_urdf


def blanks(path):
    """NumPy's savetxt, with runs of blanks and tabs, Windows's line ends, and blanks at both ends of a line."""
    lines = recordings.write_csv(path, ROWS, delimiter=" ").read_text().splitlines()
    path.write_bytes(
        "".join(f"  {line.replace(' ', '  ', 3)}\t\r\n" for line in ["# " + lines[0], *lines[1:]]).encode()
    )
    return path


def write_all(folder):
    """Write the same rows in all formats and dialects, and return the files."""
    lines = recordings.write_csv(folder / "plain.csv", ROWS).read_text()
    commented = "# " + lines.replace(",", " ; ").replace("\n", "\r\n")
    (folder / "excel.csv").write_bytes(b"\xef\xbb\xbf" + commented.encode())
    flat = dict(zip(recordings.NAMES, ROWS.T, strict=True))
    np.savez(folder / "flat.npz", **flat)
    np.savez(folder / "wide.npz", time=ROWS[:, 0].astype(">f8"), q=ROWS[:, 1:8], wrench=ROWS[:, 8:], note="text")
    return [
        folder / "plain.csv",
        folder / "excel.csv",
        recordings.write_csv(folder / "tabs.tsv", ROWS, delimiter="\t"),
        blanks(folder / "blanks.txt"),
        recordings.write_npz(folder / "stored.npz", ROWS),
        recordings.write_npz(folder / "compressed.npz", ROWS, compressed=True),
        recordings.write_npz(folder / "fortran.npz", ROWS, fortran=True),
        recordings.write_npz(folder / "both.npz", ROWS, compressed=True, fortran=True),
        folder / "flat.npz",
        folder / "wide.npz",
        recordings.write_parquet(folder / "plain.parquet", ROWS),
        recordings.write_parquet(folder / "groups.parquet", ROWS, row_group_size=37),
    ]


def test_formats_agree_with_a_direct_computation(here, robot, robot_folder, monkeypatch):
    """Read 300 rows in all formats, in several partitions: each measure is NumPy's over all rows."""
    # Small partitions (rows; bytes) and pieces (bytes), so that 300 rows are cut several times.
    monkeypatch.setattr(parquet_file, "PARTITION_ROWS", 90)
    monkeypatch.setattr(csv_file, "_PARTITION", 20_000)
    monkeypatch.setattr(csv_file, "_PIECE", 3_000)
    expected = measured(robot, ROWS)
    for file in write_all(here):
        done = stiffgen.analyze(file, robot_folder, K, figures=False)
        assert done.folder == here.joinpath("analysis", file.stem).relative_to(here)
        whole = file.suffix == ".npz" or file.name == "plain.parquet"
        assert (len(done.recording.partitions) == 1) == whole, file.name
        summary = json.loads((done.folder / "summary.json").read_text())
        assert summary == done.summary
        assert (summary["rows"], summary["rows_analysed"], summary["rows_bad"]) == (300, 300, {}), file.name
        assert summary["rows_corrected_not_symmetric"] == 0
        first = 2 if done.recording.first_line else 0  # text files count lines, below a header; others rows from 0
        for name, values in expected.items():
            found = summary["measures"][name]
            assert found["least"] == values.min() and found["most"] == values.max(), (file.name, name)
            np.testing.assert_allclose(found["mean"], values.mean(), rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(found["rms"], np.sqrt((values**2).mean()), rtol=1e-12)
            assert int(found["most_at"].split()[1]) == values.argmax() + first
            if name == "moment":  # quantiles are middles of bins of 2.3 %
                np.testing.assert_allclose(found["median"], np.quantile(values, 0.5), rtol=0.03)
                np.testing.assert_allclose(found["quantile_95"], np.quantile(values, 0.95), rtol=0.03)
        negative = (expected["eigenvalue_smallest"] < 0) & (expected["eigenvalue_largest"] > 0)
        assert summary["rows_indefinite"] == negative.sum()
        assert summary["time"]["last"] == ROWS[-1, 0]
        positions = [[joint["least"], joint["most"]] for joint in summary["joint_positions"]]
        assert positions == np.stack([ROWS[:, 1:8].min(0), ROWS[:, 1:8].max(0)], 1).tolist()


UR = [f"actual_q_{k}" for k in range(7)], [f"actual_TCP_force_{k}" for k in range(6)]
BY_PREFIX = {
    "from 0": (*UR, "actual_q_", "actual_TCP_force_"),
    "from 1": ([f"q{k + 1}" for k in range(7)], [f"F[{k}]" for k in range(6)], "q", "F["),
    "names": ([f"position.{name}" for name in JOINTS], ["wfx", "wfy", "wfz", "wtx", "wty", "wtz"], "position.", "w"),
}  # fmt: skip


@pytest.mark.parametrize("case", BY_PREFIX)
def test_columns_by_prefix(case, here, robot_folder, capsys):
    """Columns in another order than their numbers, beside others that begin alike."""
    q, wrench, *prefixes = BY_PREFIX[case]
    names, order = ["time", *q, *wrench, "target_q_0", f"{prefixes[0]}_std"], np.random.default_rng(1).permutation(16)
    rows = np.hstack([ROWS, np.full((300, 2), 9.0)])[:, order]
    log = recordings.write_csv(here / "ur.csv", rows, [names[k] for k in order], delimiter=" ")
    np.savez(here / "ur.npz", **dict(zip([names[k] for k in order], rows.T, strict=True)))
    plain = stiffgen.analyze(recordings.write_npz(here / "plain.npz", ROWS), robot_folder, K, figures=False).summary
    for file in (log, here / "ur.npz"):
        options = ("--q", prefixes[0], "--wrench", prefixes[1], "--no-figures")
        assert run(capsys, *command(robot_folder, file, *options))[0] == 0
        summary = json.loads((here / "analysis" / "ur" / "summary.json").read_text())
        assert summary["columns"]["q"] == q and summary["columns"]["wrench"] == wrench
        assert summary["measures"]["moment"]["most"] == plain["measures"]["moment"]["most"]
        assert summary["rows_analysed"] == 300


@pytest.mark.parametrize("kind", ["npz", "csv", "parquet"])
def test_export_is_the_joint_stiffness_of_the_good_rows(kind, here, robot, robot_folder, capsys):
    """Export with two bad rows: the joint stiffness of the others, to the bit, in each format."""
    rows = ROWS.copy()
    rows[[5, 40], 3] = np.nan
    log = recordings.write_npz(here / "log.npz", rows)
    options = ("--export", kind, "--negate-wrench", "--no-figures")
    for _ in range(2):  # the second replaces the first
        assert run(capsys, *command(robot_folder, log, *options))[0] == 0
    file = here / "analysis" / "log" / f"joint_stiffness.{kind}"
    assert sorted(path.name for path in file.parent.iterdir()) == [file.name, "summary.json"]
    if kind == "npz":
        found = dict(np.load(file))
        number, time, stiffness = found["row"], found["time"], found["joint_stiffness"]
    else:
        table = pa.csv.read_csv(file) if kind == "csv" else pa.parquet.read_table(file)
        assert table.column_names[:4] == ["row", "time", "K_0_0", "K_0_1"]
        number, time, *entries = (column.to_numpy() for column in table.columns)
        stiffness = np.stack(entries, axis=1).reshape(-1, 7, 7)
    kept = np.delete(np.arange(300), [5, 40])
    assert np.array_equal(number, kept) and np.array_equal(time, rows[kept, 0])
    assert np.array_equal(
        stiffness, robot.hybrid.joint_stiffness(rows[kept, 1:8], -rows[kept, 8:], np.diag(np.array(K, dtype=float)))
    )


def test_the_asymmetry_is_compared_with_the_smallest_torque_limit(here, robot, robot_folder, capsys):
    log = recordings.write_npz(here / "log.npz", ROWS)
    _, out, _ = run(capsys, *command(robot_folder, log, "--no-figures"))
    torque = 0.1 * measured(robot, ROWS)["singular_value_antisymmetric"].max()
    share = 100 * torque / robot.EFFORT.min()
    weakest = robot.JOINTS[robot.EFFORT.argmin()]
    assert f"at most {torque:.3g} N m, {share:.2g} % of the smallest torque limit ({weakest}," in out


def test_float32_and_integers(here, robot_folder):
    """Read float32 and integers: the measures of both agree."""
    rows = np.round(ROWS)
    np.savez(here / "i.npz", q=rows[:, 1:8].astype(np.int16), wrench=rows[:, 8:].astype(np.float32))
    recordings.write_parquet(here / "f.parquet", rows.astype(np.float32))
    one = stiffgen.analyze("i.npz", robot_folder, K, figures=False).summary
    two = stiffgen.analyze("f.parquet", robot_folder, K, figures=False, time_column="").summary
    assert one["measures"] == two["measures"]
    assert one["time"] is None and two["time"] is None


def test_mcap(here, robot, robot_folder):
    """Read a bag with five missing wrenches: those rows are lost, and the others have the direct values."""
    log = recordings.write_mcap(here / "bag.mcap", ROWS, JOINTS, skip=(100, 101, 102, 103, 104))
    summary = stiffgen.analyze(log, robot_folder, K, figures=False, tolerance=0.002).summary
    assert (summary["rows"], summary["rows_bad"]) == (300, {"no wrench in time": 5})
    assert summary["rows_bad_first"][0] == {
        "row": "row 100",
        "reason": "no wrench within 0.002 s of the joint positions",
    }
    expected = measured(robot, np.delete(ROWS, np.s_[100:105], axis=0))
    for name, values in expected.items():
        found = summary["measures"][name]
        assert found["least"] == values.min() and found["most"] == values.max(), name
    assert "frame 'sensor'" in summary["notes"][0]
    np.testing.assert_allclose(summary["time"]["last"], 1 + ROWS[-1, 0], atol=1e-9)  # [s]; the bag begins at 1 s


def test_mcap_of_several_topics(here, robot_folder):
    """The chosen topic is read; the topic of the other type is the only one."""
    log = recordings.write_mcap(here / "two.mcap", ROWS[:5], JOINTS, extra_topics=("/left",))
    for topic in ("/left", "/wrench"):
        summary = stiffgen.analyze(log, robot_folder, K, figures=False, topics=[topic], output=here / topic[1:]).summary
        assert f"Wrenches on {topic}:" in summary["notes"][0]


def test_mcap_takes_the_nearest_wrench():
    """Compare with a search over all wrenches, with irregular stamps and late messages."""
    from stiffgen.lab.analyze.recording.stamps import Message, matched

    random = np.random.default_rng(3)
    wrenches = np.cumsum(random.integers(1, 30, 400)) * 1_000_000
    joints = np.sort(random.integers(0, wrenches[-1], 300))
    log = [(int(s + 4_000_000), True, int(s)) for s in wrenches] + [(int(s), False, int(s)) for s in joints]
    messages = [Message(is_wrench, logged, s, (float(s),)) for logged, is_wrench, s in sorted(log)]
    tolerance = 8_000_000
    matches = [(joints.stamp, wrench) for joints, wrench, _ in matched(messages, tolerance)]
    assert [s for s, _ in matches] == joints.tolist()
    for s, wrench in matches:
        away = np.abs(wrenches - s)
        assert (wrench is None) == (away.min() > tolerance)
        assert wrench is None or abs(wrench[0] - s) == away.min()
    assert 0 < sum(wrench is None for _, wrench in matches) < 300


@pytest.mark.parametrize("piece", [700, 1 << 22])
def test_bad_rows_of_csv_are_named_by_line_and_counted(here, robot_folder, capsys, monkeypatch, piece):
    """Read a CSV file with each kind of bad row: each is named by its line, whatever the pieces."""
    monkeypatch.setattr(csv_file, "_PIECE", piece)
    log = bad_csv(here / "bad.csv")
    code, out, err = run(capsys, *command(robot_folder, log, "--no-figures"))
    assert code == 0
    summary = json.loads((here / "analysis" / "bad" / "summary.json").read_text())
    reasons = {row["row"]: row["reason"] for row in summary["rows_bad_first"]}
    for line, (_, _, words) in BAD.items():
        assert words in reasons.pop(f"line {line}")
    assert reasons == {
        "line 20": "3 columns, where the header has 14",
        "line 24": "15 columns, where the header has 14",
        "line 26": "the stiffness is beyond what floating point holds",
    }
    assert summary["rows_bad"] == {
        "beyond joint limits": 1, "infinite": 2, "missing value": 1, "not a number": 1, "overflow": 1, "text": 2,
        "wrong number of columns": 2,
    }  # fmt: skip
    assert (summary["rows"], summary["rows_analysed"]) == (299, 289)  # line 22 is blank
    assert "289 of 299 rows analysed" in out
    assert "warning: 10 of 299 rows left out" in err and "line 12: q_0 is 'abc'" in err and "and 5 more" in err


def test_bad_rows_of_the_other_formats(here, robot_folder):
    """Read NaN, infinity and missing values in Parquet and NPZ: each is named by its row."""
    rows = ROWS.copy()
    rows[10, 3], rows[11, 9], rows[12, 0] = np.nan, np.inf, np.nan
    table = pa.table({n: pa.array(c, mask=np.arange(300) == 20) for n, c in zip(recordings.NAMES, rows.T, strict=True)})
    pa.parquet.write_table(table, here / "p.parquet")
    recordings.write_npz(here / "n.npz", rows)
    for file, bad in (("p.parquet", {"missing value": 1}), ("n.npz", {})):
        summary = stiffgen.analyze(file, robot_folder, K, figures=False).summary
        assert summary["rows_bad"] == {"infinite": 1, "not a number": 2, **bad}
        reasons = {row["row"]: row["reason"] for row in summary["rows_bad_first"]}
        assert "is not a number" in reasons["row 10"] and "is infinite" in reasons["row 11"]
        assert reasons["row 12"] == "time is not a number (NaN)"
        assert ("row 20" in reasons) == bool(bad)


def test_degrees_are_recognised(here, robot_folder, capsys):
    """Record degrees: no row is used, and the message asks for radians."""
    rows = ROWS.copy()
    rows[:, 1:8] = np.degrees(rows[:, 1:8])
    log = recordings.write_csv(here / "degrees.csv", rows)
    code, out, err = run(capsys, *command(robot_folder, log))
    assert (code, out) == (1, "")
    assert "none of its 300 rows" in err and "radians" in err and "line 2: q_0 is" in err
    assert sorted(p.name for p in here.iterdir()) == ["degrees.csv"]


@pytest.mark.parametrize("fixed", [True, False])
def test_lists_as_lerobot_writes_them_and_degrees(here, robot_folder, fixed):
    """Read lists and degrees as LeRobot writes them: the same numbers; a short list costs its row."""
    recordings.write_parquet(here / "plain.parquet", ROWS)
    expected = stiffgen.analyze("plain.parquet", robot_folder, K, figures=False).summary
    kinds = (pa.list_(pa.float64(), 7), pa.list_(pa.float64(), 6)) if fixed else 2 * (pa.list_(pa.float64()),)
    parts = (np.degrees(ROWS[:, 1:8]).tolist(), ROWS[:, 8:].tolist())
    if not fixed:
        parts[0][5] = parts[0][5][:3]
    columns = {"time": ROWS[:, 0]} | {
        f"observation.{name}": pa.array(part, kind)
        for name, part, kind in zip(("state", "wrench"), parts, kinds, strict=True)
    }
    pa.parquet.write_table(pa.table(columns), here / "lists.parquet")
    names = {"q": "observation.state:deg", "wrench": "observation.wrench"}
    found = stiffgen.analyze("lists.parquet", robot_folder, K, figures=False, **names).summary
    assert found["rows_bad"] == ({} if fixed else {"missing value": 1})
    for name in ("singular_value_symmetric", "eigenvalue_smallest") if fixed else ():
        assert found["measures"][name]["mean"] == pytest.approx(expected["measures"][name]["mean"], rel=1e-12)


def test_a_sliding_joint_has_no_degrees(here):
    """Metres would be taken for degrees."""
    (here / "lift.urdf").write_text(chain_urdf("prr"))
    chain = stiffgen.load_chain(here / "lift.urdf")
    with pytest.raises(stiffgen.RecordingError, match="slide and have no degrees"):
        analysis.request_of(AnalysisOptions("lift.csv", "lift", K, q="q_:deg"), chain)


def test_an_empty_recording_exits_with_1(here, robot_folder, capsys):
    """Analyse recordings without rows: exit code 1, the reason, and no folder."""
    for log in (
        recordings.write_csv(here / "e.csv", ROWS[:0]),
        recordings.write_npz(here / "e.npz", ROWS[:0]),
        recordings.write_parquet(here / "e.parquet", ROWS[:0]),
    ):
        code, out, err = run(capsys, *command(robot_folder, log))
        assert (code, out) == (1, "")
        assert "has no rows" in err
    assert not (here / "analysis").exists()


def test_time_that_runs_backwards(here, robot_folder, monkeypatch):
    """Let time run backwards twice, once at a cut: both places are named."""
    monkeypatch.setattr(parquet_file, "PARTITION_ROWS", 50)
    rows = ROWS.copy()
    rows[50:, 0] -= 0.1
    rows[120:, 0] -= 0.1
    rows[121, :] = np.nan  # a bad row beside the step back
    recordings.write_parquet(here / "late.parquet", rows, row_group_size=25)
    for block in (1, 7, 50):
        late = stiffgen.analyze("late.parquet", robot_folder, K, figures=False, block_rows=block)
        assert late.summary["time"]["backwards"] == 2
        assert late.summary["time"]["backwards_first"] == ["row 50", "row 120"]
        assert late.summary["rows_analysed"] == 299
        assert "time runs backwards at row 50, row 120;" in late_rows(late.recording, late.result)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cut.npz", "cut.parquet", "cut.csv"])
def test_cuts_do_not_matter(name, here, robot_folder, monkeypatch):
    """Cut the recording into partitions and blocks: the same results."""
    rows = recordings.draw(3000)
    rows[[17, 2000], 3] = np.nan
    write = {"npz": recordings.write_npz, "csv": recordings.write_csv, "parquet": recordings.write_parquet}
    write[name.split(".")[1]](here / name, rows)
    whole = stiffgen.analyze(name, robot_folder, K, figures=False, block_rows=1000)
    assert len(whole.recording.partitions) == 1
    assert whole.result.envelope.shift == 1  # 3000 rows in bins of 2: 1500 bins
    monkeypatch.setattr(csv_file, "_PARTITION", 100_001)  # [bytes] no multiple of a row
    for block in (7, 64):
        cut = stiffgen.analyze(name, robot_folder, K, figures=False, block_rows=block)
        assert not name.endswith("csv") or len(cut.recording.partitions) > 4
        assert_same(whole.result, cut.result)


def test_dask_gives_the_same(here, robot_folder, monkeypatch):
    """Analyse on a cluster of two workers: the bits of the analysis without."""
    monkeypatch.setattr(csv_file, "_PARTITION", 20_000)
    log = bad_csv(here / "log.csv")
    here_result = stiffgen.analyze(log, robot_folder, K, figures=False)
    assert len(here_result.recording.partitions) > 3
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as cluster:
        dask_result = stiffgen.analyze(log, robot_folder, K, figures=False, dask=cluster.scheduler_address)
    assert_same(here_result.result, dask_result.result, exact=True)
    assert dask_result.summary == here_result.summary


@pytest.mark.slow
def test_dask_local_and_the_command(here, robot_folder, capsys):
    """Analyse by --dask local: the output and summary of the analysis without."""
    log = recordings.write_parquet(here / "log.parquet", ROWS)
    outs = []
    for options in ((), ("--dask", "local")):
        code, out, _ = run(capsys, *command(robot_folder, log, "--no-figures", *options))
        assert code == 0
        outs.append((out, (here / "analysis" / "log" / "summary.json").read_bytes()))
    assert outs[0] == outs[1]


def test_dask_without_a_scheduler_is_refused(here, robot_folder, capsys):
    log = recordings.write_npz(here / "log.npz", ROWS)
    code, _, err = run(capsys, *command(robot_folder, log, "--dask", "nonsense://x"))
    assert code == 2
    assert "--dask nonsense://x" in err and "dask scheduler" in err
    assert not (here / "analysis").exists()


def test_a_comment_before_the_columns_is_named_beside_the_robot(here, robot_folder, capsys):
    """Read the client's log: the note names its posture spring, which the analysis leaves out."""
    plain = recordings.write_csv(here / "plain.csv", ROWS)
    plain.write_text("# robot: wiper, posture_stiffness: 10 N m/rad\n" + plain.read_text())
    code, out, _ = run(capsys, *command(robot_folder, plain, "--no-figures"))
    assert code == 0
    assert f"at the tip of {robot_folder.name} (without a tool)" in out
    assert "The log states: robot: wiper, posture_stiffness: 10 N m/rad." in out
    summary = json.loads((here / "analysis" / "plain" / "summary.json").read_text())
    assert summary["rows_analysed"] == 300 and summary["measures"]["moment"]["most_at"].startswith("line ")
    assert (summary["folder"], summary["tool"]) == (robot_folder.name, "without a tool")
