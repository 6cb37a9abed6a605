# SPDX-License-Identifier: MIT
"""A folder of another source is not replaced unless asked for: robots whose names become one identifier."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import OutputError
from support.chains import chain_urdf

PAIRS = {
    "another alphabet": ("左臂", "右臂"),
    "Cyrillic": ("левая рука", "правая рука"),
    "equal first 40 characters": ("a" * 40 + "_left", "a" * 40 + "_right"),
    "accents and signs": ("arm+", "arm-"),
}
SMALL = {"kernels": "hybrid.jacobian", "controller": False, "masses": False, "build": False}


def written(file: Path, name: str, length: str = "0.3") -> Path:
    """Write a robot of two joints; ``length`` is the height of each joint above the joint before it [m]."""
    file.parent.mkdir(exist_ok=True)
    text = chain_urdf("rr").replace('name="chain"', f'name="{name}"').replace("-0.02 0.3", f"-0.02 {length}")
    file.write_text(text, encoding="utf-8")
    return file


def contents(folder: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("names", PAIRS.values(), ids=PAIRS)
@pytest.mark.parametrize("files", [("left.urdf", "right.urdf"), ("left/arm.urdf", "right/arm.urdf")])
def test_robots_whose_names_become_one(names, files, tmp_path, capsys):
    """Generate two robots whose names become one identifier: refused without --name, --output or force."""
    left, right = (written(tmp_path / file, name) for file, name in zip(files, names, strict=True))
    folder = stiffgen.generate(left, output=tmp_path / "out", **SMALL)
    before = contents(folder)
    words = ["--no-build", "--no-controller", "--no-masses", "--output", str(tmp_path / "out")]
    assert main(["generate", str(right), *words]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert f"holds another robot (robot {names[0]} would become {names[1]}" in error
    assert "remove it first" in error and "another --name or --output" in error
    assert contents(folder) == before
    assert stiffgen.generate(right, output=tmp_path / "out", name="other", **SMALL).name == "other"
    assert stiffgen.generate(right, output=tmp_path / "out", force=True, **SMALL) == folder
    assert contents(folder) != before


def test_files_of_one_name_of_robot(tmp_path):
    """Generate two files whose robots have one name: refused; a file renamed or edited is the same source."""
    first, second = written(tmp_path / "first.urdf", "arm"), written(tmp_path / "second.urdf", "arm", "0.7")
    folder = stiffgen.generate(first, output=tmp_path, **SMALL)
    with pytest.raises(OutputError, match=r"\(file first\.urdf would become second\.urdf\)"):
        stiffgen.generate(second, output=tmp_path, **SMALL)
    written(first, "arm", "0.8")
    assert stiffgen.generate(first, output=tmp_path, **SMALL) == folder
    renamed = first.rename(tmp_path / "renamed.urdf")
    assert stiffgen.generate(renamed, output=tmp_path, **SMALL) == folder


def test_arguments_of_one_template(tmp_path):
    """Generate a template with another argument into the same folder: refused; the same argument again is taken."""
    pytest.importorskip("xacrodoc")
    text = chain_urdf("rr").replace("-0.02 0.3", "-0.02 $(arg length)", 1)
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="chain"><xacro:arg name="length" default="0.3"/>'
    template = tmp_path / "arm.urdf.xacro"
    template.write_text(text.replace('<robot name="chain">', head))
    stiffgen.generate(template, output=tmp_path, arguments={"length": "0.4"}, **SMALL)
    match = r"\(arguments of the template length:=0\.4 would become length:=0\.5\)"
    with pytest.raises(OutputError, match=match):
        stiffgen.generate(template, output=tmp_path, arguments={"length": "0.5"}, **SMALL)
    stiffgen.generate(template, output=tmp_path, arguments={"length": "0.4"}, **SMALL)


def test_a_folder_of_another_version_keeps_its_source(tmp_path):
    """Read a manifest of another version, and one with damaged records: the source stays known."""
    left, right = written(tmp_path / "left.urdf", "left+"), written(tmp_path / "right.urdf", "left-")
    folder = stiffgen.generate(left, output=tmp_path, **SMALL)
    manifest = folder / "manifest.json"
    text = manifest.read_text()
    manifest.write_text(text.replace('"massless"', '"light"'))
    with pytest.raises(OutputError, match="holds another robot"):
        stiffgen.generate(right, output=tmp_path, **SMALL)
    manifest.write_text(text.replace('"urdf": {', '"urdf": 3, "was": {'))
    assert stiffgen.generate(right, output=tmp_path, **SMALL) == folder
