# SPDX-License-Identifier: MIT
"""docs/embedding.md's push in MuJoCo, with an MJCF file as Menagerie's in place of the download."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from support.pages import blocks
from support.project import ROOT


def panda(file: Path) -> Path:
    """Write the Panda as MJCF with Menagerie's names and rotors, and a position drive per joint."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "tests" / "data" / "panda.urdf"))
    spec.compiler.fusestatic = False
    for each in [*spec.equalities, *(joint for joint in spec.joints if "finger" in joint.name)]:
        spec.delete(each)
    for each in [*spec.bodies, *spec.joints]:
        each.name = each.name.removeprefix("panda_")
    for joint in spec.joints:
        joint.armature = 0.1
        spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_position(
            kp=2000
        )
    spec.compile()
    file.write_text(spec.to_xml())
    return file


@pytest.mark.slow
def test_the_tip_gives_way_and_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], unoptimised: None
) -> None:
    """Run the program on docs/embedding.md: a push moves the tip by 25 mm, and it comes back within 1 mm."""
    package = tmp_path / "robot_descriptions"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "panda_mj_description.py").write_text(f"MJCF_PATH = {str(panda(tmp_path / 'panda.xml'))!r}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "cache"))
    (block,) = (block for block in blocks(ROOT / "docs" / "embedding.md") if "mj_step" in block.code)
    assert block.code.count("\n") <= 30
    exec(compile(block.code, "embedding.md", "exec"), found := {})
    moved, left = map(float, re.findall(r"[\d.]+(?= mm)", capsys.readouterr().out))
    assert moved == pytest.approx(25, abs=1) and left < 1
    assert np.abs(found["moved"]).max() < 40 and (tmp_path / "push.svg").exists()
