# SPDX-License-Identifier: MIT
"""A damaged or hostile manifest.json: one message, whatever stands in it."""

from __future__ import annotations

import json

import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.cli import main
from stiffgen.core.errors import OutputError
from support.project import URDF

HUGE = int("1" + 400 * "0")


def changed(content, *path, value):
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return json.dumps(content)


HOSTILE = {
    "nested": lambda content: "[" * 100_000,
    "nested in an object": lambda content: '{"generator": "stiffgen", "files": {}, "a": ' + "[" * 100_000,
    "limit": lambda content: changed(content, "chain", "coordinates", 0, "lower", value=HUGE),
    "rotation": lambda content: changed(content, "chain", "joints", 0, "rotation", value=[HUGE] * 9),
    "axis": lambda content: changed(content, "chain", "joints", 0, "axis", value={"x": 1}),
    "mass": lambda content: changed(content, "chain", "joints", 0, "body", "mass", value="\x1b[31m"),
    "scalar": lambda content: changed(content, "scalar", value=["double"]),
    "name": lambda content: changed(content, "name", value=5),
    "coordinate": lambda content: changed(content, "chain", "coordinates", 0, "name", value=7),
    "joints": lambda content: changed(content, "chain", "joints", value=None),
    "tips": lambda content: changed(content, "chain", "tips", value="abc"),
    "springs": lambda content: changed(content, "springs", value=[1]),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return stiffgen.generate(URDF, output=tmp_path_factory.mktemp("manifest"), build=False)


@pytest.fixture
def manifest(folder):
    file = folder / "manifest.json"
    content = file.read_text()
    yield file
    file.unlink()
    file.write_text(content)


@pytest.mark.slow
@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_manifests(case, folder, manifest, capsys):
    """Open a hostile manifest: exit code 2, a short message without escape codes, and no traceback."""
    manifest.write_text(HOSTILE[case](json.loads(manifest.read_text())))
    assert main(["play", str(folder)]) == 2
    err = capsys.readouterr().err
    assert "manifest.json" in err and "Traceback" not in err
    assert "generate" in err and len(err) < 1000 and "\x1b" not in err


@pytest.mark.slow
def test_a_manifest_without_an_end(folder, manifest):
    """A link to a device that can be read for ever."""
    manifest.unlink()
    manifest.symlink_to("/dev/zero")
    with pytest.raises(OutputError, match="no readable"):
        open_robot(folder)


@pytest.mark.slow
def test_generate_over_a_damaged_manifest(folder, manifest):
    """What cannot be compared is of another version, and is replaced."""
    for case in ("limit", "coordinate"):
        manifest.write_text(HOSTILE[case](json.loads(manifest.read_text())))
        assert stiffgen.generate(URDF, output=folder.parent, build=False) == folder
