# SPDX-License-Identifier: MIT
"""``stiffgen new --controller ros2``: the package of another robot is built, and passes the scenarios."""

from __future__ import annotations

import io
import re
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from stiffgen.cli import main

from .building import PACKAGE, ROS2, SCENARIOS, build, compile_robot, compile_scenarios

PANDA = ROS2.parent / "tests" / "data" / "panda.urdf"


def new(*arguments: object) -> tuple[int, str]:
    """Make a package in this process; return the exit code and what is said on standard error."""
    with redirect_stderr(io.StringIO()) as said, redirect_stdout(io.StringIO()):
        try:
            code = main(["new", *map(str, arguments), "--controller", "ros2"])
        except SystemExit as refused:  # by the parser
            code = int(refused.code or 0)
    return code, said.getvalue()


@pytest.fixture(scope="module")
def panda(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a package around another arm, with a name that ROS does not want."""
    folder = tmp_path_factory.mktemp("new") / "panda_ros2"
    code, said = new(PANDA, "--tip", "panda_link8", "--name", "Panda", "--output", folder)
    assert code == 0, said
    return folder


@pytest.mark.slow
def test_the_package_is_the_robots_own(panda: Path) -> None:
    """Make a package of another robot: no name of the repository's robot is left, nor the generator's licence."""
    assert (panda / "urdf" / "panda.LICENSE").read_text() == PANDA.with_name("panda.LICENSE").read_text()
    own = [path for path in panda.rglob("*") if path.is_file() and not {"generated", "urdf"} & set(path.parts)]
    for file in (*own, panda / "urdf" / "panda.urdf"):
        text = file.read_text()
        assert "stiffgen_ros2" not in text and "SPDX" not in text and "'A1'" not in text, file
        assert "iiwa14" not in text or file.name == "README.md", file
    assert {path.relative_to(PACKAGE).parts[0] for path in PACKAGE.rglob("*.cpp")} <= {
        path.name for path in panda.iterdir()
    }
    assert ElementTree.parse(panda / "package.xml").findtext("name") == "panda_ros2"
    assert re.search(
        r"motor_inertia: \[0\.\d+(, \d+\.\d+){6}\]  # \w+", (panda / "config" / "controllers.yaml").read_text()
    )
    joints = re.search(r"^JOINTS = (.*)$", (panda / "launch" / "mock.launch.py").read_text(), re.MULTILINE)
    assert joints and joints[1].count("panda_joint") == 7
    assert "stiffgen generate urdf/panda.urdf --name Panda" in (panda / "README.md").read_text()


@pytest.mark.wide(instead="ros2/tests/test_package.py::test_the_package_is_built_and_installed")
def test_the_package_is_built(panda: Path, tmp_path: Path) -> None:
    installed = build(panda, tmp_path, "rolling", "-DPANDA_DISPATCH=OFF")
    assert (installed / "share" / "panda_ros2" / "urdf" / "panda.urdf").is_file()
    assert (installed / "lib" / "libpanda_ros2.so").is_file()


@pytest.mark.wide(instead="test_the_package_is_the_robots_own")
def test_the_scenarios_of_another_robot(panda: Path, tmp_path: Path) -> None:
    """Run all scenarios of the law on a Panda instead of the iiwa 14."""
    objects, robot = tmp_path / "robot", panda / "generated" / "Panda"
    objects.mkdir()
    compile_robot(objects, robot)
    compile_scenarios(tmp_path, panda, robot, objects, "rolling")
    for name in SCENARIOS:
        done = subprocess.run([tmp_path / "scenarios", name], capture_output=True, text=True, check=False, timeout=300)
        assert (done.stdout, done.returncode) == ("", 0), name


@pytest.mark.slow
def test_a_template_is_expanded_and_keeps_its_licence(tmp_path: Path) -> None:
    """Make a package of a template: the launch file needs no xacro, and licences go with the copies."""
    maker = tmp_path / "maker_description"
    (maker / "robots").mkdir(parents=True)
    (maker / "package.xml").write_text("<package><name>maker_description</name><license>Apache-2.0</license></package>")
    (maker / "LICENSE").write_text("Apache License, as the maker has it\n")
    (maker / "arm.urdf").write_text(PANDA.read_text())
    template = maker / "robots" / "arm.urdf.xacro"
    template.write_text(
        '<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find maker_description)/arm.urdf"/></robot>'
    )
    project = tmp_path / "out"
    code, said = new(template, "name:=arm", "--tip", "panda_link8", "--output", project)
    assert code == 0, said
    maker.rename(tmp_path / "gone")
    scope: dict[str, Any] = {}
    exec((project / "launch" / "mock.launch.py").read_text(), scope)
    robot = ElementTree.fromstring(scope["description"](project / "urdf" / scope["URDF"]))
    assert {joint.get("name") for joint in robot.findall("joint")} >= set(scope["JOINTS"])
    assert robot.find("ros2_control/joint") is not None
    assert "xacro" not in (project / "launch" / "mock.launch.py").read_text()
    assert (project / "urdf" / "LICENSE").read_text() == "Apache License, as the maker has it\n"
    assert (
        "keep their licence (licence: `urdf/LICENSE`; package.xml names Apache-2.0)"
        in (project / "README.md").read_text()
    )


@pytest.fixture(scope="module")
def without_limits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a package around an arm whose file gives neither efforts nor velocities."""
    folder = tmp_path_factory.mktemp("limits")
    urdf = folder / "arm.urdf"
    urdf.write_text(re.sub(r' (effort|velocity)="[^"]*"', "", PANDA.read_text()))
    code, said = new(urdf, "--tip", "panda_link8", "--name", "arm", "--output", folder / "arm_ros2")
    assert code == 0 and "src/defaults.hpp" in said, said
    return folder / "arm_ros2"


@pytest.mark.slow
def test_missing_limits_are_guesses_that_can_be_seen(without_limits: Path) -> None:
    defaults = (without_limits / "src" / "defaults.hpp").read_text()
    assert defaults.count("a guess, use your robot's") == 14


@pytest.mark.wide(instead="test_the_package_is_the_robots_own")
def test_guesses_are_compiled(without_limits: Path, tmp_path: Path) -> None:
    build(without_limits, tmp_path, "rolling", "-DARM_DISPATCH=OFF")  # its test needs limits


@pytest.mark.slow
def test_refused_robots_leave_nothing(tmp_path: Path) -> None:
    """Give robots that the ROS 2 package cannot serve: exit code 2, a reason, and no folder."""
    mjcf = tmp_path / "arm.xml"
    mjcf.write_text(
        '<mujoco model="arm"><worldbody><body name="link"><joint name="a" axis="0 0 1" range="-1 1" limited="true"/>'
        '<geom size="0.1"/><body name="tip" pos="1 0 0"><geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    for arguments, reason in (
        ((mjcf, "--tip", "tip"), "needs a URDF or xacro"),
        ((PANDA, "--tip", "panda_link8", "--no-masses"), "--controller ros2 needs masses"),
        ((PANDA, "--tip", "panda_link8", "--spring", "quaternion"), "--spring quaternion"),
    ):
        code, said = new(*arguments, "--output", tmp_path / "out")
        assert code == 2 and reason in said, said
        assert not (tmp_path / "out").exists()
