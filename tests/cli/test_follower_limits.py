# SPDX-License-Identifier: MIT
"""Limits of coordinates that other joints follow, against the joints' own limits: sampled, and by MuJoCo's model."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stiffgen import load_chain, open_robot
from stiffgen.cli import main
from stiffgen.core.errors import ChainError, DescriptionError, LimitWarning
from stiffgen.core.robot.chain import UnusedLimits
from stiffgen.core.verify.folder.files import check_urdf
from support.chains import INERTIAL, child_of

LIMIT = 'lower="{0}" upper="{1}" velocity="{2}" effort="{3}"'


def lift(followers: list[tuple[str, str]], master: str = LIMIT.format(0, 0.4, 1, 100)) -> str:
    """Return a lift: joint x, and a joint for each (limit, mimic); the last follower is beside the path to the tip."""
    text = f'<robot name="lift"><link name="base"/><link name="l0">{INERTIAL}</link>{joint("x", "base", "l0", master)}'
    for k, (limit, mimic) in enumerate(followers):
        parent = f"l{k}" if k < len(followers) - 1 or k == 0 else "l0"
        text += f'<link name="l{k + 1}">{INERTIAL}</link>{joint(f"f{k}", parent, f"l{k + 1}", limit, mimic)}'
    return text + "</robot>"


def joint(name: str, parent: str, child: str, limit: str, mimic: str = "") -> str:
    return (
        f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
        f"<limit {limit}/>{f'<mimic {mimic}/>' if mimic else ''}</joint>"
    )


def within(text: str, x: float, rate: float = 0.0, force: float = 0.0) -> bool:
    """Return whether all joints are within their limits, where x has a position, a rate, and one joint its force."""
    joints = {str(each.get("name")): each for each in ET.fromstring(text).iter("joint")}

    def of(name: str) -> tuple[float, float]:
        mimic = joints[name].find("mimic")
        if mimic is None:
            return 1.0, 0.0
        rate, offset = of(str(mimic.get("joint")))
        multiplier = float(mimic.get("multiplier", 1))
        return multiplier * rate, multiplier * offset + float(mimic.get("offset", 0))

    for name, element in joints.items():
        limit = child_of(element, "limit").attrib
        multiplier, offset = of(name)
        position, speed = multiplier * x + offset, abs(multiplier * rate)
        load = abs(force / multiplier)  # at the same power
        if not float(limit["lower"]) - 1e-12 <= position <= float(limit["upper"]) + 1e-12:
            return False
        if speed > float(limit["velocity"]) + 1e-12 or load > float(limit["effort"]) + 1e-12:
            return False
    return True


LIFTS = {
    "offset": [(LIMIT.format(0, 0.1, 0.2, 30), 'joint="x" multiplier="0.5" offset="-0.02"')],
    "negative": [(LIMIT.format(-0.3, -0.05, 0.7, 500), 'joint="x" multiplier="-1.25" offset="0.1"')],
    "follower of a follower": [
        (LIMIT.format(-1, 1, 5, 90), 'joint="x" multiplier="2" offset="0.1"'),
        (LIMIT.format(-0.5, 0.35, 0.8, 20), 'joint="f0" multiplier="-0.5" offset="0.4"'),
    ],
    "two, one beside the path": [
        (LIMIT.format(-1, 0.3, 5, 300), 'joint="x" multiplier="1" offset="0"'),
        (LIMIT.format(0.05, 1, 0.1, 70), 'joint="x" multiplier="0.25" offset="0"'),
    ],
}


@pytest.mark.parametrize("masses", [True, False])
@pytest.mark.parametrize("name", LIFTS)
def test_the_range_is_where_every_joint_is_within_its_limits(name: str, masses: bool, tmp_path: Path) -> None:
    """Compare the limits of a coordinate with those that each following joint keeps, on a grid of 1e-3."""
    text = lift(LIFTS[name])
    (tmp_path / "lift.urdf").write_text(text)
    (x,) = load_chain(tmp_path / "lift.urdf", tip="l1", masses=masses).coordinates
    grid = np.linspace(-1, 1, 2001)
    inside = [value for value in grid if within(text, value)]
    assert (x.lower, x.upper) == pytest.approx((min(inside), max(inside)), abs=1.01e-3)
    middle = (x.lower + x.upper) / 2
    for bound, key in ((x.velocity, "rate"), (x.effort, "force")):
        assert within(text, middle, **{key: bound * (1 - 1e-9)})
        assert not within(text, middle, **{key: bound * (1 + 1e-9) + 1e-9})


@pytest.mark.parametrize("multiplier", [2, -0.5])
@pytest.mark.parametrize("name", ["acceleration", "deceleration", "jerk"])
def test_derivatives_of_the_rate_are_those_of_both_joints(name: str, multiplier: float, tmp_path: Path) -> None:
    """Compare accelerations at the bound: the slower of two joints is at its own limit; an infinite one is none."""
    for own, follower, expected in ((9, 4, min(9, 4 / abs(multiplier))), (9, "inf", 9), (1, 40, 1)):
        limits = [f'{LIMIT.format(-1, 1, 5, 90)} {name}="{each}"' for each in (own, follower)]
        text = lift([(limits[1], f'joint="x" multiplier="{multiplier}" offset="0"')], limits[0])
        (tmp_path / "lift.urdf").write_text(text.replace("<robot ", '<robot version="1.2" '))
        (x,) = load_chain(tmp_path / "lift.urdf", tip="l1").coordinates
        assert getattr(x, name) == expected


def test_a_follower_without_limits_narrows_nothing(tmp_path: Path) -> None:
    """Exporters write zeros, or infinite numbers, for no limit."""
    for limit in (LIMIT.format(0, 0, 0, 0), LIMIT.format("-inf", "inf", "inf", "inf"), 'effort="0" velocity="0"'):
        (tmp_path / "lift.urdf").write_text(lift([(limit, 'joint="x" multiplier="-2" offset="0.1"')]))
        (x,) = load_chain(tmp_path / "lift.urdf", tip="l1").coordinates
        assert (x.lower, x.upper, x.velocity, x.effort) == (0, 0.4, 1, 100)


def test_half_open_ranges(tmp_path: Path) -> None:
    for multiplier, limit, expected in ((-2, ("-inf", 0.0), (0.05, 0.4)), (-2, (-0.5, "inf"), (0.0, 0.3))):
        text = lift([(LIMIT.format(*limit, 9, 900), f'joint="x" multiplier="{multiplier}" offset="0.1"')])
        (tmp_path / "lift.urdf").write_text(text)
        (x,) = load_chain(tmp_path / "lift.urdf", tip="l1").coordinates
        assert (x.lower, x.upper) == expected


Follower = tuple[float, float, float, float]
EXCLUDED: dict[str, tuple[list[Follower], list[str], list[str]]] = {
    "beyond the range": ([(1, 2, 0.5, 0)], ["'f0' with 1 to 2, which needs 2 to 4"], []),
    "a mirrored finger": ([(0, 0.4, -1, 0)], ["'f0' with 0 to 0.4, which needs -0.4 to 0"], []),
    "two together": (
        [(0, 0.1, 1, 0), (0.2, 0.4, 1, 0)],
        ["'f0' with 0 to 0.1, which needs 0 to 0.1; 'f1' with 0.2 to 0.4, which needs 0.2 to 0.4"],
        [],
    ),
    "one of two": ([(0, 0.2, 1, 0), (1, 1.5, 1, 0.1)], ["'f1' with 1 to 1.5, which needs 0.9 to 1.4"], ["'f0'"]),
    "six": ([(1, 2, 1, 0)] * 6, ["'f3' with 1 to 2, which needs 1 to 2 and 2 more"], ["'f4'"]),
}
"""Limits, multiplier and offset of each follower; words of the warning; words that it lacks."""


def excluded(name: str, folder: Path) -> Path:
    """Write a lift whose followers leave no range, with velocity limits 0.5 m/s and effort limits 30 N."""
    text = lift(
        [
            (LIMIT.format(lower, upper, 0.5, 30), f'joint="x" multiplier="{multiplier}" offset="{offset}"')
            for lower, upper, multiplier, offset in EXCLUDED[name][0]
        ]
    )
    (folder / "lift.urdf").write_text(text)
    return folder / "lift.urdf"


@pytest.mark.parametrize("name", EXCLUDED)
def test_limits_that_exclude_each_other_leave_the_coordinate_its_own(name: str, tmp_path: Path) -> None:
    """Give limits that exclude each other: a warning with joints, numbers and remedy; velocity and effort still
    count.
    """
    followers, words, others = EXCLUDED[name]
    with pytest.warns(LimitWarning) as warned:
        chain = load_chain(excluded(name, tmp_path), tip="l1")
    (x,) = chain.coordinates
    rates = [abs(multiplier) for *_, multiplier, _ in followers]
    assert (x.lower, x.upper) == (0, 0.4)
    assert (x.velocity, x.effort) == (min(1, 0.5 / max(rates)), min(100, 30 * min(rates)))
    (said,) = (str(each.message) for each in warned if each.category is LimitWarning)
    assert said.startswith("lift.urdf: joint 'x' keeps its own position limits 0 to 0.4, since ")
    assert all(word in said for word in [*words, "; correct these limits or the relation of the joints, or set"])
    assert not any(word in said for word in others)


def test_a_range_of_one_point_of_the_coordinate_is_kept(tmp_path: Path) -> None:
    """Exporters write it for no limit; a follower that excludes it leaves no range turned around (1 above 0)."""
    text = lift([(LIMIT.format(1, 2, 1, 1), 'joint="x" multiplier="1" offset="0"')], LIMIT.format(0, 0, 1, 100))
    (tmp_path / "lift.urdf").write_text(text)
    with pytest.warns(LimitWarning, match="keeps its own position limits 0 to 0, "):
        (x,) = load_chain(tmp_path / "lift.urdf", tip="l1").coordinates
    assert (x.lower, x.upper) == (0, 0)


@pytest.mark.usefixtures("unoptimised")
def test_the_folder_says_whose_limits_are_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Command line, header, README, manifest and inspect; none states narrowed positions."""
    file = str(excluded("one of two", tmp_path))
    words = ["--tip", "l1", "--no-build", "--output", str(tmp_path / "out")]
    assert main(["generate", file, *words]) == 0
    assert "warning: lift.urdf: joint 'x' keeps its own position limits 0 to 0.4" in capsys.readouterr().err
    folder = tmp_path / "out" / "lift"
    fault = "'f1' with 1 to 1.5, which needs 0.9 to 1.4"
    for text in ("lift.h", "README.md"):
        assert f"The position limits of x are its own{'.' if text == 'lift.h' else ':'}" in (folder / text).read_text()
        assert fault in (folder / text).read_text()
    chain = open_robot(folder).chain
    assert chain.unused_limits == (UnusedLimits("x", fault),)
    assert (chain.coordinates[0].lower, chain.coordinates[0].upper) == (0, 0.4)
    with pytest.warns(LimitWarning):
        assert check_urdf(chain, Path(file)).passed
    assert main(["inspect", file, "--tip", "l1"]) == 0
    shown = capsys.readouterr().out
    assert "joint 'x' keeps its own position limits 0 to 0.4" in shown and fault in shown
    assert "joint 'x', with the limits of joints that follow it (f0, f1): velocity 0.5, effort 30\n" in shown


def test_a_lock_keeps_followers_within_their_limits(tmp_path: Path) -> None:
    arm = joint("arm", "l1", "tip", LIMIT.format(-1, 1, 1, 1))
    text = lift(LIFTS["offset"]).replace("</robot>", f'<link name="tip">{INERTIAL}</link>{arm}</robot>')
    (tmp_path / "lift.urdf").write_text(text)
    assert load_chain(tmp_path / "lift.urdf", lock={"x": 0.1}).dof == 1
    with pytest.raises(ChainError, match=r"cannot be locked at 0; its limits \(with .* follow it\) are 0.04 to 0.24"):
        load_chain(tmp_path / "lift.urdf", lock={"x": 0.0})


def test_a_faulty_limit_of_a_follower_refuses_the_chain(tmp_path: Path) -> None:
    """The limits of a follower are those of the coordinate, also where the follower is beside the path."""
    text = lift(LIFTS["two, one beside the path"]).replace('lower="0.05"', 'lower="five"')
    (tmp_path / "lift.urdf").write_text(text)
    for masses in (True, False):
        with pytest.raises(DescriptionError, match=r"joint 'f1'.*'five'"):
            load_chain(tmp_path / "lift.urdf", tip="l1", masses=masses)


def test_inspect_names_the_narrowed_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lift.urdf").write_text(lift(LIFTS["offset"]))
    assert main(["inspect", str(tmp_path / "lift.urdf")]) == 0
    said = "joint 'x', with the limits of joints that follow it (f0): position 0.04 to 0.24, velocity 0.4, effort 15"
    assert said in capsys.readouterr().out


HAND = """<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="a" range="-1 2"/>
<geom size="0.1"/><body name="b" pos="0 0 0.2"><joint name="b" axis="0 1 0" range="-0.3 0.5" ref="0.1"
actuatorfrcrange="-4 4"/><geom size="0.1"/><body name="c" pos="0 0 0.2"><joint name="c" {}/>
<geom size="0.1"/></body></body></body></worldbody>
<equality><joint joint1="b" joint2="a" polycoef="0.05 -0.7 0 0 0"/><joint joint1="c" joint2="a" polycoef="{} 0 0 0"/>
</equality></mujoco>"""
FINGERS = {  # joint c, its relation to a, and what inspect says
    "two turn": ('axis="0 1 0" range="-0.2 0.9"', "0 0.4", "position -0.5 to 0.642857, effort 2.8"),
    "one slides": (
        'type="slide" range="-0.02 0.05" actuatorfrcrange="-30 30"',
        "0.01 0.05",
        "position -0.5 to 0.642857, effort 1.5",
    ),
    "one without a range": ('axis="1 0 0"', "0.3 -2", "position -0.5 to 0.642857, effort 2.8"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FINGERS)
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_followers_of_an_mjcf_file(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare a follower's range with MuJoCo's relation, q_b - ref_b = 0.05 - 0.7 (q_a - ref_a)."""
    joint_c, relation, words = FINGERS[name]
    text = HAND.format(joint_c, relation)
    (tmp_path / "hand.xml").write_text(text)
    (a,) = load_chain(tmp_path / "hand.xml").coordinates
    model = mujoco.MjModel.from_xml_string(text)
    inside = []
    for q in np.linspace(-1.5, 2.5, 4001):
        followers = [start + rate * q for start, rate in model.eq_data[:, :2]]
        positions = [q, *(model.qpos0[1:] + followers)]
        bounded = zip(positions, model.jnt_range, model.jnt_limited, strict=True)
        if all(low <= p <= high for p, (low, high), is_limited in bounded if is_limited):
            inside.append(q)
    assert (a.lower, a.upper) == pytest.approx((min(inside), max(inside)), abs=1.01e-3)
    forces = [
        abs(rate) * limits[1]
        for rate, limits, limited in zip(
            [1, *model.eq_data[:, 1]], model.jnt_actfrcrange, model.jnt_actfrclimited, strict=True
        )
        if limited
    ]
    assert a.effort == pytest.approx(min(forces))
    assert math.isinf(a.velocity)
    assert main(["inspect", str(tmp_path / "hand.xml")]) == 0
    (line,) = (each for each in capsys.readouterr().out.splitlines() if "that follow it" in each)
    assert line.endswith(f"(b, c): {words}")
