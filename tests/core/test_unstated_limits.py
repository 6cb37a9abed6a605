# SPDX-License-Identifier: MIT
"""Limits of 0 and -1 in a file, which exporters write where they know none: not stated, for everything that reads."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.cli.survey import missing_limits
from stiffgen.control.page import config_of
from stiffgen.control.presets import motor_tables
from stiffgen.core.errors import DescriptionError
from stiffgen.core.loading import describe
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.rounding import with_more_digits
from stiffgen.families.rounding.bounds import ErrorBounds
from stiffgen.families.rounding.certified import within
from support.chains import ARM, replaced

ELBOW = 'effort="20" velocity="4"'


def written(folder: Path, text: str, version: str = "") -> Path:
    (folder / "arm.urdf").write_text(text.replace("<robot ", f'<robot version="{version}" ') if version else text)
    return folder / "arm.urdf"


def elbow(folder: Path, limits: str, version: str = "") -> Chain:
    return load_chain(written(folder, replaced((ELBOW, limits)), version), tip="hand")


@pytest.mark.parametrize("number", ["0", "0.0", "-0", "-1", "-1.0", " -1e0 "])
@pytest.mark.parametrize("key", ["effort", "velocity"])
def test_a_limit_that_is_not_stated_is_infinite(key: str, number: str, tmp_path: Path) -> None:
    """Write 0 or a negative limit: read as none, with a remark that names the joint."""
    other = {"effort": 'velocity="4"', "velocity": 'effort="20"'}[key]
    coordinate = elbow(tmp_path, f'{other} {key}="{number}"').coordinates[1]
    assert (coordinate.effort, coordinate.velocity) == ((math.inf, 4) if key == "effort" else (20, math.inf))
    (remark,) = describe(tmp_path / "arm.urdf").remarks
    assert f'1 joint has {key}="{float(number):g}" in <limit>, read as no limit: elbow; write the limit' in remark


def test_infinite_and_missing_limits_are_the_same(tmp_path: Path) -> None:
    chains = [elbow(tmp_path, limits) for limits in ("", 'effort="0" velocity="-1"', 'effort="inf" velocity="inf"')]
    assert chains[0].coordinates == chains[1].coordinates == chains[2].coordinates
    assert motor_tables(chains[0]) == motor_tables(chains[1])
    assert config_of(chains[0]) == config_of(chains[1])
    (velocity, effort) = missing_limits("arm.urdf", chains[1].coordinates)
    assert "no velocity limit" in velocity and "no effort limit" in effort and "joint elbow" in effort


@pytest.mark.parametrize("number", ["-2", "-20", "-1e-9", "-inf"])
def test_another_negative_number_is_refused_with_a_remedy_that_does_no_harm(number: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="is negative; write the joint's limit, or write 0 if it has none"):
        elbow(tmp_path, f'velocity="4" effort="{number}"')
    assert elbow(tmp_path, 'velocity="4" effort="0"').coordinates[1].effort == math.inf


@pytest.mark.parametrize("number", ["0", "-1"])
@pytest.mark.parametrize("key", ["effort", "velocity", "acceleration", "deceleration", "jerk"])
def test_urdf_1_2_refuses_them(key: str, number: str, tmp_path: Path) -> None:
    """There a joint without a limit has no attribute; the remedy, obeyed, is read."""
    limits = {"effort": "20", "velocity": "4"} | {key: number}
    stated = " ".join(f'{each}="{value}"' for each, value in limits.items())
    remedy = f"no limit in URDF 1.2; write the joint's limit, or remove {key}"
    with pytest.raises(DescriptionError, match=remedy):
        elbow(tmp_path, stated, "1.2")
    chain = elbow(tmp_path, stated.replace(f'{key}="{number}"', ""), "1.2")
    assert getattr(chain.coordinates[1], key) == math.inf
    before = elbow(tmp_path, stated, "1.1").coordinates[1]  # there the newer three are not read
    assert getattr(before, key) == math.inf


FINGERS = """<robot name="hand"><link name="palm"/><link name="a"/><link name="b"/>
<joint name="first" type="prismatic"><parent link="palm"/><child link="a"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" {}/></joint>
<joint name="second" type="prismatic"><parent link="palm"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" {}/><mimic joint="first" multiplier="-0.5" offset="0.02"/></joint></robot>"""


@pytest.mark.parametrize("unstated", ['effort="0" velocity="0"', 'effort="-1" velocity="-1"', ""])
def test_a_leader_without_limits_has_those_of_its_followers(unstated: str, tmp_path: Path) -> None:
    """Leave one finger's limits out: the other's count, through the multiplier 0.5 (30 N become 15 N)."""
    text = FINGERS.format(unstated, 'effort="30" velocity="0.1"')
    (first,) = load_chain(written(tmp_path, text), tip="a", masses=False).coordinates
    assert (first.effort, first.velocity) == (15, 0.2)
    text = FINGERS.format('effort="30" velocity="0.1"', unstated)
    (first,) = load_chain(written(tmp_path, text), tip="a", masses=False).coordinates
    assert (first.effort, first.velocity) == (30, 0.1)


@pytest.mark.parametrize("number", ["0", "-1", "inf"])
def test_rounding_bounds_hold_for_fast_joints_without_a_velocity_limit(number: str, tmp_path: Path) -> None:
    """Move an elbow at 30 rad/s without a velocity limit: bounds hold. Before, they held at rest alone."""
    text = replaced((ELBOW, 'effort="20" velocity="{0}"'), ('velocity="3"', 'velocity="{0}"'))
    chain = load_chain(written(tmp_path, text.format(number)), tip="hand")
    kernel = next(each for each in chain_kernels(chain) if each.qualified_name == "bias_forces")
    random = np.random.default_rng(3)
    pool = {
        "q": random.uniform([-2, -1], [2, 1], (200, 2)),
        "velocity": random.uniform(-1, 1, (200, 2)),
        "gravity": random.uniform(-10, 10, (200, 3)),
    }
    stacks = within(chain, kernel, Ranges(), DOUBLE, [pool[argument.name] for argument in kernel.arguments])
    rates = stacks[[argument.name for argument in kernel.arguments].index("velocity")]
    assert np.abs(rates).max(axis=0) == pytest.approx([30, 30])  # verify tries the ends of the stated ranges
    function = casadi_function(chain, kernel)
    values = [np.asarray(function(*state)).ravel() for state in zip(*stacks, strict=True)]
    error = np.abs(np.array(values) - with_more_digits(chain, kernel, stacks)).max()
    (bound,) = [each.bound for each in ErrorBounds(chain).stated(kernel)]
    assert error < bound
    at_rest = load_chain(written(tmp_path, text.format("1e-9")), tip="hand")
    (too_low,) = [each.bound for each in ErrorBounds(at_rest).stated(kernel)]
    assert error > too_low


def test_an_actuator_that_pushes_in_one_direction_states_no_effort(tmp_path: Path) -> None:
    """Give an actuator a range of 0 to 5: it states no effort limit, and a remark says so."""
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body name="a"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j"/>'
        '</body></worldbody><actuator><motor name="m" joint="j" ctrlrange="0 5"/></actuator></mujoco>'
    )
    assert load_chain(tmp_path / "arm.xml", tip="a").coordinates[0].effort == math.inf
    words = "1 joint without force in one direction or both, and without effort limit: j"
    assert words in describe(tmp_path / "arm.xml").remarks


def test_both_limits_of_the_robot_itself_stay(tmp_path: Path) -> None:
    coordinates = load_chain(written(tmp_path, ARM), tip="hand").coordinates
    assert [each.effort for each in coordinates] == [50, 20]
