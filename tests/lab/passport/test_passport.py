# SPDX-License-Identifier: MIT
"""``stiffgen passport``: the page, the table, recorded postures, and refusals."""

from __future__ import annotations

import csv
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.control.presets import motor_tables
from stiffgen.core.errors import RecordingError, StiffgenError, install_command
from stiffgen.lab.passport.loop import LoopTiming
from stiffgen.lab.passport.page import render_page, statements, warnings
from stiffgen.lab.passport.passport import PassportOptions, make_passport
from stiffgen.lab.passport.postures import recorded_postures, spread_postures
from support.project import URDF

GAINS = ("--kp", "400,400,300,250,150,100,80", "--kc", "9000")


@pytest.fixture(scope="module")
def robot(robot_folder):
    return stiffgen.open_robot(robot_folder)


def test_one_page_and_one_table(robot, tmp_path, monkeypatch, capsys):
    """The page has every quantity with what it was verified against; the table has every posture."""
    monkeypatch.chdir(tmp_path)
    command = ["passport", str(robot.folder), "--rate", "500", "--delay", "1", "--sensor", "1e-5", *GAINS]
    assert main(command) == 0
    printed, text = capsys.readouterr().out, (tmp_path / "iiwa14_passport.html").read_text()
    assert printed.splitlines()[-2:] == ["iiwa14_passport.html", "iiwa14_passport.csv"]
    assert "500 Hz, a delay of 1 sample and encoder steps of 1e-05" in printed
    with (tmp_path / "iiwa14_passport.csv").open() as file:
        rows = list(csv.reader(file))
    timing = LoopTiming(500.0, 1, 1e-5)
    options = PassportOptions(timing, (400, 400, 300, 250, 150, 100, 80), (9000.0,))
    passport = make_passport(robot, options)
    assert rows[0] == [*passport.joints, "tip x [m]", "tip y [m]", "tip z [m]",
                       *(f"{each.name} [{each.unit}]" for each in passport.quantities)]  # fmt: skip
    table = np.array(rows[1:], dtype=float)
    # postures; joints, position of the tip and quantities
    assert table.shape == (256, 7 + 3 + len(passport.quantities))
    np.testing.assert_allclose(table[:, :7], passport.q, rtol=1e-5)
    for number, quantity in enumerate(passport.quantities):
        np.testing.assert_allclose(table[:, 10 + number], quantity.values, rtol=1e-5)
        assert f">{quantity.name}</td>" in text and quantity.verified in text and len(quantity.verified) > 10
    worst = passport.q[passport["rendered"].argmin()]
    assert all(f"<td>{value:.3f}</td>" in text for value in worst)
    assert "<script" not in text and "url(http" not in text and 'href="http' not in text  # it stands alone
    assert text.count("<svg") == 1 and "prefers-color-scheme:dark" in text
    assert re.findall(r'(?:src|href)="(?!data:)([^"#][^"]*)"', text) == ["iiwa14_passport.csv"]


def test_postures_of_a_recording(robot, tmp_path):
    """Columns q_0 ... or the joints' names; rows without a number are left out, and many rows are thinned evenly."""
    file = tmp_path / "log.csv"
    q = np.random.default_rng(1).uniform(-1, 1, (600, 7))
    lines = [",".join(f"{value:.9f}" for value in row) for row in q]
    file.write_text("\n".join([",".join(f"q_{i}" for i in range(7)), *lines, "1,2,,4,5,6,7"]) + "\n")
    postures = recorded_postures(file, robot.chain)
    assert len(postures) == 256
    np.testing.assert_allclose(postures[[0, -1]], q[[0, -1]], atol=1e-9)
    file.write_text("\n".join(["time,A7,A6,A5,A4,A3,A2,A1", "0,7,6,5,4,3,2,1"]))
    np.testing.assert_allclose(recorded_postures(file, robot.chain), [[1, 2, 3, 4, 5, 6, 7]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "has no column q_0"),
        ("q_0,q_1,q_2,q_3,q_4,q_5,q_6\n", "no row with a number"),
        (None, "cannot be"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(robot, tmp_path, text, said):
    """Take postures from a recording without positions: refused with the reason."""
    file = tmp_path / "log.csv"
    if text is not None:
        file.write_text(text)
    with pytest.raises(RecordingError, match=said):
        recorded_postures(file, robot.chain)


def test_postures_fill_the_joints_ranges(robot):
    """Every quarter of each joint's range, and of each pair's, has its share of the postures."""
    share = (spread_postures(robot.chain) - robot.module.LOWER) / (robot.module.UPPER - robot.module.LOWER)
    assert ((share >= 0) & (share <= 1)).all()
    quarter = (4 * share).astype(int)
    for i in range(7):
        assert (np.bincount(quarter[:, i], minlength=4) > 56).all()
        for j in range(i):
            assert (np.bincount(4 * quarter[:, i] + quarter[:, j], minlength=16) >= 4).all(), (i, j)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--rate", "0"), "--rate 0: must lie between"),
        (("--delay", "6"), "--delay 6: must lie between 0 and 5"),
        (("--sensor", "-1"), "--sensor -1: "),
        (("--kp", "1,2"), "--kp: takes one positive number, or 7 with commas"),
        (("--kc", "0"), "--kc: takes one positive number"),
        (("--kp", "a"), "'a' is not a number"),
        (("--friction", "1,2"), "--friction: takes one number from 0, or 7 with commas"),
        (("--friction", "-1"), "--friction: takes one number"),
        (("--friction", "absent.csv"), "absent.csv: is no table of 'stiffgen measure --friction'"),
        (("log.csv",), "log.csv: cannot be read"),
    ],
)
def test_refusals(robot_folder, tmp_path, monkeypatch, capsys, options, said):
    """Give options out of range: exit code 2, the option is named, and no file."""
    monkeypatch.chdir(tmp_path)
    try:
        code = main(["passport", str(robot_folder), *options])
    except SystemExit as ended:
        code = ended.code
    assert code == 2 and said in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"floating_base": True, "kernels": "hybrid.jacobian"}, "takes a fixed base"),
        ({"kernels": "limits"}, "has no function gravity_gradient"),
    ],
)
def test_a_robot_without_a_passport_is_refused(tmp_path, unoptimised, options, said):
    """Ask for the passport of a floating robot or one without gravity: refused with the reason."""
    robot = stiffgen.open_robot(stiffgen.generate(URDF, output=tmp_path, controller=False, build=False, **options))
    with pytest.raises(StiffgenError, match=said):
        make_passport(robot, PassportOptions())


@pytest.mark.slow
def test_friction_from_a_table(robot_folder, tmp_path, monkeypatch, capsys):
    """The table of 'measure --friction' gives the page of its numbers; that of another robot is refused."""
    monkeypatch.chdir(tmp_path)
    rows = [f"A{k},{k},0.1,{k},{k},{0.9 * k}" for k in range(1, 8)]
    head = "joint,friction,half_width_95,smallest,largest,coulomb_friction"
    (tmp_path / "log_friction.csv").write_text("\n".join([head, *rows]) + "\n")
    said = []
    for given in ("log_friction.csv", "1,2,3,4,5,6,7"):
        assert main(["passport", str(robot_folder), "--friction", given]) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1] and "Friction leaves the tip at most " in said[0]
    text = (tmp_path / "iiwa14_passport.html").read_text()
    assert ">rest error</td>" in text and ">force error</td>" in text and "every joint sticks" in text
    (tmp_path / "log_friction.csv").write_text("\n".join([head, *rows[:6]]) + "\n")
    assert main(["passport", str(robot_folder), "--friction", "log_friction.csv"]) == 2
    assert "has the joints A1" in capsys.readouterr().err


def test_without_matplotlib_the_extra_is_named(robot_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["passport", str(robot_folder)]) == 2
    assert install_command("analyze") in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_robot_without_effort_limits_has_one_map(robot):
    """Forces are left out; the map has one panel, and the page says nothing of forces."""
    passport = make_passport(robot, PassportOptions(), spread_postures(robot.chain, 5))
    kept = tuple(each for each in passport.quantities if not each.name.startswith("force "))
    both, alone = (render_page(each, motor_tables(robot.chain), "t.csv") for each in (
        passport, replace(passport, quantities=kept, force=None)))  # fmt: skip
    assert "force in every direction" in both and "Right: force" in both
    assert "force" not in alone.split("<h2>What")[0]


def test_a_quantity_that_is_the_same_everywhere_has_a_bar_with_distinct_labels(robot):
    passport = make_passport(robot, PassportOptions(), spread_postures(robot.chain, 5))
    assert np.ptp(passport.quantity("rendered").values) == 0
    labels = re.findall(r">(\d{4})</text>", render_page(passport, motor_tables(robot.chain), "t.csv"))
    assert "5000" in labels and len(labels) == len(set(labels)) > 1


def test_a_loop_that_is_not_stable_is_said(robot):
    """The page warns where the limit is below the rendered stiffness, and of little damping; else it does not."""
    passport = make_passport(robot, PassportOptions(), spread_postures(robot.chain, 5))
    assert warnings(passport) == []

    def changed(name, values):
        quantities = [replace(each, values=values) if each.name == name else each for each in passport.quantities]
        return replace(passport, quantities=tuple(quantities))

    lowered = np.where(np.arange(5) < 2, 1234.0, passport["limit"])
    (line,) = warnings(changed("limit", lowered))
    assert line.startswith("In 2 of 5 postures the loop is not stable") and line.endswith("1 230 N/m.")
    (line,) = warnings(changed("damping", np.full(5, 0.06)))
    assert line.startswith("The damping ratio falls to 0.06")


def test_joints_without_an_effort_limit_are_named(robot):
    """A limit of 0 said that the robot can exert no force; it says nothing now."""
    coordinates = [replace(robot.chain.coordinates[0], effort=np.inf), *robot.chain.coordinates[1:]]
    unlimited = replace(robot, chain=replace(robot.chain, coordinates=tuple(coordinates)))
    passport = make_passport(unlimited, PassportOptions(), q=np.full((2, 7), 0.5))
    assert passport.unlimited == ("A1",)
    sentence = "The robot's file states no effort limit of joint A1: {}."
    assert sentence.format("the forces leave them out") in statements(passport)
    assert sentence.format("no force limit follows") in statements(replace(passport, force=None))
    assert not any("effort limit" in line for line in statements(replace(passport, unlimited=())))
