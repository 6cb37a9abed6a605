"""Fixtures: the C++ client built for the robot with the plate, and sessions of it with the simulated robot."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import pytest
from filelock import FileLock

from examples.fri_robot.emulator import Emulator
from examples.fri_robot.replay import read_client_log
from support.fri_python_client import emulate, free_port
from support.fri_run import Run
from support.fri_session import SANITIZERS, build_robot, compilers, run_cmake
from support.project import ROOT

CLIENT = ROOT / "examples" / "fri_client"
TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"


@pytest.fixture(scope="session")
def robot_library(
    tmp_path_factory: pytest.TempPathFactory, worker_id: str, plate_folder: Path
) -> Callable[[str, str], list[str]]:
    """The library of the robot with the plate, of a compiler with flags, built once for all workers; CMake options.

    It computes the same bits as the NumPy module of ``plate_folder``.
    """
    base = tmp_path_factory.getbasetemp()
    output = (base if worker_id == "master" else base.parent) / "fri-robot"

    def library(compiler: str, flags: str) -> list[str]:
        folder = output / re.sub(r"\W+", "_", compiler + flags)
        output.mkdir(exist_ok=True)
        with FileLock(f"{folder}.lock"):
            options = folder / "options.json"
            if not options.exists():
                options.write_text(json.dumps(build_robot(plate_folder, folder, compiler=compiler, flags=flags)))
        return list(json.loads(options.read_text()))

    return library


@pytest.fixture(scope="session")
def client_program(
    tmp_path_factory: pytest.TempPathFactory, worker_id: str, robot_library: Callable[[str, str], list[str]]
) -> Callable[[str], Path]:
    """The client of an FRI version, built once for all workers. Those of 1.15 and 2.5 are built with sanitizers."""
    tools = ("cmake", "g++", "protoc")
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if not shutil.which("nanopb_generator") and not shutil.which("nanopb_generator.py"):
        missing.append("nanopb")
    if missing:
        text = f"{', '.join(missing)} missing (Debian: apt-get install g++ nanopb libnanopb-dev protobuf-compiler)"
        if os.environ.get("CI"):
            pytest.fail(f"{text}; .ci/run installs them")
        pytest.skip(text)
    base = tmp_path_factory.getbasetemp()
    output = (base if worker_id == "master" else base.parent) / "fri-client"

    def build(version: str) -> Path:
        folder = output / version
        output.mkdir(exist_ok=True)
        with FileLock(str(folder) + ".lock"):
            if not (folder / "fri_wiping").exists():
                flags = "-O1" if version == "2.7" else SANITIZERS  # the others are those of the slow tests
                options = [f"-DOPEN_FRI_VERSION={version}", *robot_library("gcc", flags), *compilers("gcc", flags)]
                run_cmake(["-S", CLIENT, "-B", folder, *options], ["--build", folder, "-j2"])
        return folder / "fri_wiping"

    return build


@pytest.fixture
def session(
    tmp_path: Path, plate_folder: Path, client_program: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Run]:
    """A session of both, in lockstep; ``at``: what to do with the client's process from a time [s] on, once."""

    def run(
        version: str,
        *options: object,
        client: Sequence[object] = ("--approach", 0.5),
        trajectory: Path = TRAJECTORY,
        robot_version: str | None = None,
        terminal: IO[bytes] | None = None,
        at: Sequence[tuple[float, Callable[[subprocess.Popen[str]], object]]] = (),
    ) -> Run:
        port = free_port()
        files = [tmp_path / f"client-{port}.csv", tmp_path / f"client-{port}.json"]
        # Another client, to see a test fail: FRI_CLIENT=/some/where/{version}/fri_wiping.
        program = os.environ.get("FRI_CLIENT", "").format(version=version) or client_program(version)
        command = [program, "--trajectory", trajectory, "--port", port, "--timeout", 5000]
        command += ["--log", files[0], "--summary", files[1], *client]
        command += ["--simulated-time"] if "--lockstep" in options else []
        said = tmp_path / f"client-{port}.txt"
        with said.open("w") as output:
            process = subprocess.Popen([*map(str, command)], stdin=terminal or subprocess.DEVNULL, stdout=output,
                                       stderr=subprocess.PIPE, text=True)  # fmt: skip
        begin = Emulator._begin
        due = list(at)

        def watched(self: Emulator) -> Any:
            while due and self.time >= due[0][0]:
                due.pop(0)[1](process)
            return begin(self)

        monkeypatch.setattr(Emulator, "_begin", watched)
        killer = threading.Timer(120.0, process.kill)
        killer.start()
        try:
            robot = emulate(tmp_path, plate_folder, robot_version or version, port, "--answer-timeout", 10, *options)
            error = process.communicate(timeout=20)[1]
        finally:
            killer.cancel()
            process.kill()
            process.communicate()
            monkeypatch.setattr(Emulator, "_begin", begin)
        log = read_client_log(*files) if files[1].exists() else None
        return Run(robot, log, process.returncode, error, said.read_text())

    return run
