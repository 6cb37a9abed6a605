# SPDX-License-Identifier: MIT
"""stiffgen.load: the user's cache, two processes, a crash, changed inputs, and what cannot be written or compiled."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.files import cache
from support.chains import chain_urdf
from support.project import ROOT, URDF

SMALL = {"kernels": "hybrid.jacobian", "controller": False, "batches": False, "masses": False}
LOAD = f"import stiffgen; print(stiffgen.load('arm.urdf', **{SMALL!r}).module.hybrid.jacobian([0.0] * 7).shape)"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty cache, a robot's file, and a compiler that waits while the file ``wait`` exists."""
    shutil.copy(URDF, tmp_path / "arm.urdf")
    compiler = tmp_path / "compiler"
    wait = "if [ -e wait ]; then touch started; while [ -e wait ]; do sleep 0.01; done; fi"
    compiler.write_text(f'#!/bin/sh\n(cd {tmp_path}; {wait})\nexec cc "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("CFLAGS", "-O0")
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def start() -> subprocess.Popen[str]:
    command = [sys.executable, "-c", LOAD]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def until(file: Path) -> None:
    while not file.exists():
        time.sleep(0.01)


def test_first_use_generates_and_the_next_opens(here, monkeypatch, capsys):
    """Load twice: the second opens the entry without a compiler; list and clear the cache."""
    robot = stiffgen.load("arm.urdf", **SMALL)
    assert "compiling" in capsys.readouterr().err
    assert robot.module.hybrid.jacobian(np.zeros(7)).shape == (6, 7)
    shown = repr(robot).splitlines()
    assert len(shown) < 25 and max(map(len, shown[1:])) <= 100
    assert all(any(text in line for line in shown) for text in ("link_ee", "A4", "-2.0944", "hybrid: jacobian"))
    with monkeypatch.context() as patched:
        patched.setattr(cache, "generate_folder", None)
        patched.setattr(cache, "_make_folder", None)  # an entry that is there is opened where nothing can be written
        assert stiffgen.load(Path("arm.urdf"), **SMALL).folder == robot.folder
        patched.setenv("CC", str(here / "absent"))  # nor is a compiler needed
        assert stiffgen.load("arm.urdf", **SMALL).folder == robot.folder
    assert capsys.readouterr().err == ""
    assert main(["inspect", "--list", "cached"]) == 0 and "1 robots" in capsys.readouterr().out
    assert main(["inspect", "iiwa7", "--list", "cached"]) == 0 and "0 robots" in capsys.readouterr().out
    assert main(["inspect", "iiwa7", "--list", "clear"]) == 2
    assert "the cache has no robot 'iiwa7'; it has iiwa14" in capsys.readouterr().err
    assert robot.folder.exists()
    assert main(["inspect", "--list", "clear"]) == 0 and "1 robots removed" in capsys.readouterr().out
    assert cache.entries() == [] and not robot.folder.exists()


def test_what_the_name_of_an_entry_depends_on(here, monkeypatch):
    """Change options, file, flags and version: each gives another entry, the same ones the same."""
    made = []
    monkeypatch.setattr(cache, "generate_folder", lambda file, options: made.append(options.output) or options.output)
    for name in ("_record", "_opened"):
        monkeypatch.setattr(cache, name, lambda *given: None)
    monkeypatch.setattr(cache, "_open", lambda entry, say: None)
    stiffgen.load("arm.urdf")
    stiffgen.load(here / "arm.urdf", progress=print)
    assert made[0] == made[1]
    stiffgen.load("arm.urdf", tip="link_5")
    stiffgen.load("arm.urdf", lock={"A3": 0.1})
    stiffgen.load("arm.urdf", derivatives=True)
    stiffgen.load("arm.urdf", tool=stiffgen.Tool(mass=1.0))
    (here / "arm.urdf").write_text(URDF.read_text() + "<!-- changed -->")
    stiffgen.load("arm.urdf")
    monkeypatch.setenv("CFLAGS", "-O1")
    stiffgen.load("arm.urdf")
    monkeypatch.setattr(cache, "_generator", lambda: "another version")
    stiffgen.load("arm.urdf")
    assert len(set(made)) == len(made) - 1


def test_what_generate_made_is_opened(here, monkeypatch, capsys):
    """Load a file that `generate` made, also of another folder: opened without its packages."""
    words = ["--kernels", "hybrid.jacobian", "--no-controller", "--no-batches", "--no-masses", "--output", "out"]
    assert main(["generate", "arm.urdf", *words, "--lock", "A3=0.1"]) == 0
    (made,) = cache.entries()
    assert made.folder.name == "iiwa14" and made.folder.parent.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(cache, "generate_folder", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None if name == "jaxlib" else find_spec(name))
    robot = stiffgen.load("arm.urdf", lock={"A3": 0.1}, **SMALL)
    assert robot.folder == made.folder and robot.module.DOF == 6
    with pytest.raises(TypeError):  # others are generated
        stiffgen.load("arm.urdf", lock={"A3": 0.2}, **SMALL)


def test_generate_keeps_no_folder_that_load_could_not_make(here, monkeypatch):
    """Generate without a module, or beside a cache of others: not kept, and no error."""
    words = ["generate", "arm.urdf", "--kernels", "hybrid.jacobian", "--no-controller", "--no-batches", "--no-masses"]
    assert main([*words, "--no-build", "--output", "out"]) == 0
    assert main([*words, "--no-python", "--output", "plain"]) == 0
    assert not (here / "cache").exists()
    (here / "cache").mkdir(mode=0o700)
    (here / "cache").chmod(0o777)
    assert main([*words, "--output", "out"]) == 0
    assert list((here / "cache").iterdir()) == []
    monkeypatch.setenv("STIFFGEN_CACHE", str(here / "arm.urdf" / "cache"))
    assert main([*words, "--output", "out"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    ["module", "manifest", *(pytest.param(name, marks=pytest.mark.wide) for name in ("header", "record", "absent"))],
)
def test_a_damaged_entry_is_made_again(here, capsys, damage):
    """Damage an entry, also its compiled module (SIGBUS on import): it is made anew."""
    robot = stiffgen.load("arm.urdf", **SMALL)
    (module,) = (robot.folder / "python").glob("*.so")
    header, manifest, record = (robot.folder / name for name in ("iiwa14.h", "manifest.json", "../entry.json"))
    file = {"module": module, "header": header, "manifest": manifest, "record": record, "absent": module}[damage]
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    if damage == "absent":
        file.unlink()
    capsys.readouterr()
    done = subprocess.run([sys.executable, "-c", LOAD], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "(6, 7)\n")
    assert done.stderr.count("is damaged") == 1 and "again" in done.stderr.splitlines()[0]
    if damage != "record":
        assert file.name in done.stderr.splitlines()[0] and len(file.read_bytes()) == len(whole)


def test_one_robot_is_removed(here, capsys):
    robots = [stiffgen.load("arm.urdf", name=name, **SMALL).folder for name in ("one", "two")]
    assert main(["inspect", "two", "--list", "clear"]) == 0 and "1 robots removed" in capsys.readouterr().out
    assert [folder.exists() for folder in robots] == [True, False]


@pytest.mark.slow
def test_the_readmes_line(here, monkeypatch):
    """Its call, to the letter, beside a file of that name."""
    (code,) = re.findall(r"`(stiffgen\.load\(\"my_arm.*?)`", (ROOT / "README.md").read_text())
    Path("my_arm.urdf").write_text(chain_urdf("rr").replace('"l2"', '"tool0"'))
    assert eval(code, {"stiffgen": stiffgen}).hybrid.jacobian(np.zeros(2)).shape == (6, 2)


@pytest.mark.slow
def test_two_processes_at_once_generate_once(here):
    """Load in two processes at once: one compiles, the other waits, and both get the robot."""
    (here / "wait").touch()
    first = start()
    until(here / "started")
    second = start()
    assert "waiting for another process" in second.stderr.readline()
    (here / "wait").unlink()
    told = [process.communicate(timeout=100) for process in (first, second)]
    assert [process.returncode for process in (first, second)] == [0, 0], told
    assert [out for out, _ in told] == 2 * ["(6, 7)\n"]
    assert ["compiling" in err for _, err in told] == [True, False]


@pytest.mark.slow
def test_after_a_kill_nothing_broken_is_opened(here):
    """Kill a process while it compiles: no entry is left, and the next load makes it anew."""
    (here / "wait").touch()
    process = start()
    until(here / "started")
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert cache.entries() == []
    (here / "wait").unlink()
    robot = stiffgen.load("arm.urdf", **SMALL)
    assert robot.module.DOF == 7
    assert {each.name for each in robot.folder.parent.iterdir()} == {"iiwa14", "entry.json"}


def test_refusals(here, monkeypatch):
    """Load with wrong options, files, caches and compilers: refused, and no cache is left."""
    with pytest.raises(stiffgen.StiffgenError, match=r"load\(\) decides 'output' itself"):
        stiffgen.load("arm.urdf", output="here")
    with pytest.raises(stiffgen.DescriptionError, match=r"absent\.urdf: cannot be read"):
        stiffgen.load("absent.urdf")
    with monkeypatch.context() as patched:
        patched.setenv("STIFFGEN_CACHE", str(here / "arm.urdf" / "cache"))
        with pytest.raises(stiffgen.OutputError, match=r"the cache cannot be written .*set STIFFGEN_CACHE"):
            stiffgen.load("arm.urdf")
    monkeypatch.setenv("CC", str(here / "absent"))
    with pytest.raises(stiffgen.BuildError, match="was not found"):
        stiffgen.load("arm.urdf")
    assert not (here / "cache").exists()
