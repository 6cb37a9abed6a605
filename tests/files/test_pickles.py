# SPDX-License-Identifier: MIT
"""Pickles of a robot and of what its module holds, read by another process: after spawn and forkserver, too."""

from __future__ import annotations

import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.files import cache
from support.controller_inputs import STATED
from support.project import URDF, Once

ONE = "value = pickle.load(open(name, 'rb')); print(type(value).__name__)"
POOL = """
import multiprocessing, sys
import stiffgen

def shape(robot, functions, q):
    return robot.module.hybrid.jacobian(q).shape, functions.jacobian(q).shape

if __name__ == "__main__":
    robot = stiffgen.{opened}
    with multiprocessing.get_context(sys.argv[1]).Pool(1) as pool:
        print(pool.apply_async(shape, (robot, robot.module.hybrid, [0.1] * 7)).get(timeout=60))
        print(pool.apply_async(robot.module.hybrid.jacobian, ([0.1] * 7,)).get(timeout=60).shape)
"""


@pytest.fixture(scope="module")
def shared(once: Once) -> Path:
    """Return a cache folder that holds the compiled iiwa 14."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("STIFFGEN_CACHE", str(folder / "cache"))
            stiffgen.load(URDF, batches=False)

    return once("cache of pickles", make) / "cache"


@pytest.fixture(params=["cache", "folder"])
def opened(request: pytest.FixtureRequest, shared: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return the call that opens the robot: from the cache, or from a path with a dot and a percent sign."""
    monkeypatch.setenv("STIFFGEN_CACHE", str(shared))
    if request.param == "cache":
        yield f"load({str(URDF)!r}, batches=False)"
        return
    folder = request.getfixturevalue("tmp_path") / "v1.2 50%" / "iiwa14"
    shutil.copytree(stiffgen.load(URDF, batches=False).folder, folder)
    yield f"open_robot({str(folder)!r})"


def evaluated(opened: str) -> stiffgen.GeneratedRobot:
    robot: stiffgen.GeneratedRobot = eval(f"stiffgen.{opened}")
    return robot


def values_of(robot: stiffgen.GeneratedRobot) -> dict[str, Any]:
    """Return one of each kind of value that users hold."""
    module: ModuleType = robot.module
    controller, q = module.Impedance(**STATED, record=2, errors="ignore"), 0.5 * (module.LOWER + module.UPPER)
    stiffness = {"translation_stiffness": 300 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
    out = controller.step(q=q, dq=0 * q, q0=q, counter=0, **stiffness)
    pose = module.forward_kinematics(q)
    return {
        "robot": robot, "functions": module.hybrid, "function": module.hybrid.jacobian, "by name": robot.kernels,
        "class": module.Impedance, "controller": controller, "output": out, "trace": controller.trace,
        "status": module.Status(1), "mode": out.mode, "config": controller.config, "split": module.joint_gains,
        "law": module.PaperLaw("corrected"), "policy": module.Policy(pose=pose, now=0.0),
        "chain": robot.chain, "springs": robot.springs, "spring": module.spring,
    }  # fmt: skip


def run(code: str, *arguments: str) -> str:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_another_process_reads_all(opened: str, tmp_path: Path) -> None:
    """Unpickle each value in a process that imported nothing of stiffgen."""
    values = values_of(evaluated(opened))
    for name, value in values.items():
        (tmp_path / name).write_bytes(pickle.dumps(value))
    code = f"import pickle, sys\nfor name in sys.argv[1:]:\n    {ONE}"
    names = run(code, *(str(tmp_path / name) for name in values)).split()
    assert names == [type(value).__name__ for value in values.values()]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver", "fork"])
def test_a_pool(method: str, opened: str, tmp_path: Path) -> None:
    """Functions and robots as arguments of other processes, which hung before."""
    (tmp_path / "pool.py").write_text(POOL.format(opened=opened))
    command = [sys.executable, str(tmp_path / "pool.py"), method]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout) == (0, "((6, 7), (6, 7))\n(6, 7)\n"), done.stderr


@pytest.mark.slow
def test_values_come_back_as_they_were(opened: str) -> None:
    """Unpickle in the same process: the same functions and classes, also after opening twice."""
    robot = evaluated(opened)
    values = values_of(robot)
    again = evaluated(opened)
    assert again.module is robot.module and again.module.__name__ == robot.module_name
    for name, value in values.items():
        read = pickle.loads(pickle.dumps(value))
        assert type(read) is type(value)
        if name in ("functions", "function", "class", "status", "split", "spring"):
            assert read is value, name
    read = pickle.loads(pickle.dumps(robot))
    assert (read.folder, read.chain, read.manifest) == (robot.folder.resolve(), robot.chain, robot.manifest)
    assert np.array_equal(pickle.loads(pickle.dumps(values["output"])).torque, values["output"].torque)


@pytest.mark.slow
def test_a_robot_that_is_not_there(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unpickle a value of a robot that the cache lacks: the error says to load its file."""
    monkeypatch.setenv("STIFFGEN_CACHE", str(shared))
    robot = stiffgen.load(URDF, batches=False)
    (tmp_path / "status").write_bytes(pickle.dumps(robot.module.Status(1)))
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "empty"))
    done = subprocess.run(
        [sys.executable, "-c", f"import pickle; name = {str(tmp_path / 'status')!r}; {ONE}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "ModuleNotFoundError" in last and "call stiffgen.load() with the robot's file" in last
    with pytest.raises(ModuleNotFoundError, match="has no such robot"):
        cache.spec_of(f"{robot.module_name}0")
