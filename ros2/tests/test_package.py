# SPDX-License-Identifier: MIT
"""The package's files: CMake builds, tests and installs them with exported packages that lead to the stubs."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
import yaml

import stiffgen

from .building import DISTROS, FOUND, PACKAGE, ROS2, STRICT, STUBS, TYPES, build, configured, literal, run

HERE = Path(__file__).parent


@pytest.mark.slow
def test_the_package_is_built_and_installed(tmp_path: Path) -> None:
    """Libraries have the classes that the plugin description names; no symbol is left open but those of libraries.

    Nor do they need a library of the robot, which would not be installed, where the workspace asks for shared ones.
    """
    shared = ("-DBUILD_SHARED_LIBS=ON", "-DCMAKE_C_VISIBILITY_PRESET=hidden", "-DCMAKE_CXX_VISIBILITY_PRESET=hidden")
    installed = build(PACKAGE, tmp_path, "jazzy", "-DIIWA14_DISPATCH=OFF", *shared)
    share = installed / "share" / "stiffgen_ros2"
    for file in (
        "package.xml",
        "stiffgen_ros2.xml",
        "config/controllers.yaml",
        "launch/mock.launch.py",
        "urdf/iiwa14.urdf",
    ):
        assert (share / file).is_file(), file
    for library in ElementTree.parse(share / "stiffgen_ros2.xml").getroot():
        binary = installed / "lib" / f"lib{library.get('path')}.so"
        symbols = run(["nm", "-C", binary], tmp_path)
        assert "libiiwa14" not in run(["readelf", "-d", binary], tmp_path)
        parameters = f"{library.get('path')}_parameters::ParamListener" in symbols
        assert parameters == (library.get("path") == "stiffgen_ros2"), "described by generate_parameter_library"
        for each in library:
            assert f"vtable for {each.get('type')}" in symbols


def test_package_xml_declares_what_cmake_finds() -> None:
    """Compare package.xml with CMakeLists.txt and the includes: a missing dependency fails at the user's build."""
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    declared = [element.text for tag in ("buildtool_depend", "depend") for element in package.findall(tag)]
    assert sorted(map(str, declared)) == sorted([*FOUND, "generate_parameter_library"])
    included = set()
    for file in (PACKAGE / "src").iterdir():
        included |= set(re.findall(r"#include <(\w+)/", file.read_text()))
    assert included <= {*FOUND, PACKAGE.name}


def test_placeholders_of_the_package_stand_in_one_place() -> None:
    """Whoever releases the package fills in package.xml; its version is stiffgen's, which the changelog begins with."""
    files = [path for path in ROS2.rglob("*") if path.is_file() and path.suffix != ".pyc" and path.parent != HERE]
    assert [path.name for path in files if "example.com" in path.read_text()] == ["package.xml"]
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert package.findtext("version") == stiffgen.__version__
    assert {url.get("type") for url in package.findall("url")} == {"website", "repository", "bugtracker"}
    title, first = re.findall(r"^(\w.*)$", (PACKAGE / "CHANGELOG.rst").read_text(), re.MULTILINE)[:2]
    assert title == "Changelog for package stiffgen_ros2" and first in ("Forthcoming", stiffgen.__version__)


def test_the_declaration_of_quality_tells_the_truth() -> None:
    """Level 4 asks for no more; what would be a claim is checked: warnings, licences, no installed header."""
    text = (PACKAGE / "QUALITY_DECLARATION.md").read_text()
    assert "claims **Quality Level 4**" in text and ("below 1.0.0" in text) == stiffgen.__version__.startswith("0.")
    assert {"-Wall", "-Wextra", "-Wpedantic", "-Werror"} <= set(STRICT)
    assert "DESTINATION include" not in (PACKAGE / "CMakeLists.txt").read_text()
    for file in (*(PACKAGE / "src").glob("*.?pp"), *(PACKAGE / "test").iterdir()):
        assert file.read_text().startswith("// SPDX-" + "License-Identifier: MIT\n"), file


def test_described_parameters_are_those_of_the_source() -> None:
    """parameters.yaml has each parameter that is no field of the configuration, with the default of settings.cpp."""
    [described] = yaml.safe_load((PACKAGE / "src" / "parameters.yaml").read_text()).values()
    source = (PACKAGE / "src" / "settings.cpp").read_text()
    declared = re.findall(r'^    declare(?:<[\w:]+>)?\(node, "(\w+)", (.*)\);$', source, re.MULTILINE)
    assert {name for name, _ in declared} == set(described)
    for name, default in declared:
        wanted = TYPES[described[name]["type"]] + literal(described[name]["default_value"])
        assert re.sub(r"\(\)$", "{}", default) in (wanted, literal(described[name]["default_value"])), name
        assert len(described[name]["description"]) > 10


@pytest.mark.parametrize(
    "distro", [pytest.param(name, marks=() if name == "jazzy" else pytest.mark.slow) for name in DISTROS]
)
def test_the_mock_system(distro: str, robot_folder: Path, robot_objects: Path, tmp_path: Path) -> None:
    """Compile and run the mock hardware against stubs of the headers of a ROS distribution."""
    configured(tmp_path, PACKAGE, robot_folder.name)
    include = [f"-I{path}" for path in (PACKAGE / "src", tmp_path, STUBS, robot_folder)]
    source = tmp_path / "main.cpp"
    source.write_text('#include "mock_system.cpp"\n' + (Path(__file__).parent / "mock_main.txt").read_text())
    command = ["g++", *STRICT, f"-DSTUB_DISTRO={DISTROS[distro]}", *include, source]
    run([*command, *robot_objects.glob("*.o"), "-o", "mock", "-lm"], tmp_path)
    run([tmp_path / "mock"], tmp_path)


def launch_file(path: Path) -> ModuleType:
    module = ModuleType("mock_launch")
    exec(compile(path.read_text(), path, "exec"), module.__dict__)
    return module


def test_the_launch_file_describes_the_mock(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Read the launch file: an effort interface per joint, and only nodes of the package's dependencies."""
    launch = launch_file(PACKAGE / "launch" / "mock.launch.py")
    urdf = ROS2.parent / "urdf" / "iiwa14.urdf"
    robot = ElementTree.fromstring(launch.description(urdf))
    moving = [joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"]
    control = robot.find("ros2_control")
    assert control is not None and control.findtext("hardware/plugin") == "stiffgen_ros2/MockSystem"
    assert [joint.get("name") for joint in control.findall("joint")] == moving

    nodes = []
    fakes = {
        "launch": {"LaunchDescription": list},
        "launch_ros.actions": {"Node": lambda **each: nodes.append(each)},
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(tmp_path)},
    }
    for name, content in fakes.items():
        for part in (name.split(".")[0], name):
            monkeypatch.setitem(sys.modules, part, ModuleType(part))
        vars(sys.modules[name]).update(content)
    (tmp_path / "urdf").mkdir()
    (tmp_path / "urdf" / "iiwa14.urdf").write_text(urdf.read_text())
    launch.generate_launch_description()
    imported = re.findall(
        r"^ *(?:from|import) (\w+)", (PACKAGE / "launch" / "mock.launch.py").read_text(), re.MULTILINE
    )
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    declared = {element.text for element in package.findall("exec_depend")}
    assert {node["package"] for node in nodes} <= declared
    assert set(imported) - sys.stdlib_module_names <= declared
    spawned = next(node["arguments"] for node in nodes if node["executable"] == "spawner")
    yaml = (PACKAGE / "config" / "controllers.yaml").read_text()
    assert all(f"\n    {name}:\n      type: " in yaml for name in spawned)


def test_the_yaml_names_parameters_that_exist(scenarios: Callable[[str], Path]) -> None:
    yaml = (PACKAGE / "config" / "controllers.yaml").read_text().split("\nstiffness_controller:")[1]
    sources = "".join((PACKAGE / "src" / name).read_text() for name in ("settings.cpp", "fields.hpp"))
    for name in re.findall(r"^    (\w+):", yaml, re.MULTILINE):
        assert f'"{name}"' in sources or f"({name})" in sources
    whole = re.findall(r"^    (\w+): \[?\d+[,\] ]", yaml, re.MULTILINE)
    assert whole == ["delay_samples"], "rclcpp refuses an integer for a double"
