# SPDX-License-Identifier: MIT
"""Fixtures: the C++ client built for the robot with the plate, and sessions of it with the simulated robot."""

from __future__ import annotations

import json
import os
import re
import subprocess
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import IO, Any

import support.environment  # isort: skip

import pytest

from fri.robot.emulator import Emulator
from fri.robot.messages import VERSIONS
from fri.robot.replay import read_client_log
from fri.support.python_client import emulate, free_port
from fri.support.run import Run
from fri.support.served import unread, waits
from fri.support.session import (
    FUZZER,
    IN_ONE_UNIT,
    QUICK_SANITIZERS,
    Programs,
    build,
    build_robot,
    build_standin,
    compilers,
    require_tools,
    run_cmake,
    sdk_options,
)
from support.fixtures import kept_objects, once, robot_folder
from support.plate import plate, plate_folder
from support.project import ROOT, Once

__all__ = ["kept_objects", "once", "plate", "plate_folder", "robot_folder"]

CLIENT = ROOT / "fri" / "client"
TOOLS = ("fri_wiping", "harness", "allocations")
"""Targets of every build of the test programs; the attack takes as long as all of these, and one library is enough."""
TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"


@pytest.fixture(scope="session")
def robot_library(once: Once, plate_folder: Path) -> Callable[[str, str], list[str]]:
    """The library of the robot with the plate, of a compiler with flags, built once for all workers; CMake options.

    It computes the same bits as the NumPy module of ``plate_folder``.
    """

    def library(compiler: str, flags: str) -> list[str]:
        def make(folder: Path) -> None:
            options = build_robot(plate_folder, folder, compiler=compiler, flags=flags)
            (folder / "options.json").write_text(json.dumps(options))

        folder = once("fri-robot" + re.sub(r"\W+", "_", compiler + flags), make)
        return list(json.loads((folder / "options.json").read_text()))

    return library


@pytest.fixture(scope="session")
def make_programs(once: Once, robot_library: Callable[[str, str], list[str]]) -> Callable[[str], Programs]:
    """Builds the test programs by name, once for all workers: a version, standin-VERSION, sdk, or sanitized."""

    def make(name: str) -> Programs:
        if "FRI_PROGRAMS" in os.environ:  # an older build, to see a test fail
            return Programs(Path(os.environ["FRI_PROGRAMS"]), name)
        missing = require_tools()
        if missing:
            if os.environ.get("CI"):
                pytest.fail(missing)
            pytest.skip(missing)
        compiler, library = ("clang", QUICK_SANITIZERS) if name == "sanitized" else ("gcc", "-O1")
        flags = library if name in ("sanitized", "2.7") else "-O0"  # one build of gcc shows what an optimiser sees
        version = "2.7" if name == "sanitized" else name.removeprefix("standin-")

        def filled(folder: Path) -> None:
            """Configure and build the programs into an empty folder."""
            if name == "sdk":
                options = sdk_options() or []
            elif name.startswith("standin"):
                options = build_standin(Path(f"{folder}_library"), version)
            else:
                options = [f"-DOPEN_FRI_VERSION={version}"]
            options += robot_library(compiler, library)
            options += IN_ONE_UNIT if name != "2.7" else []  # there each file is compiled alone
            targets = {"sanitized": (*TOOLS, FUZZER), **dict.fromkeys(VERSIONS, ("all",))}.get(name, TOOLS)
            build(folder, options, compiler=compiler, flags=flags, targets=targets)

        folder = once(f"fri_{name}", filled)
        if name == "sdk":
            said = subprocess.run([folder / "harness", "version"], capture_output=True, text=True, check=True).stdout
            version = said.split()[-1]
        return Programs(folder, version)

    return make


@pytest.fixture(scope="session")
def client_program(
    once: Once, make_programs: Callable[[str], Programs], robot_library: Callable[[str, str], list[str]]
) -> Callable[[str], Path]:
    """The client of an FRI version, built once for all workers; of 1.15 and 2.5 by clang, with sanitizers.

    Clang gives no warning: of these, and of 2.7 where the fuzzer is built.
    """

    def program(version: str) -> Path:
        """Return the client fri_wiping of an FRI version; other versions than 2.7 are built once for all slow tests."""
        if version == "2.7":  # the others are those of the slow tests
            return make_programs(version).client

        def make(folder: Path) -> None:
            options = [f"-DOPEN_FRI_VERSION={version}", *robot_library("clang", QUICK_SANITIZERS)]
            options += [*compilers("clang", QUICK_SANITIZERS, " -Werror"), *IN_ONE_UNIT]
            run_cmake(["-S", CLIENT, "-B", folder, *options], ["--build", folder, "-j2"])

        return once(f"fri-client-{version}", make) / "fri_wiping"

    return program


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
        """Run emulator and client against each other; `at` has pairs of session time [s] and call with the client's
        process.
        """
        port = free_port()
        files = [tmp_path / f"client-{port}.csv", tmp_path / f"client-{port}.json"]
        for file in files:
            file.unlink(missing_ok=True)
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
            self.quiet = lambda: not unread(port) and waits(process.pid)
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
        log = read_client_log(*files) if all(file.exists() for file in files) else None
        return Run(robot, log, process.returncode, error, said.read_text())

    return run


@pytest.fixture(scope="session")
def robot(plate: ModuleType) -> ModuleType:
    """The robot that the programs are built for."""
    return plate


def some(*names: str) -> list[Any]:
    """Names of programs; those beside 2.7 are slow, and those between oldest and newest wide."""
    marks = {"2.7": (), "sdk": (), "2.5": pytest.mark.wide, "standin-1.15": pytest.mark.wide}
    return [pytest.param(name, marks=marks.get(name, pytest.mark.slow)) for name in names]


SDK = ["sdk"] if sdk_options() else []


@pytest.fixture(scope="session", params=some("1.15", "2.7", "standin-2.7", *SDK))
def programs(request: pytest.FixtureRequest, make_programs: Callable[[str], Programs]) -> Programs:
    """Build the client against the oldest and the newest open library, KUKA's stand-in, and an installed SDK.

    2.5 has the framing of 1.15 and the interface of 2.7; the tests of the wire run in every version (``every``).
    """
    return make_programs(request.param)


@pytest.fixture(scope="session", params=some(*VERSIONS, "standin-1.15", "standin-2.7", *SDK))
def every(request: pytest.FixtureRequest, make_programs: Callable[[str], Programs]) -> Programs:
    """Build the client against the open library in each version, KUKA's stand-ins, and an installed SDK."""
    return make_programs(request.param)


@pytest.fixture(scope="session", params=some(*VERSIONS))
def open_programs(request: pytest.FixtureRequest, make_programs: Callable[[str], Programs]) -> Programs:
    """The client against the open library in each version."""
    return make_programs(request.param)


@pytest.fixture(scope="session")
def one(make_programs: Callable[[str], Programs]) -> Programs:
    """One version, for what does not depend on it."""
    return make_programs("2.7")


@pytest.fixture(scope="session")
def sanitized(make_programs: Callable[[str], Programs]) -> Programs:
    """The client under the address and undefined-behaviour sanitizers, with the fuzz target."""
    return make_programs("sanitized")
