# SPDX-License-Identifier: MIT
"""Joints with three coordinates and more: refused by name in every format, with a remedy that works."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import stiffgen
from stiffgen import StiffgenError
from stiffgen.cli import main

INERTIA = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
HINGE = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
URDF = f"""<robot name="arm"><link name="base"/><link name="upper">{INERTIA}</link><link name="fore">{INERTIA}</link>
<link name="hand">{INERTIA}</link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>{HINGE}</joint>
<joint name="elbow" type="TYPE"><parent link="upper"/><child link="fore"/>{HINGE}</joint>
<joint name="wrist" type="revolute"><parent link="fore"/><child link="hand"/>{HINGE}</joint></robot>"""
BODY = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'
MJCF = f"""<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" range="-1 1"/>{BODY}
<body name="fore"><joint name="elbow" type="TYPE"/>{BODY}
<body name="hand"><joint name="wrist" axis="0 1 0" range="-1 1"/>{BODY}</body></body></body></worldbody></mujoco>"""


def written(folder: Path, name: str, text: str) -> Path:
    file = folder / name
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("name", "kind", "tip", "words"),
    [
        (
            "arm.xml",
            "ball",
            "hand",
            r"arm\.xml: joint 'elbow' .* is ball, .*three hinges at one point, or .*base='fore'",
        ),
        ("arm.xml", "ball", "fore", r"joint 'elbow' between 'world' and 'fore' is ball, .*three hinges at one point$"),
        ("arm.urdf", "spherical", "hand", r"joint 'elbow' .*'spherical'.*three revolute joints at one point"),
        ("arm.urdf", "ball", "hand", r"joint 'elbow' .*'ball'.*three revolute joints at one point"),
        ("arm.urdf", "floating", "hand", r"joint 'elbow' .* is floating, .*choose a base behind it: base='fore'"),
        ("arm.urdf", "planar", "hand", r"joint 'elbow' .* is planar, .*choose a base behind it: base='fore'"),
    ],
)
def test_refused_by_name_with_a_remedy(name: str, kind: str, tip: str, words: str, tmp_path: Path) -> None:
    """Ask for a chain through a ball, floating or planar joint: refused with a remedy."""
    text = (URDF if name.endswith("urdf") else MJCF).replace("TYPE", kind)
    with pytest.raises(StiffgenError, match=words):
        stiffgen.load_chain(written(tmp_path, name, text), tip=tip)


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("arm.urdf", "spherical", r"'elbow' has the unknown type 'spherical'; .*; replace it by three revolute joints"),
        ("arm.urdf", "revolut", r"'elbow' has the unknown type 'revolut'; valid types: revolute, .*planar$"),
        ("arm.xml", "ball", r"'elbow' is ball .*; replace it by three hinges at one point; .* lock: shoulder, wrist$"),
        ("arm.urdf", "floating", r"'elbow' is floating .*; make it fixed; joints to lock: shoulder, wrist$"),
        ("arm.urdf", "planar", r"'elbow' is planar .*; make it fixed; joints to lock: shoulder, wrist$"),
        ("arm.urdf", "fixed", r"'elbow' is fixed and cannot be locked; joints to lock: shoulder, wrist$"),
    ],
)
def test_a_lock_names_the_type_of_the_file(
    name: str, kind: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Lock a joint that has no single position: exit code 2, its type as in the file, and a remedy."""
    text = (URDF if name.endswith("urdf") else MJCF).replace("TYPE", kind)
    command = ["generate", str(written(tmp_path, name, text)), "--tip", "hand", "--lock", "elbow=0"]
    assert main([*command, "--output", str(tmp_path / "generated")]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert re.match(rf"stiffgen: {name}: joint {words}", message), message
    assert not (tmp_path / "generated").exists()


@pytest.mark.parametrize(("name", "kind"), [("arm.xml", "ball"), ("arm.urdf", "floating"), ("arm.urdf", "planar")])
def test_the_base_of_the_remedy_is_accepted(name: str, kind: str, tmp_path: Path) -> None:
    text = (URDF if name.endswith("urdf") else MJCF).replace("TYPE", kind)
    chain = stiffgen.load_chain(written(tmp_path, name, text), tip="hand", base="fore")
    assert [coordinate.name for coordinate in chain.coordinates] == ["wrist"]


def test_three_hinges_at_one_point_are_accepted(tmp_path: Path) -> None:
    hinges = "".join(f'<joint name="elbow {a}" axis="{axis}" range="-1 1"/>' for a, axis in
                     (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")))  # fmt: skip
    file = written(tmp_path, "arm.xml", MJCF.replace('<joint name="elbow" type="TYPE"/>', hinges))
    assert len(stiffgen.load_chain(file, tip="hand").coordinates) == 5
