# SPDX-License-Identifier: MIT
"""Values that Python gives for options: numbers of NumPy are numbers, and everything else ends as a StiffgenError."""

from __future__ import annotations

import json
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.core.errors import OptionError, RecordingError, StiffgenError
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import Chain
from stiffgen.lab.calibrate.calibration import Calibration, read_calibration
from support.chains import ARM


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(ARM)
    return tmp_path / "arm.urdf"


LOCK = 0.25
NUMBERS: dict[str, Any] = {
    "a double": np.float64(LOCK),
    "a float": np.float32(LOCK),
    "a half": np.float16(LOCK),
    "a long double": np.longdouble(LOCK),
    "of an array": np.array([LOCK, 1.0])[0],
    "an array without axes": np.array(LOCK),
    "a fraction": Fraction(1, 4),
    "a decimal": Decimal("0.25"),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_other_kinds_are_numbers(name: str, arm: Path) -> None:
    """Pass numbers of other types: the chain is that of Python's float, to its representation."""
    value = NUMBERS[name]
    tools = [stiffgen.Tool(xyz=(0, 0, x), mass=x, com=(x, 0.0, 0.0), inertia=(x, 0, 0, x, 0, x)) for x in (LOCK, value)]
    sensors = [stiffgen.Sensor("hand", xyz=(0.0, 0.0, x), gravity=(0.0, 0.0, x)) for x in (LOCK, value)]
    chains = [
        stiffgen.load_chain(arm, tip="hand", lock={"elbow": x}, tool=tool, sensor=sensor)
        for x, tool, sensor in zip((LOCK, value), tools, sensors, strict=True)
    ]
    assert chains[0] == chains[1]
    assert repr(chains[0]) == repr(chains[1])
    assert stiffgen.Placement(centre=(0.0, 0.0, value)) == stiffgen.Placement(centre=(0.0, 0.0, LOCK))
    assert repr(Ranges(force=value)) == repr(Ranges(force=LOCK))


def test_arrays_are_vectors(arm: Path) -> None:
    tensor = np.array([0.1, 0, 0, 0.1, 0, 0.1])
    array = stiffgen.Tool(np.zeros(3), np.array([0, 0, 1]), np.int64(2), np.array([0, 0, 0.1], np.float32), tensor)
    plain = stiffgen.Tool((0.0, 0.0, 0.0), (0, 0, 1), 2, (0, 0, float(np.float32(0.1))), (0.1, 0, 0, 0.1, 0, 0.1))
    assert array == plain and hash(array) == hash(plain)
    assert stiffgen.load_chain(arm, tip="hand", tool=array) == stiffgen.load_chain(arm, tip="hand", tool=plain)
    assert stiffgen.Placement(centre=np.zeros(3)).centre == (0.0, 0.0, 0.0)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "text for a position": ({"lock": {"elbow": "0.3"}}, "locked at '0.3'; give a number"),
    "nothing": ({"lock": {"elbow": None}}, "locked at None; give a number"),
    "a complex number": ({"lock": {"elbow": 1j}}, "locked at 1j; give a number"),
    "two positions": ({"lock": {"elbow": np.zeros(2)}}, r"locked at \(0.0, 0.0\); give a number"),
    "no float has": ({"lock": {"elbow": 10**400}}, r"locked at 10+\.\.\.; give a number"),
    "a list": ({"lock": ["elbow=0.3"]}, r"^lock=\.\.\.: takes a dict"),
    "a number for a joint": ({"lock": {2: 0.3}}, r"^lock=\.\.\.: takes a dict"),
    "a mass of text": ({"tool": stiffgen.Tool(mass="2")}, r"tool=Tool\(mass=\.\.\.\) takes a number"),  # type: ignore[arg-type]
    "no mass": ({"tool": stiffgen.Tool(mass=None)}, r"tool=Tool\(mass=\.\.\.\) takes a number"),  # type: ignore[arg-type]
    "a matrix": ({"tool": stiffgen.Tool(mass=1, inertia=np.eye(3))}, r"inertia=\.\.\.\) takes 6 numbers"),  # type: ignore[arg-type]
    "two numbers": ({"tool": stiffgen.Tool(xyz=(1, 2))}, r"Tool\(xyz=\.\.\.\) takes 3 numbers, not \(1, 2\)"),  # type: ignore[arg-type]
    "a dict": ({"tool": {"mass": 1}}, r"^tool=\.\.\.: takes a record stiffgen.Tool"),
    "a link for a sensor": ({"sensor": "hand"}, r"^sensor=\.\.\.: takes a record stiffgen.Sensor"),
    "no place": ({"sensor": stiffgen.Sensor("hand", xyz=None)}, "must be three finite numbers"),  # type: ignore[arg-type]
    "a number for a tip": ({"tip": 3}, r"^tip=\.\.\.: takes a word or several, not 3"),
    "nothing among tips": ({"tip": [None]}, r"^tip=\.\.\.: takes words, not None"),
    "a number for a folder": ({"package_path": [3]}, r"^package_path=\.\.\.: takes a path"),
    "a folder too long": ({"package_path": "p" * 300}, "does not exist"),
    "an unknown option": ({"tipp": "hand"}, r"^load_chain\(\) has no option tipp=\.\.\.; did you mean tip="),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_values_are_refused_by_the_options_name(name: str, arm: Path) -> None:
    options, words = REFUSED[name]
    with pytest.raises(StiffgenError, match=words):
        stiffgen.load_chain(arm, **{"tip": "hand"} | options)


def test_options_of_generation(arm: Path, tmp_path: Path) -> None:
    """Pass options of wrong type or spelling: refused with the one that was meant."""
    cases: list[tuple[dict[str, Any], str]] = [
        ({"spring": "bounded"}, r"generate\(\) has no option spring=\.\.\.; did you mean springs="),
        ({"springs": "bouned"}, "there is no spring 'bouned'"),
        ({"springs": 3}, r"springs=\.\.\.: takes a word"),
        ({"potentials": "own.py:bowl"}, r"potentials=\.\.\.: takes what .*read_potential"),
        ({"placement": "base"}, r"placement=\.\.\.: takes a record stiffgen.Placement"),
        ({"ranges": {"force": 3}}, r"ranges=\.\.\.: takes a record .*Ranges"),
        ({"output": tmp_path / "a\0b"}, r"output=\.\.\.: .*NUL byte"),
        ({"output": None}, r"output=\.\.\.: takes a path"),
    ]
    for options, words in cases:
        with pytest.raises(StiffgenError, match=words):
            stiffgen.generate(arm, **{"output": tmp_path, "build": False} | options)
    with pytest.raises(OptionError, match=r"load\(\) has no option spring=\.\.\.; did you mean springs="):
        stiffgen.load(arm, spring="bounded")
    assert issubclass(OptionError, TypeError)  # as Python's own error of an unknown keyword
    assert GenerationOptions(springs="bounded").springs == ("bounded",)


@pytest.mark.parametrize(
    "source", ["a" * 300, "a" * 5000, "a" * 300 + ".urdf", "a\0b", "a\0.urdf", "a\ud800", "", None, 3, b"a"]
)
def test_names_that_no_file_has(source: Any) -> None:
    for call in (stiffgen.load_chain, stiffgen.load, stiffgen.open_robot):
        with pytest.raises(StiffgenError):
            call(source)


def test_a_calibration_with_endless_numbers(tmp_path: Path) -> None:
    """Read calibrations with infinite, NaN or absurd values: refused, without an overflow."""
    zeros: dict[str, Any] = {
        "bias": 6, "payload": 4, "bias_interval": 6, "payload_interval": 4, "drift": 6, "noise": 6, "rotation": 3,
        "rotation_interval": 3,
    }  # fmt: skip
    record = Calibration("arm", "hand", poses=9, **{name: (0.0,) * size for name, size in zeros.items()})
    file = tmp_path / "calibration.json"
    for value in ("1e400", "-1e400", "NaN", "[]", '"nine"', "1e999999999"):
        file.write_text(record.to_json().replace('"poses": 9', f'"poses": {value}'))
        with pytest.raises(RecordingError, match="is no calibration"):
            read_calibration(file)
    for name in zeros:
        content = json.loads(record.to_json())
        file.write_text(json.dumps(content | {name: [10**400] * zeros[name]}))
        with pytest.raises(RecordingError, match="is no calibration"):
            read_calibration(file)


def test_the_chain_of_an_arm_is_read(arm: Path) -> None:
    assert isinstance(stiffgen.load_chain(str(arm), tip="hand"), Chain)
