# SPDX-License-Identifier: MIT
"""Folders that hold a part of what a robot can have: --kernels, --no-batches, --no-controller, --no-python."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.control.companions import COMPANIONS
from stiffgen.control.page import called_kernels
from stiffgen.core.errors import ChainError, OutputError
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.verify import verify
from support.c_program import STRICT
from support.chains import chain_urdf
from support.exact_linkage import random_linkage
from support.project import ROOT, URDF, require_compiler

SMALL = {"batches": False, "controller": False, "masses": False, "python": False}


def test_smallest_useful_folder_has_850_lines_of_c(tmp_path: Path) -> None:
    """Count the lines of C of the smallest folder, as a page states them."""
    chosen = ["hybrid.joint_stiffness", "hybrid.jacobian"]
    folder = stiffgen.generate(URDF, output=tmp_path, kernels=chosen, **SMALL)
    assert {file.name for file in folder.iterdir()} == {
        "iiwa14.h", "iiwa14.c", "iiwa14_lanes.h", "iiwa14.hpp", "CMakeLists.txt", "README.md", "manifest.json",
    }  # fmt: skip
    sources = [file for file in folder.iterdir() if file.suffix in (".c", ".h")]
    assert sum(len(file.read_text().splitlines()) for file in sources) <= 850
    command = [require_compiler("gcc"), "-std=c99", "-O1", *STRICT, "-c", folder / "iiwa14.c", "-o", tmp_path / "o"]
    subprocess.run(command, check=True)
    robot = stiffgen.open_robot(folder)
    assert [kernel.qualified_name for kernel in robot.table] == [
        "forward_kinematics", "hybrid_jacobian", "hybrid_joint_stiffness",
    ]  # fmt: skip
    with pytest.raises(OutputError, match="has no Python module"):
        _ = robot.module
    assert main(["verify", str(folder)]) == 2


def test_controller_brings_the_functions_that_it_calls(tmp_path: Path) -> None:
    folder = stiffgen.generate(URDF, output=tmp_path, kernels="limits", build=False)
    names = {kernel.qualified_name for kernel in stiffgen.open_robot(folder).table}
    assert {"limits_torque", "spring_linearization", "mass_matrix"} < names
    assert "body_jacobian" not in names


FURTHER = "bounded spring", "two tips and tools", "closed loop"


def names_in_controller(folder: Path) -> set[str]:
    """Return the names NAME_... in the C of a folder's controller and its companions, without NAME_."""
    sources = [folder / f"{folder.name}_{part}.c" for part in ("impedance", *COMPANIONS)]
    text = "".join(file.read_text() for file in sources if file.exists())
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    return set(re.findall(rf"\b{folder.name}_(\w+)\b", code))


@pytest.mark.parametrize(
    "robot",
    ["one tip", *(pytest.param(robot, marks=pytest.mark.slow) for robot in FURTHER)],
)
def test_controller_brings_no_other_functions_than_it_calls(robot: str, tmp_path: Path) -> None:
    """Compare the controller's listed functions with those that its C names."""
    urdf, options = tmp_path / "arm.urdf", {}
    urdf.write_text(chain_urdf("rp"))
    if robot == "bounded spring":
        options = {"springs": ("trace", "bounded")}
    elif robot == "two tips and tools":
        urdf = ROOT / "tests" / "data" / "dual_arm.urdf"
        options = {"tip": ["left hand", "right-hand"], "runtime_tool": True}
    elif robot == "closed loop":
        linkage = random_linkage(0)
        options = linkage.options
        urdf.write_text(linkage.urdf)
    chosen = {"name": "arm", "output": tmp_path, "kernels": "hybrid.jacobian", "python": False, "build": False}
    folder = stiffgen.generate(urdf, **chosen, **options)
    opened = stiffgen.open_robot(folder)
    springs = options.get("springs", ("trace",))
    named = names_in_controller(folder)
    possible = chain_kernels(opened.chain, stiffgen.KernelOptions(springs=springs))
    called = {kernel.choices[-1] for kernel in possible if kernel.qualified_name in named}
    assert called == {"forward_kinematics", *called_kernels(opened.chain, springs)}
    assert {kernel.choices[-1] for kernel in opened.table} == called


@pytest.mark.wide(instead="tests/cli/test_cli.py::test_verify")
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
def test_part_of_the_functions_is_verified(tmp_path: Path) -> None:
    """Of a small arm, with the functions that its controller calls."""
    (tmp_path / "arm.urdf").write_text(chain_urdf("rpr"))
    folder = stiffgen.generate(tmp_path / "arm.urdf", output=tmp_path, kernels="spatial")
    assert [check for check in verify(folder, count=3) if not check.passed] == []


def test_unknown_groups_and_contradictions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ChainError, match=r"kernels='hybrd': .*groups are dynamics, gravity, body, spatial, hybrid"):
        stiffgen.generate(URDF, output=tmp_path, kernels="hybrd", build=False)
    with pytest.raises(ChainError, match="batches=False"):
        stiffgen.generate(URDF, output=tmp_path, cuda=True, batches=False, build=False)
    assert list(tmp_path.iterdir()) == []
