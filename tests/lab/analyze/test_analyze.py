# SPDX-License-Identifier: MIT
"""stiffgen analyze: values against independent computation, options, report, memory."""

from __future__ import annotations

import gc
import html
import inspect
import itertools
import json
import shutil
import tracemalloc
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

import stiffgen
from stiffgen.cli import main, parser
from stiffgen.core.described import help_of
from stiffgen.core.errors import MissingExtraError, RecordingError, install_command
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.verify.kernels.poses import gamma_F
from stiffgen.core.verify.kernels.references import WRENCH, References
from stiffgen.lab.analyze import analysis, recording
from stiffgen.lab.analyze import measures as ms
from stiffgen.lab.analyze.analysis import _tip, checked_stiffness
from stiffgen.lab.analyze.measures import stiffness_unit
from stiffgen.lab.analyze.options import AnalysisOptions
from stiffgen.lab.analyze.recording import RecordingRequest, csv_file, open_recording, parquet_file
from stiffgen.lab.analyze.task import Task
from support import recordings
from support.analysis import JOINTS, ROWS, K, bad_csv, command, measured, run
from support.project import ROOT


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_measures_against_differentiated_poses(representation, robot, chain):
    """Compare singular values and eigenvalues of the formula with those on a Jacobian that CasADi differentiated."""
    references = References(chain, 40, seed=11)
    J, wrench = references.jacobian[representation].astype(float), references.samples[WRENCH]
    stiffness = references.kinematic_stiffness(representation).astype(float) + J.transpose(0, 2, 1) @ np.diag(K) @ J
    gamma = ms._parts(J.transpose(0, 2, 1) @ gamma_F(representation, wrench) @ J)
    corrected = ms._parts(stiffness)[0] + gamma[0]
    rows = np.hstack([np.zeros((40, 1)), references.samples[Q], wrench])
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
    assert (largest[1] > 1).all()  # [N m/rad] the antisymmetric parts matter


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


def test_column_mapping(here, robot_folder, robot):
    """Name the columns in any order: the measures of the usual names."""
    names = ["t", *(f"a{i}" for i in range(7)), *("fx", "fy", "fz", "mx", "my", "mz")]
    order = np.random.default_rng(0).permutation(14)
    extra = [*(names[i] for i in order), "other", "other"]
    rows = np.hstack([ROWS[:, order], ROWS[:, :2]])
    recordings.write_csv(here / "m.csv", rows, names=extra)
    options = {"q": names[1:8], "wrench": names[8:], "time_column": "t"}
    expected = measured(robot, ROWS)["moment"].max()
    found = stiffgen.analyze("m.csv", robot_folder, K, figures=False, **options).summary
    assert found["measures"]["moment"]["most"] == expected
    assert found["time"]["last"] == ROWS[-1, 0]
    np.savez(here / "m.npz", joints=ROWS[:, 1:8], ft=ROWS[:, 8:])
    found = stiffgen.analyze("m.npz", robot_folder, K, figures=False, q="joints", wrench=["ft"])
    assert found.summary["measures"]["moment"]["most"] == expected
    assert found.summary["columns"]["q"][0] == "joints[0]"


def test_negated_wrench(here, robot_folder):
    """Turn the wrench's sign and pass negate_wrench: the measures of the original."""
    recordings.write_npz(here / "a.npz", ROWS)
    turned = ROWS * np.r_[np.ones(8), -np.ones(6)]
    recordings.write_npz(here / "b.npz", turned)
    one = stiffgen.analyze("a.npz", robot_folder, K, figures=False).summary
    two = stiffgen.analyze("b.npz", robot_folder, K, figures=False, negate_wrench=True).summary
    plain = stiffgen.analyze("b.npz", robot_folder, K, figures=False).summary
    assert one["measures"] == two["measures"] != plain["measures"]
    assert two["wrench_negated"]


@pytest.mark.parametrize("stiffness", [["1", "2", "3", "4", "5", "6"], ["K.csv"]])
def test_the_recording_stands_anywhere(stiffness):
    """Give the arguments in each order: the stiffness does not swallow the file's name."""
    words = ["--task-stiffness", *stiffness]
    for order in itertools.permutations((["log.csv"], words, ["--robot", "DIR"])):
        options = parser().parse_args(["analyze", *itertools.chain(*order)])
        assert (options.log, options.task_stiffness, options.robot) == ("log.csv", stiffness, "DIR"), order
    with pytest.raises(SystemExit):
        parser().parse_args(["analyze", *words, "--robot", "DIR"])


def test_task_stiffness_from_a_file(here, robot_folder, capsys):
    """Read the stiffness from a file, with a coupling of 12 N: the summary has it."""
    log = recordings.write_npz(here / "log.npz", ROWS)
    matrix = np.diag(np.array(K, dtype=float))
    matrix[0, 4] = matrix[4, 0] = 12.0
    np.savetxt(here / "K.csv", matrix, delimiter=",")
    code, _, _ = run(capsys, *command(robot_folder, log, "--no-figures", stiffness=["K.csv"]))
    assert code == 0
    summary = json.loads((here / "analysis" / "log" / "summary.json").read_text())
    assert summary["task_stiffness"] == matrix.tolist()


def test_a_robot_of_several_tips_and_a_tool_at_run_time(here, robot):
    """Analyse one tip of a dual arm: refused without --tip, and its own functions with it."""
    dual = stiffgen.load_chain(ROOT / "tests" / "data" / "dual_arm.urdf", tip=["left hand", "right-hand"])
    assert _tip(dual, "left hand") == "left_hand"
    with pytest.raises(RecordingError, match="choose with --tip: left hand, right-hand"):
        _tip(dual, None)
    stub = SimpleNamespace(left_hand=robot)
    task = Task("hybrid", checked_stiffness(K), False, robot.LOWER, robot.UPPER, "left_hand")
    direct = measured(robot, ROWS[:3])["moment"]
    assert np.array_equal(ms.measured(stub, task, ROWS[:3, 1:8], ROWS[:3, 8:])[:, ms.MEASURES.index("moment")], direct)


def test_units_follow_the_joints(chain):
    def of(*kinds):
        return stiffness_unit(SimpleNamespace(coordinates=[SimpleNamespace(type=kind) for kind in kinds]))

    assert stiffness_unit(chain) == of("revolute", "continuous") == "N m/rad"
    assert of("prismatic") == "N/m"
    assert of("revolute", "prismatic") == "N m/rad, N/rad, N/m"


def test_report(here, robot_folder, capsys):
    """Write the report of a recording with bad rows and a hostile name: all figures, escaped text, same bytes again."""
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


@pytest.mark.slow
@pytest.mark.parametrize("change", ["backwards", "jump", "none", "one row"])
def test_figures_over_rows_where_time_is_of_no_use(change, here, robot_folder):
    """Analyse recordings whose time jumps or is absent: figures over row numbers."""
    rows = ROWS[:1].copy() if change == "one row" else ROWS.copy()
    if change == "backwards":
        rows[100:, 0] -= 1
    elif change == "jump":
        rows[1:, 0] += 1.7e9
    recordings.write_npz(here / "log.npz", rows)
    stiffgen.analyze("log.npz", robot_folder, K, time_column="" if change == "none" else None)
    assert ">row, counted from 0</text>" in (here / "analysis" / "log" / "stiffness.svg").read_text()


def test_a_missing_extra_is_named(here, robot_folder, capsys, monkeypatch):
    """Take pyarrow away: exit code 2 and the command that installs it."""
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
    assert install_command("analyze") in err
    assert issubclass(MissingExtraError, stiffgen.StiffgenError)
    assert not (here / "analysis").exists()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_rows(here, robot_folder, monkeypatch):
    """Analyse six times as many rows: the peak of memory stays within 10 % and 1 MB."""
    monkeypatch.setattr(parquet_file, "PARTITION_ROWS", 1000)
    monkeypatch.setattr(analysis, "_MOST_THREADS", 1)  # what two of them hold at once is left to chance
    peaks = []
    for count in (6_000, 36_000):
        recordings.write_parquet(here / f"{count}.parquet", np.resize(ROWS, (count, 14)), row_group_size=500)
        tracemalloc.start()
        stiffgen.analyze(f"{count}.parquet", robot_folder, K, figures=False, block_rows=250)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0] + 1_000_000  # 36 000 rows are 4 MB of data and 14 MB of each matrix


@pytest.mark.parametrize(("name", "rows", "most"), [("log.parquet", 400_000, 20e6), ("log.csv", 12_000, 1e6)])
def test_readers_hold_a_few_blocks(name, rows, most, here, monkeypatch):
    """Read a Parquet file of one row group (45 MB) and a CSV file: readers hold a few blocks."""
    monkeypatch.setattr(csv_file, "_PIECE", 1 << 18)
    numbers = np.random.default_rng(0).normal(size=(rows, 14))
    if name.endswith("parquet"):
        recordings.write_parquet(here / name, numbers, row_group_size=rows, use_dictionary=False)
    else:
        recordings.write_csv(here / name, numbers)
    (partition,) = open_recording(here / name, RecordingRequest(joints=JOINTS)).partitions
    gc.collect()
    before, held, seen = pa.total_allocated_bytes(), 0, 0
    for block in partition.blocks(1000):
        seen += len(block.rows)
        held = max(held, pa.total_allocated_bytes() - before)
    assert seen == rows
    assert held < most


def test_a_recording_that_is_moved_away_while_it_is_read(here, robot_folder):
    log = recordings.write_csv(here / "log.csv", ROWS)
    recording = open_recording(log, RecordingRequest(joints=JOINTS))
    log.write_text("shorter")
    with pytest.raises(RecordingError, match="became shorter"):
        list(recording.partitions[0].blocks(10))
    shutil.rmtree(here / "analysis", ignore_errors=True)


def test_quantiles_lie_within_the_extremes(robot):
    """Analyse one row, and equal rows: each quantile is that value, not the middle of its bin."""
    for count in (1, 5):
        rows = np.repeat(ROWS[:1], count, axis=0)
        block = recording.Block(np.arange(count), rows)
        columns = recording.Columns("time", tuple(f"q_{k}" for k in range(7)), tuple(f"wrench_{k}" for k in range(6)))
        limits = np.full(7, np.inf)
        summary = ms.summarise(robot, Task("hybrid", checked_stiffness(K), False, -limits, limits), columns, block)
        for column, name in enumerate(ms.MEASURES):
            if summary.count[column] and summary.least[column] >= 0:
                for share in (0.0, 0.5, 0.99, 1.0):
                    assert summary.least[column] <= summary.quantile(name, share) <= summary.most[column], name


@pytest.mark.slow
@pytest.mark.parametrize(("representation", "words"), [("hybrid", "coincide"), ("body", "is not this symmetric part")])
def test_the_first_figure_says_whether_corrected_and_symmetric_part_coincide(
    here, capsys, robot, robot_folder, representation, words
):
    """Analyse in two representations: the corrected stiffness is the symmetric part in the hybrid one only."""
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
    for option in (("--topic", "/joints"), ("--tolerance", "0.1")):
        code, out, err = run(capsys, *command(robot_folder, "log.csv", *option))
        assert (code, out) == (2, "")
        assert "MCAP" in err


def test_one_record_makes_the_command_line_and_the_function(capsys):
    """Compare the record's fields with arguments and options: each exists and is explained."""
    described = fields(AnalysisOptions)
    assert list(inspect.signature(stiffgen.analyze).parameters) == [each.name for each in described]
    in_python = " ".join(stiffgen.analyze.__doc__.split())
    with pytest.raises(SystemExit):
        main(["analyze", "--help"])
    on_the_command_line = " ".join(capsys.readouterr().out.split())
    for each in described:
        said = help_of(each)
        assert f"{each.name}: " in in_python
        assert said.meaning in in_python
        if said.command is not None:
            assert "".join((said.negative or said.meaning).split()) in "".join(on_the_command_line.split())
    assert [each.name for each in described if help_of(each).command is None] == ["block_rows", "progress"]
    with pytest.raises(TypeError, match="figure"):
        stiffgen.analyze("log.csv", "folder", K, figure=False)
