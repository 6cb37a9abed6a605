# SPDX-License-Identifier: MIT
"""Labels of the joints' sliders: what all names share is left out, what differs is shown."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib.resources import as_file, files
from pathlib import Path

import pytest

from stiffgen.lab.play.page import SCRIPTS
from support.project import require_program

SCRIPT = (
    'import { distinct } from "./panels.js";\nconsole.log(JSON.stringify(distinct(JSON.parse(process.argv[2]))));\n'
)


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (["panda_joint1", "panda_joint2"], ["joint1", "joint2"]),
        (["lbr_joint_a1", "lbr_joint_a2"], ["a1", "a2"]),
        (["shoulder_pan_joint", "elbow_joint"], ["shoulder_pan", "elbow"]),
        (["A1", "A2"], ["A1", "A2"]),
        (["only_one"], ["only_one"]),
        (["arm", "arm_2"], ["arm", "arm_2"]),
        (["FL_HAA", "FL_KFE", "FR_HAA"], ["FL_HAA", "FL_KFE", "FR_HAA"]),
        (["same_1_x", "same_1_x"], ["x", "x"]),
    ],
)
def test_what_names_share_is_left_out(names: list[str], shown: list[str], tmp_path: Path) -> None:
    """Shorten the joints' names: what all share is left out."""
    for file in SCRIPTS:
        with as_file(files("stiffgen.lab.play") / "page" / file) as source:
            shutil.copyfile(source, tmp_path / file)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "labels.js").write_text(SCRIPT)
    command = [require_program("node", "nodejs"), "labels.js", json.dumps(names)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == shown
