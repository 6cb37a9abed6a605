# SPDX-License-Identifier: MIT
"""stiffgen analyze: values against independent computation, formats, bad rows, cuts, Dask, refusals, memory."""

from __future__ import annotations

import gc
import html
import inspect
import json
import shutil
import tracemalloc
from dataclasses import fields
from types import SimpleNamespace

import distributed
import numpy as np
import pyarrow as pa
import pytest

import stiffgen
from stiffgen.analyze import analysis, recording
from stiffgen.analyze import measures as ms
from stiffgen.analyze.analysis import _tip, checked_stiffness
from stiffgen.analyze.measures import stiffness_unit
from stiffgen.analyze.options import AnalysisOptions, told
from stiffgen.analyze.recording import Request, csv_file, npz_file, open_recording, parquet_file
from stiffgen.analyze.report import late_rows
from stiffgen.cli import main
from stiffgen.errors import MissingExtraError, RecordingError
from stiffgen.symbolic.connection import REPRESENTATIONS
from stiffgen.verify.poses import gamma_F
from stiffgen.verify.references import References
from support import recordings
from support.project import ROOT

K = (700, 700, 800, 30, 30, 30)
JOINTS = tuple(f"A{i}" for i in range(1, 8))
ROWS = recordings.draw(300)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(capsys, *arguments):
    code = main(["analyze", *(str(a) for a in arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def command(robot_folder, log, *options, stiffness=K):
    return log, "--robot", robot_folder, "--task-stiffness", *stiffness, *options


def measured(robot, rows, representation="hybrid"):
    limits = np.full(7, np.inf)
    task = ms.Task(representation, checked_stiffness(K), False, -limits, limits)
    return dict(zip(ms.MEASURES, ms.measured(robot, task, rows[:, 1:8], rows[:, 8:]).T, strict=True))


def assert_same(one, other, exact=False):
    """The same summary; sums may differ in the last digits where rows were added up in other groups."""
    for name, value in vars(one).items():
        if name in ("total", "squares") and not exact:
            np.testing.assert_allclose(value, getattr(other, name), rtol=1e-12, atol=1e-10)
        elif name == "envelope":
            for field, part in vars(value).items():
                tolerance = 0 if exact or field != "total" else 1e-10
                np.testing.assert_allclose(part, getattr(other.envelope, field), rtol=tolerance, atol=tolerance)
        else:
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_measures_against_differentiated_poses(representation, robot, chain):
    """Singular values and eigenvalues of the formula on a Jacobian that CasADi differentiated."""
    references = References(chain, 40, seed=11)
    J, wrench = references.jacobian[representation].astype(float), references.samples.wrench
    stiffness = references.kinematic_stiffness(representation).astype(float) + J.transpose(0, 2, 1) @ np.diag(K) @ J
    gamma = ms._parts(J.transpose(0, 2, 1) @ gamma_F(representation, wrench) @ J)
    corrected = ms._parts(stiffness)[0] + gamma[0]
    rows = np.hstack([np.zeros((40, 1)), references.samples.q, wrench])
    found = measured(robot, rows, representation)
    largest = [np.linalg.svd(part, compute_uv=False)[:, 0] for part in ms._parts(stiffness)]
    eigenvalues = np.linalg.eigvalsh(corrected)
    length = {
        name: np.linalg.norm(wrench[:, part], axis=1) for name, part in (("force", np.s_[:3]), ("moment", np.s_[3:]))
    }
    for name, expected in {
        "singular_value_symmetric": largest[0],
        "singular_value_antisymmetric": largest[1],
        "eigenvalue_smallest": eigenvalues[:, 0],
        "eigenvalue_largest": eigenvalues[:, -1],
        "antisymmetric_per_moment": largest[1] / length["moment"],
        **length,
    }.items():
        np.testing.assert_allclose(found[name], expected, rtol=1e-11, atol=1e-9, err_msg=name)
    assert (found["corrected_antisymmetric"] == 0).all()
    assert (found["closed_form_difference"] < 1e-11).all()
    assert (largest[1] > 1).all()


def test_hybrid_closed_form(robot):
    """J_r^T [m]x J_r / 2, written down; and the difference is seen where there is one."""
    q, wrench = ROWS[:, 1:8], ROWS[:, 8:]
    J = robot.hybrid.jacobian(q)[:, 3:]
    x, y, z = wrench[:, 3:].T
    zero = np.zeros(len(x))
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    closed = J.transpose(0, 2, 1) @ cross @ J / 2
    np.testing.assert_allclose(ms._closed_form(robot.hybrid, q, wrench), closed, atol=1e-12)
    stiffness = robot.hybrid.joint_stiffness_uncorrected(q, wrench, np.diag(np.array(K, dtype=float)))
    np.testing.assert_allclose(ms._parts(stiffness)[1], closed, atol=1e-11)
    wrong = SimpleNamespace(**vars(robot.hybrid))
    wrong.connection_correction = lambda F: 1.01 * robot.hybrid.connection_correction(F)
    assert measured(SimpleNamespace(hybrid=wrong), ROWS)["closed_form_difference"].max() > 1e-3


def blanks(path):
    """NumPy's savetxt, with runs of blanks and tabs, Windows's line ends, and blanks at both ends of a line."""
    lines = recordings.write_csv(path, ROWS, delimiter=" ").read_text().splitlines()
    path.write_bytes(
        "".join(f"  {line.replace(' ', '  ', 3)}\t\r\n" for line in ["# " + lines[0], *lines[1:]]).encode()
    )
    return path


def write_all(folder):
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
    monkeypatch.setattr(npz_file, "PARTITION_ROWS", 90)
    monkeypatch.setattr(parquet_file, "PARTITION_ROWS", 90)
    monkeypatch.setattr(csv_file, "_PARTITION", 20_000)
    monkeypatch.setattr(csv_file, "_PIECE", 3_000)
    expected = measured(robot, ROWS)
    for file in write_all(here):
        done = stiffgen.analyze(file, robot_folder, K, figures=False)
        assert done.folder == here.joinpath("analysis", file.stem).relative_to(here)
        whole = file.name in ("compressed.npz", "both.npz", "plain.parquet")
        assert (len(done.recording.partitions) == 1) == whole, file.name
        summary = json.loads((done.folder / "summary.json").read_text())
        assert summary == done.summary
        assert (summary["rows"], summary["rows_analysed"], summary["rows_bad"]) == (300, 300, {}), file.name
        assert summary["rows_corrected_not_symmetric"] == 0
        first = 2 if done.recording.first_line else 0
        for name, values in expected.items():
            found = summary["measures"][name]
            assert found["least"] == values.min() and found["most"] == values.max(), (file.name, name)
            np.testing.assert_allclose(found["mean"], values.mean(), rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(found["rms"], np.sqrt((values**2).mean()), rtol=1e-12)
            assert int(found["most_at"].split()[1]) == values.argmax() + first
            if name == "moment":
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
    rows = np.round(ROWS)
    np.savez(here / "i.npz", q=rows[:, 1:8].astype(np.int16), wrench=rows[:, 8:].astype(np.float32))
    recordings.write_parquet(here / "f.parquet", rows.astype(np.float32))
    one = stiffgen.analyze("i.npz", robot_folder, K, figures=False).summary
    two = stiffgen.analyze("f.parquet", robot_folder, K, figures=False, time_column="").summary
    assert one["measures"] == two["measures"]
    assert one["time"] is None and two["time"] is None


def test_mcap(here, robot, robot_folder):
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
    np.testing.assert_allclose(summary["time"]["last"], 1 + ROWS[-1, 0], atol=1e-9)


def test_mcap_takes_the_nearest_wrench():
    """Against a search over all wrenches, with irregular stamps and late messages."""
    from stiffgen.analyze.recording.mcap_file import _matched

    random = np.random.default_rng(3)
    wrenches = np.cumsum(random.integers(1, 30, 400)) * 1_000_000
    joints = np.sort(random.integers(0, wrenches[-1], 300))
    log = [(int(s + 4_000_000), True, int(s)) for s in wrenches] + [(int(s), False, int(s)) for s in joints]
    messages = ((is_wrench, (s, (float(s),))) for _, is_wrench, s in sorted(log))
    tolerance = 8_000_000
    matches = list(_matched(messages, tolerance))
    assert [stamped[0] for stamped, _ in matches] == joints.tolist()
    for (s, _), wrench in matches:
        away = np.abs(wrenches - s)
        assert (wrench is None) == (away.min() > tolerance)
        assert wrench is None or abs(wrench[0] - s) == away.min()
    assert 0 < sum(wrench is None for _, wrench in matches) < 300


BAD = {  # line: (what stands there, category, words of the reason)
    12: ("abc", "text", "q_0 is 'abc'"),
    13: ("", "missing value", "q_0 is missing"),
    14: ("nan", "not a number", "q_0 is not a number"),
    15: ("-inf", "infinite", "q_0 is infinite"),
    16: ("1e400", "infinite", "q_0 is infinite"),
    17: ("3.8", "beyond joint limits", "q_0 is 3.8, far beyond the joint's limits -2.96706 ... 2.96706"),
    18: ("1_0", "text", "q_0 is '1_0'"),
}


def bad_csv(path):
    lines = recordings.write_csv(path, ROWS).read_text().split("\n")
    for line, (cell, _, _) in BAD.items():
        cells = lines[line - 1].split(",")
        lines[line - 1] = ",".join([cells[0], cell, *cells[2:]])
    lines[20 - 1] = "1,2,3"
    lines[22 - 1] = ""
    lines[24 - 1] += ",9"
    cells = lines[26 - 1].split(",")
    lines[26 - 1] = ",".join([*cells[:8], "1e308", *cells[9:]])
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("piece", [700, 1 << 22])
def test_bad_rows_of_csv_are_named_by_line_and_counted(here, robot_folder, capsys, monkeypatch, piece):
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
    rows = ROWS.copy()
    rows[:, 1:8] = np.degrees(rows[:, 1:8])
    log = recordings.write_csv(here / "degrees.csv", rows)
    code, out, err = run(capsys, *command(robot_folder, log))
    assert (code, out) == (1, "")
    assert "none of its 300 rows" in err and "radians" in err and "line 2: q_0 is" in err
    assert sorted(p.name for p in here.iterdir()) == ["degrees.csv"]


def test_an_empty_recording_exits_with_1(here, robot_folder, capsys):
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
    monkeypatch.setattr(npz_file, "PARTITION_ROWS", 50)
    rows = ROWS.copy()
    rows[50:, 0] -= 0.1
    rows[120:, 0] -= 0.1
    rows[121, :] = np.nan
    recordings.write_npz(here / "late.npz", rows)
    for block in (1, 7, 50):
        late = stiffgen.analyze("late.npz", robot_folder, K, figures=False, block_rows=block)
        assert late.summary["time"]["backwards"] == 2
        assert late.summary["time"]["backwards_first"] == ["row 50", "row 120"]
        assert late.summary["rows_analysed"] == 299
        assert "time runs backwards at row 50, row 120;" in late_rows(late.recording, late.result)


@pytest.mark.parametrize("name", ["cut.npz", "cut.parquet", "cut.csv"])
def test_cuts_do_not_matter(name, here, robot_folder, monkeypatch):
    rows = recordings.draw(3000)
    rows[[17, 2000], 3] = np.nan
    write = {"npz": recordings.write_npz, "csv": recordings.write_csv, "parquet": recordings.write_parquet}
    write[name.split(".")[1]](here / name, rows)
    whole = stiffgen.analyze(name, robot_folder, K, figures=False, block_rows=1000)
    assert len(whole.recording.partitions) == 1
    assert whole.result.envelope.shift == 1  # 3000 rows in bins of 2: 1500 bins
    monkeypatch.setattr(npz_file, "PARTITION_ROWS", 601)
    monkeypatch.setattr(csv_file, "_PARTITION", 100_001)
    for block in (7, 64):
        cut = stiffgen.analyze(name, robot_folder, K, figures=False, block_rows=block)
        assert name.endswith("parquet") or len(cut.recording.partitions) > 4
        assert_same(whole.result, cut.result)


def test_dask_gives_the_same(here, robot_folder, monkeypatch):
    monkeypatch.setattr(csv_file, "_PARTITION", 20_000)
    log = bad_csv(here / "log.csv")
    here_result = stiffgen.analyze(log, robot_folder, K, figures=False)
    assert len(here_result.recording.partitions) > 3
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        dask_result = stiffgen.analyze(log, robot_folder, K, figures=False, dask=cluster.scheduler_address)
    assert_same(here_result.result, dask_result.result, exact=True)
    assert dask_result.summary == here_result.summary


def test_dask_local_and_the_command(here, robot_folder, capsys):
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


def test_column_mapping(here, robot_folder, robot):
    names = ["t", *(f"a{i}" for i in range(7)), *("fx", "fy", "fz", "mx", "my", "mz")]
    order = np.random.default_rng(0).permutation(14)
    extra = [*(names[i] for i in order), "other", "other"]
    rows = np.hstack([ROWS[:, order], ROWS[:, :2]])
    recordings.write_csv(here / "m.csv", rows, names=extra)
    options = {"q_columns": names[1:8], "wrench_columns": names[8:], "time_column": "t"}
    expected = measured(robot, ROWS)["moment"].max()
    found = stiffgen.analyze("m.csv", robot_folder, K, figures=False, **options).summary
    assert found["measures"]["moment"]["most"] == expected
    assert found["time"]["last"] == ROWS[-1, 0]
    np.savez(here / "m.npz", joints=ROWS[:, 1:8], ft=ROWS[:, 8:])
    found = stiffgen.analyze("m.npz", robot_folder, K, figures=False, q_columns=["joints"], wrench_columns=["ft"])
    assert found.summary["measures"]["moment"]["most"] == expected
    assert found.summary["columns"]["q"][0] == "joints[0]"


def test_negated_wrench(here, robot_folder):
    recordings.write_npz(here / "a.npz", ROWS)
    turned = ROWS * np.r_[np.ones(8), -np.ones(6)]
    recordings.write_npz(here / "b.npz", turned)
    one = stiffgen.analyze("a.npz", robot_folder, K, figures=False).summary
    two = stiffgen.analyze("b.npz", robot_folder, K, figures=False, negate_wrench=True).summary
    plain = stiffgen.analyze("b.npz", robot_folder, K, figures=False).summary
    assert one["measures"] == two["measures"] != plain["measures"]
    assert two["wrench_negated"]


def test_task_stiffness_from_a_file(here, robot_folder, capsys):
    log = recordings.write_npz(here / "log.npz", ROWS)
    matrix = np.diag(np.array(K, dtype=float))
    matrix[0, 4] = matrix[4, 0] = 12.0
    np.savetxt(here / "K.csv", matrix, delimiter=",")
    code, _, _ = run(capsys, *command(robot_folder, log, "--no-figures", stiffness=["K.csv"]))
    assert code == 0
    summary = json.loads((here / "analysis" / "log" / "summary.json").read_text())
    assert summary["task_stiffness"] == matrix.tolist()


def asymmetric(here):
    matrix = np.diag(np.array(K, dtype=float))
    matrix[0, 4] = 12.0
    np.savetxt(here / "K.csv", matrix, delimiter=",")
    return ["K.csv"]


REFUSALS = [
    (lambda here, log: (log, {"stiffness": [1, 2, 3]}), "six numbers or a 6x6 matrix"),
    (lambda here, log: (log, {"stiffness": ["x"]}), "--task-stiffness x"),
    (lambda here, log: (log, {"stiffness": [1, 2, 3, 4, 5, "x"]}), "six numbers"),
    (lambda here, log: (log, {"stiffness": [1, 2, 3, 4, 5, "nan"]}), "not a finite number"),
    (lambda here, log: (log, {"stiffness": asymmetric(here)}), "not symmetric: entry (0, 4) is 12"),
    (lambda here, log: (here / "absent.csv", {}), "is no file"),
    (lambda here, log: (here, {}), "not ''"),
    (lambda here, log: (log, {"options": ["--q-columns", "a,b"]}), "2 names, but the robot has 7"),
    (lambda here, log: (log, {"options": ["--q", "q_", "--q-columns", "a"]}), "prefix or the names, not both"),
    (lambda here, log: (log, {"options": ["--wrench", "q_"]}), "needs 6 columns, q_0 ... q_5 or q_fx"),
    (lambda here, log: (log, {"options": ["--q", "wrench_"]}), "needs 7 columns"),
    (lambda here, log: (log, {"options": ["--q", "joint"]}), "the file has time, q_0"),
    (lambda here, log: (log, {"options": ["--wrench-columns", "a,b"]}), "2 names, but a wrench has 6"),
    (lambda here, log: (log, {"options": ["--time-column", "clock"]}), "no column clock; it has time, q_0"),
    (lambda here, log: (log, {"options": ["--q-columns", "a,b,c,d,e,f,q_0"]}), "no column a, b, c, d, e, f;"),
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
    (lambda here, log: (two_wrenches(here), {}), "choose with --wrench-topic: /left, /wrench"),
    (lambda here, log: (two_wrenches(here), {"options": ["--q-topic", "/wrench"]}), "is no topic of type sensor_msgs"),
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
    (here / "taken").mkdir()
    log, rest = case(here, recordings.write_csv(here / "log.csv", ROWS[:20]))
    before = sorted(here.iterdir())
    options = rest.pop("options", ())
    code, out, err = run(capsys, *command(rest.pop("robot", robot_folder), log, *options, **rest))
    assert (code, out) == (2, "")
    assert named in err
    assert "Traceback" not in err
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize("name", ["d.npz", "d.parquet"])
def test_damage_in_the_middle_leaves_nothing(name, here, robot_folder, capsys):
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


def test_a_robot_of_several_tips_and_a_tool_at_run_time(here, robot):
    dual = stiffgen.load_chain(ROOT / "tests" / "data" / "dual_arm.urdf", tip=["left hand", "right-hand"])
    assert _tip(dual, "left hand") == "left_hand"
    with pytest.raises(RecordingError, match="choose with --tip: left hand, right-hand"):
        _tip(dual, None)
    stub = SimpleNamespace(left_hand=robot)
    task = ms.Task("hybrid", checked_stiffness(K), False, robot.LOWER, robot.UPPER, "left_hand")
    direct = measured(robot, ROWS[:3])["moment"]
    assert np.array_equal(ms.measured(stub, task, ROWS[:3, 1:8], ROWS[:3, 8:])[:, ms.MEASURES.index("moment")], direct)


def test_units_follow_the_joints(chain):
    def of(*kinds):
        return stiffness_unit(SimpleNamespace(coordinates=[SimpleNamespace(type=kind) for kind in kinds]))

    assert stiffness_unit(chain) == of("revolute", "continuous") == "N m/rad"
    assert of("prismatic") == "N/m"
    assert of("revolute", "prismatic") == "N m/rad, N/rad, N/m"


def test_report(here, robot_folder, capsys):
    log = here / "<b>log & co.csv"
    bad_csv(log)
    code, out, err = run(capsys, *command(robot_folder, log))
    assert code == 0
    folder = here / "analysis" / log.stem
    assert out.splitlines()[-1] == str(folder.relative_to(here) / "report.html")
    files = {"report.html", "summary.json", "stiffness.svg", "eigenvalues.svg", "wrench.svg", "moment.svg"}
    assert {p.name for p in folder.iterdir()} == files
    page = (folder / "report.html").read_text()
    assert "content=\"default-src 'none'; style-src 'unsafe-inline'; img-src 'self' file: data:\"" in html.unescape(
        page
    )
    assert "<script" not in page
    assert "<b>log" not in page and "&lt;b&gt;log &amp; co.csv" in page
    assert "10 of 299 rows left out" in page
    for file in sorted(files):
        assert file == "report.html" or file in page
    labels = {
        "stiffness.svg": ("symmetric part [N m/rad]", "antisymmetric part [N m/rad]", "time since the first row [s]"),
        "eigenvalues.svg": ("largest [N m/rad]", "smallest [N m/rad]", "time since the first row [s]"),
        "wrench.svg": ("force [N]", "moment [N m]", "time since the first row [s]"),
        "moment.svg": ("moment [N m]", "antisymmetric part, conventional [N m/rad]", "rows"),
    }
    for file, texts in labels.items():
        drawing = (folder / file).read_text()
        assert "prefers-color-scheme:dark" in drawing and "currentColor" in drawing
        for text in texts:
            assert f">{text}</text>" in drawing, (file, text)
        assert "legend" in drawing
    first = {p.name: p.read_bytes() for p in folder.iterdir()}
    assert run(capsys, *command(robot_folder, log))[0] == 0
    assert first == {p.name: p.read_bytes() for p in folder.iterdir()}
    assert run(capsys, *command(robot_folder, log, "--no-figures"))[0] == 0
    assert [p.name for p in folder.iterdir()] == ["summary.json"]
    (folder / "mine.txt").write_text("")
    code, _, err = run(capsys, *command(robot_folder, log))
    assert code == 2 and "mine.txt" in err


@pytest.mark.parametrize("change", ["backwards", "jump", "none", "one row"])
def test_figures_over_rows_where_time_is_of_no_use(change, here, robot_folder):
    rows = ROWS[:1].copy() if change == "one row" else ROWS.copy()
    if change == "backwards":
        rows[100:, 0] -= 1
    elif change == "jump":
        rows[1:, 0] += 1.7e9
    recordings.write_npz(here / "log.npz", rows)
    stiffgen.analyze("log.npz", robot_folder, K, time_column="" if change == "none" else None)
    assert ">row, counted from 0</text>" in (here / "analysis" / "log" / "stiffness.svg").read_text()


def test_a_missing_extra_is_named(here, robot_folder, capsys, monkeypatch):
    import importlib

    find = importlib.import_module

    def absent(name, *rest):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return find(name, *rest)

    monkeypatch.setattr(recording.importlib, "import_module", absent)
    log = recordings.write_csv(here / "log.csv", ROWS)
    code, _, err = run(capsys, *command(robot_folder, log))
    assert code == 2
    assert "pip install 'stiffgen[analyze]'" in err
    assert issubclass(MissingExtraError, stiffgen.StiffgenError)
    assert not (here / "analysis").exists()


def test_memory_does_not_grow_with_the_rows(here, robot_folder, monkeypatch):
    monkeypatch.setattr(npz_file, "PARTITION_ROWS", 1000)
    monkeypatch.setattr(analysis, "_MOST_THREADS", 1)  # what two of them hold at once is left to chance
    peaks = []
    for count in (6_000, 36_000):
        recordings.write_npz(here / f"{count}.npz", np.resize(ROWS, (count, 14)))
        tracemalloc.start()
        stiffgen.analyze(f"{count}.npz", robot_folder, K, figures=False, block_rows=250)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0] + 1_000_000  # 36 000 rows are 4 MB of data and 14 MB of each matrix


@pytest.mark.parametrize(("name", "rows", "most"), [("log.parquet", 400_000, 20e6), ("log.csv", 12_000, 1e6)])
def test_readers_hold_a_few_blocks(name, rows, most, here, monkeypatch):
    """What pyarrow holds while a Parquet file that is one row group of 45 MB, or a CSV file of 3 MB, is read."""
    monkeypatch.setattr(csv_file, "_PIECE", 1 << 18)
    numbers = np.random.default_rng(0).normal(size=(rows, 14))
    if name.endswith("parquet"):
        recordings.write_parquet(here / name, numbers, row_group_size=rows, use_dictionary=False)
    else:
        recordings.write_csv(here / name, numbers)
    (partition,) = open_recording(here / name, Request(joints=JOINTS)).partitions
    gc.collect()
    before, held, seen = pa.total_allocated_bytes(), 0, 0
    for block in partition.blocks(1000):
        seen += len(block.rows)
        held = max(held, pa.total_allocated_bytes() - before)
    assert seen == rows
    assert held < most


def test_a_recording_that_is_moved_away_while_it_is_read(here, robot_folder):
    log = recordings.write_csv(here / "log.csv", ROWS)
    recording = open_recording(log, Request(joints=JOINTS))
    log.write_text("shorter")
    with pytest.raises(RecordingError, match="became shorter"):
        list(recording.partitions[0].blocks(10))
    shutil.rmtree(here / "analysis", ignore_errors=True)


def test_quantiles_lie_within_the_extremes(robot):
    """One row, and rows that are all alike: each quantile is that value itself, not the middle of its bin."""
    for count in (1, 5):
        rows = np.repeat(ROWS[:1], count, axis=0)
        block = recording.Block(np.arange(count), rows)
        layout = recording.Layout("time", tuple(f"q_{k}" for k in range(7)), tuple(f"wrench_{k}" for k in range(6)))
        limits = np.full(7, np.inf)
        summary = ms.summarise(robot, ms.Task("hybrid", checked_stiffness(K), False, -limits, limits), layout, block)
        for column, name in enumerate(ms.MEASURES):
            if summary.least[column] >= 0:
                for share in (0.0, 0.5, 0.99, 1.0):
                    assert summary.least[column] <= summary.quantile(name, share) <= summary.most[column], name


@pytest.mark.parametrize(("representation", "words"), [("hybrid", "coincide"), ("body", "is not this symmetric part")])
def test_the_first_figure_says_whether_corrected_and_symmetric_part_coincide(
    here, capsys, robot, robot_folder, representation, words
):
    recordings.write_csv(here / "log.csv", ROWS)
    arguments = command(robot_folder, "log.csv", "--representation", representation)
    assert run(capsys, *arguments)[0] == 0
    page = (here / "analysis" / "log" / "report.html").read_text()
    assert words in page
    q, wrench, matrix = ROWS[:, 1:8], ROWS[:, 8:], np.diag(np.array(K, dtype=float))
    functions = getattr(robot, representation)
    symmetric = ms._parts(functions.joint_stiffness_uncorrected(q, wrench, matrix))[0]
    difference = np.abs(symmetric - functions.joint_stiffness(q, wrench, matrix)).max()
    assert (difference < 1e-10) == (representation == "hybrid")


def test_the_table_fits_80_columns(here, capsys, robot_folder):
    recordings.write_csv(here / "log.csv", ROWS)
    _, out, _ = run(capsys, *command(robot_folder, "log.csv", "--no-figures"))
    table = out[: out.index(" rows analysed")].splitlines()[:-1]
    assert len(table) > 10
    assert max(map(len, table)) <= 80


def test_options_of_another_format_are_refused(here, capsys, robot_folder):
    recordings.write_csv(here / "log.csv", ROWS)
    for option in (("--q-topic", "/joints"), ("--tolerance", "0.1")):
        code, out, err = run(capsys, *command(robot_folder, "log.csv", *option))
        assert (code, out) == (2, "")
        assert "MCAP" in err


def test_one_record_makes_the_command_line_and_the_function(capsys):
    """Every field is an argument of :func:`stiffgen.analyze` that its help explains, and an option with that help."""
    described = fields(AnalysisOptions)
    assert list(inspect.signature(stiffgen.analyze).parameters) == [each.name for each in described]
    in_python = " ".join(stiffgen.analyze.__doc__.split())
    with pytest.raises(SystemExit):
        main(["analyze", "--help"])
    on_the_command_line = " ".join(capsys.readouterr().out.split())
    for each in described:
        said = told(each)
        assert f"{each.name}: " in in_python
        assert said.meaning in in_python
        if said.command is not None:
            assert "".join(said.meaning.split()) in "".join(on_the_command_line.split())
    assert [each.name for each in described if told(each).command is None] == ["block_rows", "progress"]
    with pytest.raises(TypeError, match="figure"):
        stiffgen.analyze("log.csv", "folder", K, figure=False)
