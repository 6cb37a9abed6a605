# SPDX-License-Identifier: MIT
"""Limits that joints lack are named once by inspect, generate and new: file, element, joints, and what to do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stiffgen.cli import main
from support.chains import chain_urdf

SENTENCE = (
    'arm.urdf: no {limit} limit, which the impedance controller needs: add {limit}="..." to the <limit> of {joints} '
)


def arm(folder: Path, **removed: tuple[str, ...]) -> Path:
    """Write an arm without some limits: ``velocity=("j0",)`` leaves out the velocity of j0."""
    text = chain_urdf("rrr")
    for limit, joints in removed.items():
        for joint in joints:
            before, start, rest = text.partition(f'<joint name="{joint}"')
            text = before + start + re.sub(rf'(<limit[^>]*?) {limit}="[^"]*"', r"\1", rest, count=1)
    file = folder / "arm.urdf"
    file.write_text(text)
    return file


COMMANDS = {
    "inspect": ["inspect", "arm.urdf"],
    "generate": ["generate", "arm.urdf", "--no-build", "--name", "arm"],
    "new": ["new", "arm.urdf", "--no-build", "--name", "arm"],
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_named_by_every_command(command, tmp_path, monkeypatch, capsys) -> None:
    """Leave limits out of a URDF: each command names the joints, and where to write the limit."""
    arm(tmp_path, velocity=("j0", "j2"), effort=("j1",))
    monkeypatch.chdir(tmp_path)
    assert main(COMMANDS[command]) == 0
    out, err = capsys.readouterr()
    said = out if command == "inspect" else err
    for limit, joints, field in (
        ("velocity", "joints j0, j2", "velocity_limit"),
        ("effort", "joint j1", "effort_limit"),
    ):
        (line,) = (each for each in said.splitlines() if f"no {limit} limit" in each)
        assert SENTENCE.format(limit=limit, joints=joints) in line
        assert ("src/control.hpp" if command == "new" else field) in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "removed"),
    [(each, {}) for each in COMMANDS.values()]
    + [
        (["generate", "arm.urdf", "--no-build", "--no-controller"], {"velocity": ("j1",)}),
        (["new", "arm.urdf", "--no-build", "--controller", "spring"], {"velocity": ("j1",)}),
    ],
)
def test_nothing_is_said_without_a_reason(command, removed, tmp_path, monkeypatch, capsys) -> None:
    """State all limits, or leave the controller out: nothing is said."""
    arm(tmp_path, **removed)
    monkeypatch.chdir(tmp_path)
    assert main(command) == 0
    assert "limit, which" not in "".join(capsys.readouterr())


def test_a_limit_of_zero_is_none(tmp_path, monkeypatch, capsys) -> None:
    """Exporters write it; the controller refuses it as it refuses a missing one."""
    file = arm(tmp_path)
    file.write_text(re.sub(r' velocity="[^"]*"', ' velocity="0"', file.read_text(), count=1))
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "arm.urdf"]) == 0
    assert SENTENCE.format(limit="velocity", joints="joint j0") in capsys.readouterr().out
