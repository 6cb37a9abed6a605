# SPDX-License-Identifier: MIT
"""Robots of the campaign that builds wheels: by name, or from a file."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from campaigns import wheels
from support.project import ROOT


def test_a_name_is_that_of_the_table() -> None:
    assert wheels.robot("panda") == ("panda", wheels.ROBOTS["panda"])
    with pytest.raises(argparse.ArgumentTypeError, match=r"'ur9' is none of iiwa7, .*give NAME=FILE,TIP"):
        wheels.robot("ur9")


@pytest.mark.slow
def test_a_file_takes_the_place_of_a_download(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Give a file instead of the table's source: it is used, and its folder is where the builder looks."""
    file = ROOT / "tests" / "data" / "scara.urdf"
    assert wheels.robot(f"ur5e={file},tool0") == ("ur5e", (str(file), "--tip", "tool0"))
    own = wheels.robot(f"ur5e={file}")
    assert own == ("ur5e", (str(file),))
    assert list(wheels.generated([own], tmp_path)) == ["ur5e"], capsys.readouterr()
    assert (tmp_path / "ur5e" / "pyproject.toml").is_file()
    with pytest.raises(argparse.ArgumentTypeError, match=r"no file 'nowhere\.urdf'"):
        wheels.robot("ur5e=nowhere.urdf,tool0")
