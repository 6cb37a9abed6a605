# SPDX-License-Identifier: MIT
"""MJCF files that would block or fill MuJoCo's parser: one sentence within seconds."""

from __future__ import annotations

import os

import pytest

from stiffgen.cli import main
from stiffgen.core.errors import DescriptionError
from stiffgen.core.loading import describe
from stiffgen.core.robot.files import FileError
from stiffgen.files.repeats import MAX_COPIES, check_parts

pytest.importorskip("mujoco")
BODY = '<body name="b"><joint name="j"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{}</body>'
FILES = {
    "include of a pipe": '<include file="pipe"/>',
    "include of a device": '<include file="/dev/zero"/>',
    "include of a folder": '<include file="folder"/>',
    "pipe in an include": '<include file="part.xml"/>',
    "model of a pipe": '<asset><model name="m" file="pipe"/></asset>',
    "mesh that is a pipe": '<asset><mesh name="m" file="pipe"/></asset>',
    "mesh that is a pipe, by its folder": '<compiler meshdir="folder"/><asset><mesh name="m" file="pipe"/></asset>',
    "flexible mesh that is a pipe": '<worldbody><flexcomp name="f" type="mesh" file="pipe"/></worldbody>',
}
COUNTS = {
    "replicate": '<worldbody><replicate count="100000000" offset="1 0 0">{}</replicate></worldbody>',
    "replicate with an exponent": '<worldbody><replicate count="1e8" offset="1 0 0">{}</replicate></worldbody>',
    "nested": '<worldbody><replicate count="30"><replicate count="30">{}</replicate></replicate></worldbody>',
    "replicate of an include": '<worldbody><replicate count="30"><include file="copies.xml"/></replicate></worldbody>',
    "composite": '<worldbody><composite type="cable" count="9999999 1 1">{}</composite></worldbody>',
    "flexible grid": '<worldbody><flexcomp name="f" type="grid" count="400 400 400"/></worldbody>',
    "without end": '<worldbody><replicate count="1e400">{}</replicate></worldbody>',
}


@pytest.fixture
def folder(tmp_path):
    """Return a folder with pipes and with files that include or copy."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "folder" / "pipe")
    (tmp_path / "part.xml").write_text('<mujocoinclude><include file="pipe"/></mujocoinclude>')
    (tmp_path / "copies.xml").write_text(f'<mujocoinclude><replicate count="30">{BODY}</replicate></mujocoinclude>')
    return tmp_path


@pytest.mark.parametrize("kind", FILES)
def test_special_files_are_named(folder, kind):
    (folder / "m.xml").write_text(f"<mujoco>{FILES[kind]}</mujoco>")
    with pytest.raises(FileError, match="not a regular file"):
        check_parts(folder / "m.xml", 100)


@pytest.mark.parametrize("kind", COUNTS)
def test_many_copies_are_refused(folder, kind):
    (folder / "m.xml").write_text(f"<mujoco>{COUNTS[kind].format(BODY.format(''))}</mujoco>")
    with pytest.raises(FileError, match=f"more than ({MAX_COPIES}|{20 * MAX_COPIES}) copies"):
        check_parts(folder / "m.xml", 100)


@pytest.mark.parametrize("text", [FILES["include of a pipe"], COUNTS["replicate"].format(BODY.format(""))])
def test_the_refusal_is_one_sentence_within_seconds(folder, capsys, text):
    """Include a pipe or copy too often: refused in one line, within 5 s of processor time."""
    (folder / "m.xml").write_text(f"<mujoco>{text}</mujoco>")
    before = os.times()
    assert main(["inspect", str(folder / "m.xml")]) == 2
    after = os.times()
    assert capsys.readouterr().err.count("\n") == 1
    assert after.children_user + after.children_system - before.children_user - before.children_system < 5


def test_a_few_copies_and_missing_files_are_read(folder):
    """Copy a few times and name an absent mesh: read; a circle of includes is refused."""
    # The file itself, again; a circle of includes is MuJoCo's to refuse.
    text = BODY.format('<geom type="mesh" mesh="m"/><replicate count="3" offset="0 0 1"><site name="s"/></replicate>')
    (folder / "m.xml").write_text(
        f'<mujoco><asset><mesh name="m" file="absent.obj"/></asset><worldbody>{text}</worldbody></mujoco>')  # fmt: skip
    assert "j" in describe(folder / "m.xml").joints
    (folder / "m.xml").write_text('<mujoco><include file="m.xml"/></mujoco>')
    with pytest.raises(DescriptionError):
        describe(folder / "m.xml")
