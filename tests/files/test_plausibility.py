# SPDX-License-Identifier: MIT
"""Notes about units: each kind of number in a wrong unit, and none for numbers that are right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffgen import Sensor, Tool, load_chain
from stiffgen.cli import main
from stiffgen.core.errors import ChainError, DescriptionError
from stiffgen.files.plausibility import doubts
from support.chains import ARM, INERTIAL
from support.project import URDF

SOUND = ARM.replace('effort="5"', 'effort="50"')  # the slide carries its finger
HEAVY = INERTIAL.replace('mass value="2"', 'mass value="2000"')
LARGE = INERTIAL.replace("0.02", "20000").replace("0.03", "20000")
CASES = {
    "degrees": (('lower="-2" upper="2"', 'lower="-120" upper="120"'), "shoulder.*-120 to 120 rad: are these degrees"),
    "one limit in degrees": (('lower="-1"', 'lower="-90"'), "elbow.*-90 to 1 rad"),
    "one positive limit in degrees": (('upper="1"', 'upper="57.3"'), "elbow.*-1 to 57.3 rad: are these degrees"),
    "millimetres": (('upper="0.04"', 'upper="40"'), "grip.*0 to 40 m: are these millimetres"),
    "degrees per second": (('velocity="3"', 'velocity="180"'), "shoulder.*velocity limit 180 rad/s"),
    "degrees per second of the elbow": (('velocity="4"', 'velocity="114.6"'), "elbow.*114.6 rad/s: are these degrees"),
    "revolutions per minute": (('velocity="3"', 'velocity="28.6"'), "shoulder.*velocity limit 28.6 rad/s"),
    "millimetres per second": (('velocity="0.1"', 'velocity="100"'), "grip.*velocity limit 100 m/s"),
    "kg mm^2": ((INERTIAL, LARGE), "shoulder.*radius of gyration of 100 m.*kg mm"),
    "kg mm^2 of the finger": (
        (f'"finger">{INERTIAL}', f'"finger">{LARGE}'),
        "grip.*radius of gyration of 100 m.*kg mm",
    ),
    "kg cm^2": ((INERTIAL, INERTIAL.replace("0.0", "200.0")), "shoulder.*radius of gyration of .* m.*kg mm"),
    "grams": (
        (f'name="lower">{INERTIAL}', f'name="lower">{HEAVY}'),
        "gravity needs up to .* N m, above the effort limit 50 N m",
    ),
    "a link in millimetres": (('xyz="0.4 0 0"', 'xyz="400 0 0"'), "gravity needs up to"),
}


def replaced(old: str, new: str) -> str:
    assert old in SOUND
    return SOUND.replace(old, new, 1)


def said(tmp_path: Path, text: str, **options: object) -> list[str]:
    (tmp_path / "arm.urdf").write_text(text)
    return list(doubts(load_chain(tmp_path / "arm.urdf", **options)))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_unit_is_a_note_with_its_number(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, words = CASES[name]
    assert any(re.search(words, each) for each in said(tmp_path, replaced(*change)))
    assert main(["inspect", str(tmp_path / "arm.urdf")]) == 0
    assert re.search(words, capsys.readouterr().out)


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        (Tool(rpy=(180.0, 0.0, 0.0)), "rpy (180, 0, 0) rad is beyond a turn: are these degrees"),
        (Tool(rpy=(0.0, 0.0, -45.0)), "rpy (0, 0, -45) rad is beyond a turn: are these degrees"),
        (Tool(rpy=(0.0, 90.0, 0.0)), "rpy (0, 90, 0) rad is beyond a turn: are these degrees"),
        (Tool(xyz=(0.0, 0.0, 120.0)), "xyz (0, 0, 120) m is 120 m away: are these millimetres"),
        (Tool(mass=1.0, com=(0.0, 0.0, 50.0)), "com (0, 0, 50) m is 50 m away: are these millimetres"),
        (Tool(xyz=(-40.0, 0.0, 30.0)), "xyz (-40, 0, 30) m is 50 m away: are these millimetres"),
        (Tool(mass=7.5), "its mass, 7.5 kg, is above that of the moving links, 6 kg: are these grams"),
        (Tool(xyz=(0.0, 0.0, 0.1), mass=1200.0), "its mass, 1200 kg, is above that of the moving links, 6 kg"),
        (Tool(mass=850.0), "its mass, 850 kg, is above that of the moving links, 6 kg: are these grams"),
    ],
)
def test_tools_in_other_units(tool: Tool, words: str, tmp_path: Path) -> None:
    """Give tools in degrees, millimetres or grams: a note asks for the unit."""
    assert any(words in each for each in said(tmp_path, SOUND, tool=tool))


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (Sensor("hand", rpy=(0.0, 90.0, 0.0)), "sensor: rpy (0, 90, 0) rad is beyond a turn: are these degrees"),
        (Sensor("hand", xyz=(0.0, 0.0, 35.0)), "sensor: xyz (0, 0, 35) m is 35 m away: are these millimetres"),
    ],
)
def test_sensors_in_other_units(sensor: Sensor, words: str, tmp_path: Path) -> None:
    """Give sensors in degrees or millimetres: a note asks for the unit."""
    (found,) = said(tmp_path, SOUND, tip="hand", sensor=sensor)
    assert words in found


def test_right_numbers_are_not_doubted(tmp_path: Path) -> None:
    assert said(tmp_path, SOUND) == []
    assert said(tmp_path, SOUND, tool=Tool((0.0, 0.0, 0.2), (0.0, 1.6, 0.0), 0.5)) == []
    assert said(tmp_path, SOUND, masses=False) == []
    assert list(doubts(load_chain(URDF))) == []


def test_gravity_is_that_of_pinocchio(tmp_path: Path) -> None:
    """State an effort limit at Pinocchio's largest torque, and at half of it: only the latter is doubted."""
    (tmp_path / "arm.urdf").write_text(SOUND)
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    random, data = np.random.default_rng(3), model.createData()
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    torques = [pin.computeGeneralizedGravity(model, data, random.uniform(lower, upper)) for _ in range(2000)]
    largest = float(np.abs(torques)[:, 0].max())
    assert said(tmp_path, replaced('effort="50"', f'effort="{largest * 1.001}"')) == []
    (note,) = said(tmp_path, replaced('effort="50"', f'effort="{largest / 2}"'))
    assert "joint 'shoulder': gravity needs up to" in note


@pytest.mark.slow
def test_generate_and_new_print_the_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write limits in degrees: `generate` and `new` ask whether they are."""
    (tmp_path / "arm.urdf").write_text(replaced('lower="-2" upper="2"', 'lower="-120" upper="120"'))
    file, quiet = str(tmp_path / "arm.urdf"), ["--no-build", "--output"]
    assert main(["generate", file, "--no-controller", *quiet, str(tmp_path)]) == 0
    assert main(["new", file, *quiet, str(tmp_path / "project")]) == 0
    note = "note: arm.urdf: joint 'shoulder': limits -120 to 120 rad: are these degrees?"
    assert capsys.readouterr().err.count(note) == 2


def test_a_refused_inertia_names_its_unit(tmp_path: Path) -> None:
    """An impossible tensor in kg mm^2 is refused with the question that inspect asks of a possible one."""
    with pytest.raises(DescriptionError, match=r"radius of gyration would be 100 m: is it in kg mm\^2"):
        said(tmp_path, replaced(INERTIAL, INERTIAL.replace('ixx="0.02"', 'ixx="20000"')))
    with pytest.raises(DescriptionError, match=r"other two\); correct"):
        said(tmp_path, replaced(INERTIAL, INERTIAL.replace('ixx="0.02"', 'ixx="0.2"')))


def test_a_refused_lock_names_its_unit(tmp_path: Path) -> None:
    """Lock at degrees: the refusal asks, where the number in radians would be within the limits."""
    with pytest.raises(ChainError, match=r"limits are -2 to 2; is it in degrees\? 90 degrees are 1.5708 rad"):
        said(tmp_path, SOUND, lock={"shoulder": 90.0})
    for degrees, radians in ((30.0, "0.523599"), (-57.0, "-0.994838")):
        with pytest.raises(
            ChainError, match=rf"limits are -1 to 1; is it in degrees\? {degrees:g} degrees .* {radians} rad"
        ):
            said(tmp_path, SOUND, lock={"elbow": degrees})
    with pytest.raises(ChainError, match=r"limits are -2 to 2$"):
        said(tmp_path, SOUND, lock={"shoulder": 180.0})
    with pytest.raises(ChainError, match=r"limits are 0 to 0.04$"):
        said(tmp_path, SOUND, lock={"grip": 1.0})
