# SPDX-License-Identifier: MIT
"""The ros2_control package around a robot: the repository's ros2/stiffgen_ros2, under the robot's name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stiffgen.core.errors import StiffgenError, printable
from stiffgen.core.names import comment
from stiffgen.core.robot.chain import Chain

_NAME = "stiffgen_ros2"
_NOT_COPIED = ("LICENSE", "CHANGELOG.rst", "QUALITY_DECLARATION.md")
_LICENCE = re.compile(r"\A(//|#) SPDX-License-Identifier[:] MIT\n")
_OF_THE_REPOSITORY = re.compile(r"[^\n]*# in stiffgen's repository\n.*?endif\(\)\n", re.DOTALL)
_ENDING = """
## Choices at generation

When the robot's file or its tool changes, generate the functions again:

    {command}

## Before a real robot

- Joint names are those of the robot's file. Set `joints` or `prefix` where the driver has others.
- Compare `~/pose` with the pose that the robot itself reports, in several configurations, before torque is on.
- `config/controllers.yaml` states `motor_inertia`; where its comment says estimate, ask the maker, or measure it.
- Limits that the robot's file lacks are guesses in `src/defaults.hpp`. Replace them, or set the parameters.
- Start with small stiffness, with a hand on the emergency stop.

{licences}
The other files are yours: use, change and license them as you like.
"""
_EXPANDED = """
`urdf/{expanded}` is the robot's template, expanded at generation: the launch file needs neither xacro nor the
template's packages. RViz finds meshes (`package://`) where their package is installed.
"""


def package_name(name: str) -> str:
    """Return the package's name for a robot's; ROS wants lower case."""
    return f"{name.lower()}_ros2"


def check_robot(file: Path) -> None:
    """Refuse a robot that ros2_control cannot describe, and an installation without the package."""
    _source()
    if file.suffix not in (".urdf", ".xacro"):
        raise StiffgenError(
            f"{printable(str(file), 200)}: a ros2_control package needs a URDF or xacro file for robot_description; "
            "choose --controller impedance"
        )


def package_files(variables: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the package by their path: the repository's ROS 2 package with this robot's name and
    limits.
    """
    source, name = _source(), variables["name"]
    package = package_name(name)
    files = {}
    for path in sorted(source.rglob("*")):
        file = path.relative_to(source).as_posix()
        if path.is_file() and "__pycache__" not in file and file not in _NOT_COPIED:
            text = _LICENCE.sub("", path.read_text(encoding="utf-8"))
            files[file.replace(_NAME, package)] = text.replace(_NAME, package)
    cmake = _OF_THE_REPOSITORY.sub("", files["CMakeLists.txt"])
    files["CMakeLists.txt"] = _replaced(cmake, "set(ROBOT_NAME iiwa14 ", f"set(ROBOT_NAME {name} ")
    files["config/controllers.yaml"] = _stated(files["config/controllers.yaml"], variables)
    files["package.xml"] = _replaced(files["package.xml"], "<license>MIT<", "<license>see README.md<")
    files["src/defaults.hpp"] = _replaced(
        files["src/defaults.hpp"], "    return config;\n", "".join(_guesses(variables)) + "    return config;\n"
    )
    files["launch/mock.launch.py"] = _launch(files["launch/mock.launch.py"], variables)
    expanded = _EXPANDED.format(expanded=variables["expanded"]) if variables["expanded"] else ""
    files["README.md"] += expanded + _ENDING.format(command=variables["regenerate"], licences=variables["licences"])
    files[".gitignore"] = "build/\ninstall/\nlog/\n__pycache__/\n"
    return files


def _source() -> Path:
    """Return the folder of the package: in an installed wheel beside this module, in a clone at its top."""
    for folder in (Path(__file__).parent / "ros2", Path(__file__).parents[4] / "ros2" / _NAME):
        if (folder / "package.xml").is_file():
            return folder
    raise StiffgenError("--controller ros2: this installation has no ROS 2 package; install stiffgen from a clone")


def _replaced(text: str, old: str, new: str) -> str:
    if text.count(old) != 1:
        raise StiffgenError(f"--controller ros2: the package has changed where '{old.strip()}' was expected")
    return text.replace(old, new)


def _guesses(variables: Mapping[str, Any]) -> list[str]:
    """Return the lines that set limits which the robot's file does not state."""
    lines = []
    for joint, value in variables["effort"].items():
        lines += [
            f"    config.effort_limit[{joint}] = {value}; // N m or N: a guess, use your robot's\n",
            f"    config.torque_rate_limit[{joint}] = {10 * value};\n",
        ]
    for joint, value in variables["velocity"].items():
        lines.append(f"    config.velocity_limit[{joint}] = {value}; // rad/s or m/s: a guess, use your robot's\n")
    return lines


def _stated(text: str, variables: Mapping[str, Any]) -> str:
    """Return the parameters with the robot's motor_inertia and its source, and its friction."""
    [line] = re.findall(r"^    motor_inertia: .*$", text, re.MULTILINE)
    inertia, friction = (", ".join(map(repr, map(float, variables[name]))) for name in ("rotors", "friction"))
    text = text.replace(line, f"    motor_inertia: [{inertia}]  # {comment(variables['rotors_source'], 200)}")
    return re.sub(r"^    coulomb_friction: \[.*?\]", f"    coulomb_friction: [{friction}]", text, flags=re.MULTILINE)


def _launch(text: str, variables: Mapping[str, Any]) -> str:
    """Return the launch file with the robot's file and joints in place of the two constants."""
    chain: Chain = variables["robot"]
    joints = ", ".join(ascii(coordinate.name) for coordinate in chain.coordinates)
    constants = {
        "URDF": ascii(variables["expanded"] or variables["file"].removeprefix("urdf/")),
        "JOINTS": f"({joints},)",
    }
    for constant, value in constants.items():
        [line] = re.findall(rf"^{constant} = .*$", text, re.MULTILINE)
        text = text.replace(line, f"{constant} = {value}")
    return text
