# SPDX-License-Identifier: MIT
"""Errors of the controller that follow from a wrong unit in the robot's file name the file's number."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stiffgen import load_chain
from stiffgen.control.page import errors_of
from support.chains import ARM, replaced

ERRORS = {
    "degrees per second": (('velocity="3"', 'velocity="1800"'), "velocity_limit: ", "shoulder.*limit 1800 rad/s"),
    "mm/s": (('velocity="0.1"', 'velocity="2000"'), "velocity_limit: ", "grip.*2000 m/s: are these mm/s"),
    "degrees": (('lower="-2" upper="2"', 'lower="90" upper="90"'), "lower_limit, upper_limit: ", "are these degrees"),
    "one limit in degrees": (('lower="-1"', 'lower="-90"'), "lower_limit: ", "elbow.*-90 to 1 rad: are these degrees"),
}  # fmt: skip


def errors(tmp_path: Path, text: str) -> list[str]:
    (tmp_path / "arm.urdf").write_text(text)
    return [words for _, _, words in errors_of("arm", load_chain(tmp_path / "arm.urdf"))]


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_names_the_number_that_causes_it(name: str, tmp_path: Path) -> None:
    """These are the texts of NAME_impedance_error_text in C and of ValueError in Python. Before, only inspect asked."""
    change, error, words = ERRORS[name]
    (text,) = [text for text in errors(tmp_path, replaced(change)) if text.startswith(error)]
    assert re.search(rf"; arm\.urdf: .*{words}", text)


def test_numbers_that_are_right_are_not_named(tmp_path: Path) -> None:
    assert not any("arm.urdf" in text for text in errors(tmp_path, ARM.replace('effort="5"', 'effort="50"')))
