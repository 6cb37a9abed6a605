# SPDX-License-Identifier: MIT
"""MCAP files whose clocks jump: only the messages concerned are lost, for the true reason; no match is wrong."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen
from stiffgen.lab.analyze.recording import RecordingRequest, open_recording, read_blocks
from stiffgen.lab.analyze.recording.stamps import Message, matched
from support import recordings
from support.analysis import JOINTS, ROWS, K

SECOND = 10**9
LONG = recordings.draw(1000)


def read(path, tolerance=0.002):
    """Return rows (N, 14), the problems by row, and the notes about clocks."""
    recording = open_recording(path, RecordingRequest(joints=JOINTS, tolerance=tolerance))
    blocks = [block for part in recording.partitions for block in read_blocks(part, 128)]
    problems = {int(block.rows[k]): problem for block in blocks for k, problem in block.problems.items()}
    return np.concatenate([block.values for block in blocks]), problems, recording.notes[1:]


def assert_matched(rows, problems, expected=LONG):
    """Compare positions and wrenches of the usable rows with what was written."""
    good = np.array([index not in problems for index in range(len(expected))])
    assert len(rows) == len(expected)
    np.testing.assert_array_equal(rows[good, 1:], expected[good, 1:])


@pytest.mark.parametrize("seconds", [1e3, -1e3, 1e9])
def test_a_wrench_with_a_wrong_stamp_costs_its_own_row(tmp_path, seconds):
    """Put one stamp into the future: one row is lost. Before: the 898 behind it."""
    log = recordings.write_mcap(
        tmp_path / "a.mcap", LONG, JOINTS, clocks=lambda row: (0, round(seconds * SECOND) * (row == 101), 0)
    )
    rows, problems, notes = read(log)
    assert {row: problem.category for row, problem in problems.items()} == {101: "stamp of another time"}
    assert_matched(rows, problems)
    assert notes == (
        f"Time stamps on /wrench jump 2 times, first by {seconds:g} s at message 101: the publisher's clock.",
    )


@pytest.mark.parametrize("seconds", [1e3, -1e3])
def test_joint_positions_with_a_wrong_stamp_cost_their_own_row(tmp_path, seconds):
    """Shift one stamp by 1000 s: that row alone is lost, with the reason."""
    log = recordings.write_mcap(
        tmp_path / "a.mcap", LONG, JOINTS, clocks=lambda row: (round(seconds * SECOND) * (row == 101), 0, 0)
    )
    rows, problems, _ = read(log)
    assert list(problems) == [101] and problems[101].category == "stamp of another time"
    assert "are stamped 1000" in problems[101].text or "are stamped 999.99" in problems[101].text
    assert problems[101].text.endswith("earlier" if seconds > 0 else "later")
    assert_matched(rows, problems)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [-100.0, -3.0, -0.5, -0.05, 0.5, 100.0])
@pytest.mark.parametrize("recorder", [False, True])
def test_a_clock_that_is_set(tmp_path, seconds, recorder):
    """Set the clock of the publishers, or of the whole computer with the recorder's: rows still match."""
    step = round(seconds * SECOND)
    log = recordings.write_mcap(
        tmp_path / "a.mcap",
        LONG,
        JOINTS,
        clocks=lambda row: (step * (row >= 500),) * 2 + (1000 * SECOND + step * recorder * (row >= 500),),
    )
    rows, problems, notes = read(log)
    assert_matched(rows, problems)
    assert not problems
    assert any("set back (1 times)" in note for note in notes) == (recorder and seconds < 0)
    assert (len(notes) > 0) == (seconds < -0.002 or (seconds > 1.0 and not recorder))


def test_a_match_is_the_nearest_of_those_logged_beside():
    """Compare matches with a search over all wrenches, one stamp in eight wrong by up to 5 s."""
    random, tolerance = np.random.default_rng(0), 8_000_000  # [ns], as all times here
    for _ in range(50):
        logged = np.cumsum(random.integers(1, 20_000_000, 200))
        wrong = random.integers(-5 * SECOND, 5 * SECOND, 200) * (random.random(200) < 1 / 8)
        stamps = logged - random.integers(0, 3_000_000, 200) + wrong
        log = [
            Message(bool(kind), int(time), int(stamp), (float(stamp),))
            for kind, time, stamp in zip(random.integers(2, size=200), logged, stamps, strict=True)
        ]
        for joints, wrench, _ in matched(log, tolerance):
            beside = [w.stamp for w in log if w.is_wrench and abs(w.logged - joints.logged) <= tolerance + SECOND]
            near = [stamp for stamp in beside if abs(stamp - joints.stamp) <= tolerance]
            assert (wrench is None) == (not near)
            assert wrench is None or wrench[0] in near


def test_clocks_of_two_computers(here, robot_folder):
    """The sensor's computer is 100 s ahead from row 200 on: those rows are bad, and the reason says why."""
    log = recordings.write_mcap(here / "a.mcap", ROWS, JOINTS, clocks=lambda row: (0, 100 * SECOND * (row >= 200), 0))
    summary = stiffgen.analyze(log, robot_folder, K, figures=False).summary
    assert summary["rows_bad"] == {"stamp of another time": 98}  # two are within 0.01 s of a wrench before
    assert "are stamped 100" in summary["rows_bad_first"][-1]["reason"]
    assert "/wrench jump 1 times, first by 100 s at message 200" in summary["notes"][1]


def test_simulated_time_in_the_stamps(tmp_path):
    """Stamps have another origin than the log, and stand still while the simulator pauses."""
    log = recordings.write_mcap(
        tmp_path / "a.mcap",
        LONG,
        JOINTS,
        clocks=lambda row: (-SECOND // 2, -SECOND // 2, (1_700_000_000 + 60 * (row >= 400)) * SECOND),
    )
    rows, problems, _ = read(log)
    assert not problems
    assert_matched(rows, problems)


def test_logged_times_that_say_nothing(tmp_path):
    """Convert a recording, so that logged times say nothing: rows still match."""
    for name, factor in (("still", 0.0), ("fast", 1e-4)):
        log = recordings.write_mcap(
            tmp_path / f"{name}.mcap",
            LONG,
            JOINTS,
            delay=0,
            clocks=lambda row, factor=factor: (0, 0, round((factor - 1) * LONG[row, 0] * SECOND)),
        )
        rows, problems, _ = read(log)
        assert not problems
        assert_matched(rows, problems)
