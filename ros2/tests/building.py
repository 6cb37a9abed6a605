# SPDX-License-Identifier: MIT
"""Compile packages, robots and scenarios; exported packages of CMake that lead to the stubs."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import cmake
import ninja
import yaml

ROS2 = Path(__file__).parents[1]
PACKAGE, STUBS = ROS2 / "stiffgen_ros2", ROS2 / "stubs"
STRICT = ("-std=c++17", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
DISTROS = {"humble": 16, "jazzy": 28, "rolling": 30}
"""Major version of rclcpp, which the stubs take their form from."""
CMAKE = Path(cmake.CMAKE_BIN_DIR)
FOUND = re.findall(r"find_package\((\w+) REQUIRED\)", (PACKAGE / "CMakeLists.txt").read_text())
AMENT = Path("/usr/share/ament_cmake/cmake/ament_cmakeConfig.cmake")
PLUGINLIB = """
function(pluginlib_export_plugin_description_file category file)
  install(FILES ${file} DESTINATION share/${PROJECT_NAME})
endfunction()
"""
FAKE_AMENT = """
function(ament_add_test name unused program)
  add_test(NAME ${name} COMMAND ${program})
endfunction()
macro(ament_package)
  install(FILES package.xml DESTINATION share/${PROJECT_NAME})
endmacro()
include(CTest)
"""
GENERATE_PARAMETERS = """
set(folder ${CMAKE_CURRENT_LIST_DIR})
function(generate_parameter_library NAME file)
  file(READ ${file} text)
  configure_file(${folder}/header.hpp.in include/${PROJECT_NAME}/${NAME}.hpp @ONLY)
  add_library(${NAME} INTERFACE)
  target_include_directories(${NAME} INTERFACE ${CMAKE_CURRENT_BINARY_DIR}/include)
endfunction()
"""
TYPES = {
    "bool": "bool",
    "double": "double",
    "string": "std::string",
    "double_array": "std::vector<double>",
    "string_array": "std::vector<std::string>",
}
"""Types of generate_parameter_library, in C++."""
SCENARIOS = [
    name
    for file in ("lifecycle", "commands", "changes", "faults")
    for name in re.findall(
        r'^    \{"(\w+)", \w+\},$', (Path(__file__).parent / f"{file}.cpp").read_text(), re.MULTILINE
    )
]
"""Names of the scenarios of every robot, in the order of the program."""


def run(command: list[object], folder: Path) -> str:
    """Run a command in a folder; a failure shows what the command printed."""
    done = subprocess.run([str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-6000:]
    return done.stdout


def fake_packages(folder: Path, distro: str) -> Path:
    """Write a config file for each package: an imported target of the stubs, under the names that ROS 2 exports."""
    for name in FOUND:
        package = folder / name
        package.mkdir(parents=True)
        if name == "ament_cmake":
            (package / f"{name}Config.cmake").write_text(FAKE_AMENT)
            continue
        target = f"{name}::{name}"
        text = f"add_library({target} INTERFACE IMPORTED)\n"
        text += f"target_include_directories({target} INTERFACE {STUBS})\n"
        text += f"target_compile_definitions({target} INTERFACE STUB_DISTRO={DISTROS[distro]})\n"
        text += f"set({name}_TARGETS {target})\n" + (PLUGINLIB if name == "pluginlib" else "")
        (package / f"{name}Config.cmake").write_text(text)
    describe_parameters(folder / "generate_parameter_library")
    if AMENT.exists():  # Debian's own
        (folder / "ament_cmake" / "ament_cmakeConfig.cmake").unlink()
    return folder


def describe_parameters(folder: Path) -> None:
    """Write a config file of generate_parameter_library: its header declares what parameters.yaml describes."""
    [(name, described)] = yaml.safe_load((PACKAGE / "src" / "parameters.yaml").read_text()).items()
    lines = []
    for key, each in described.items():
        declare = f"node->template declare_parameter<{TYPES[each['type']]}>"
        lines.append(f'        {declare}("{key}", {literal(each["default_value"])});')
    header = "struct ParamListener {\n    template <class Node> explicit ParamListener(Node node)\n    {\n"
    header = f"namespace @NAME@ {{\n{header}" + "\n".join(lines) + "\n    }\n};\n}\n"
    folder.mkdir()
    (folder / "header.hpp.in").write_text(header)
    (folder / f"{folder.name}Config.cmake").write_text(GENERATE_PARAMETERS)
    assert name == "stiffgen_ros2_parameters"


def literal(value: object) -> str:
    """Return a default as C++."""
    return json.dumps(value).replace("[", "{").replace("]", "}")


def build(source: Path, folder: Path, distro: str, *options: str) -> Path:
    """Configure, build, test and install; return the folder of what is installed."""
    packages, installed = fake_packages(folder / "packages", distro), folder / "installed"
    flags = " ".join((*STRICT[1:],))
    command = [CMAKE / "cmake", "-S", source, "-B", folder / "build", "-G", "Ninja", *options]
    command += [f"-DCMAKE_MAKE_PROGRAM={Path(ninja.BIN_DIR) / 'ninja'}", "-DCMAKE_BUILD_TYPE=None"]
    command += [f"-DCMAKE_CXX_FLAGS={flags}", "-DCMAKE_C_FLAGS=-O0", f"-DCMAKE_PREFIX_PATH={packages}"]
    names = (*FOUND, "generate_parameter_library")
    command += [f"-D{name}_DIR={packages / name}" for name in names if (packages / name).glob("*")]
    command += ["-DPython3_EXECUTABLE=/usr/bin/python3"] if AMENT.exists() else []  # has Debian's ament packages
    run(command, folder)
    run([CMAKE / "cmake", "--build", folder / "build", "-j2"], folder)
    assert "100% tests passed" in run([CMAKE / "ctest", "--test-dir", folder / "build"], folder)
    run([CMAKE / "cmake", "--install", folder / "build", "--prefix", installed], folder)
    return installed


MAKERS = ("follow", "policy", "settle", "press")
"""Makers of commands that the package uses."""


def compile_robot(folder: Path, robot: Path) -> None:
    """Compile the robot's functions, its controller and its makers of commands into a folder."""
    for name in (robot.name, f"{robot.name}_impedance", *(f"{robot.name}_{part}" for part in MAKERS)):
        run(["cc", "-std=c99", "-O1", "-c", robot / f"{name}.c"], folder)


def compile_scenarios(folder: Path, package: Path, robot: Path, objects: Path, distro: str) -> None:
    """Build the program of the scenarios from a package and its robot's objects, in one translation unit.

    Headers take most of the compiler's time: thirteen units take five times as long. CMake builds each file alone.
    The newest distribution is compiled as C++20, which some of its packages ask for.
    """
    configured(folder, package, robot.name)
    include = [f"-I{path}" for path in (package / "src", folder, STUBS, robot)]
    name = ElementTree.parse(package / "package.xml").findtext("name")
    namespace = f"-D{PACKAGE.name}={name}"  # the scenarios' name of the package
    newer = ["-std=c++20"] if distro == "rolling" else []
    command = ["g++", *STRICT, *newer, f"-DSTUB_DISTRO={DISTROS[distro]}", namespace, *include]
    files = [file for source in (package / "src", Path(__file__).parent) for file in sorted(source.glob("*.cpp"))]
    files.remove(package / "src" / "mock_system.cpp")  # another plugin, with its own program
    unit = folder / "all.cpp"
    unit.write_text("".join(f'#include "{file}"\n' for file in files))
    run([*command, "-c", unit], folder)
    run(["g++", *folder.glob("*.o"), *objects.glob("*.o"), "-o", "scenarios", "-lm"], folder)


def configured(folder: Path, package: Path, name: str) -> None:
    """Write robot.hpp as CMake does."""
    text = (package / "src" / "robot.hpp.in").read_text()
    (folder / "robot.hpp").write_text(text.replace("@ROBOT_NAME@", name).replace("@ROBOT_MACRO@", name.upper()))
