# SPDX-License-Identifier: MIT
"""Wheel and source distribution: complete; a new user in an empty folder with a clone, as docs/start.md says."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import stiffgen
from support.project import ROOT
from support.pythons import VERSIONS, clean_environment, interpreter

PAGE = (ROOT / "docs" / "start.md").read_text()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``python -m build``: the source distribution, and the wheel made of that."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, env=clean_environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def tracked(*folders: str) -> set[str]:
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", *folders]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\n")) - {""}


@pytest.mark.slow
def test_the_wheel_has_the_whole_package_and_nothing_else(built: Path) -> None:
    """Compare the wheel with the committed files, byte by byte: a missing data file fails at the user's."""
    (wheel,) = built.glob("*.whl")
    assert wheel.name == f"stiffgen-{stiffgen.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
        sources = {name.removeprefix("codegen/"): name for name in tracked("codegen/stiffgen")}
        package = tracked("ros2/stiffgen_ros2")  # a template of 'stiffgen new'
        sources |= {name.replace("ros2/stiffgen_ros2", "stiffgen/lab/new/ros2"): name for name in package}
        assert inside == set(sources)
        assert "stiffgen/py.typed" in inside  # else a user's type checker takes every result for Any
        for name in inside:
            assert archive.read(name) == (ROOT / sources[name]).read_bytes(), name
        assert any(name.endswith("licenses/LICENSE") for name in archive.namelist())


@pytest.mark.slow
def test_the_source_distribution_has_every_file(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as content:
        inside = {member.name.partition("/")[2] for member in content.getmembers() if not member.isdir()}
    assert tracked() - inside == set()
    assert inside - tracked() == {"PKG-INFO"}


def commands() -> list[tuple[str, str]]:
    """Yield the page's commands, each with the lines that it prints."""
    blocks = re.findall(r"```console\n(.*?)```", PAGE, re.DOTALL)
    found = re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", "".join(blocks), re.MULTILINE)
    assert [command.split()[0] for command, _ in found] == [
        "python3", "venv/bin/pip", "cp", "venv/bin/stiffgen", "cc",
        "./first_steps", "cmake", "cmake", "build/my_robot_loop",
    ]  # fmt: skip
    return found


def follow(page: list[tuple[str, str]], folder: Path, environment: dict[str, str]) -> None:
    """Run the page's commands in a folder and compare what they print."""
    for command, printed in page:
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        if printed and not command.startswith("cmake"):
            assert done.stdout.startswith(printed), command


@pytest.mark.slow
def test_the_pages_commands_behind_the_installation(tmp_path: Path) -> None:
    """From the third command on, with the program of this environment; stiffgen and CMake compile in less time."""
    (tmp_path / "stiffgen").symlink_to(ROOT)
    (tmp_path / "venv" / "bin").mkdir(parents=True)
    (tmp_path / "venv" / "bin" / "stiffgen").symlink_to(Path(sys.executable).with_name("stiffgen"))
    follow(commands()[2:], tmp_path, clean_environment() | {"CFLAGS": "-O0", "CMAKE_BUILD_TYPE": "Debug"})


@pytest.mark.wide(instead="test_the_pages_commands_behind_the_installation")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_new_user_in_an_empty_folder(version: str, tmp_path: Path) -> None:
    """docs/start.md, to the letter, with a clone alone."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"no Python {version} is installed")
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(tmp_path / "stiffgen")], check=True)
    (tmp_path / ".bin").mkdir()
    launcher = tmp_path / ".bin" / "python3"
    launcher.write_text(f'#!/bin/sh\nexec "{python}" "$@"\n')
    launcher.chmod(0o755)
    environment = clean_environment()
    environment["PATH"] = f"{launcher.parent}:{environment['PATH']}"
    follow(commands(), tmp_path, environment)
