# SPDX-License-Identifier: MIT
"""Build the FRI client's test programs, and make sessions for them with the robot's independent codec."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import cmake
import ninja
import numpy as np

from fri.robot.messages import (
    CommandMode,
    IODirection,
    IOType,
    IOValue,
    Monitoring,
    Protocol,
    Quality,
    SessionState,
)
from support.plate import EXACT
from support.project import ROOT

TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
POSTURE = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
TIMEOUT = None
"""Silence in place of a datagram."""

FULL = (
    "--effort-share",
    "1",
    "--torque-rise",
    "0.1",
    "--error-limit",
    "0",
    "--lag-limit",
    "0",
    "--energy-limit",
    "0",
    "--force-limit",
    "0",
)
"""Options for the robot's full effort and an immediate start, because the arm of a script does not follow."""

FUZZER = "fri_fuzz"
"""The target for libFuzzer, which clang alone builds."""
SANITIZERS = "-O1 -g1 -fsanitize=address,undefined -fno-sanitize-recover=all"
QUICK_SANITIZERS = SANITIZERS.replace("-O1", "-O0")
"""The same for short runs: clang takes a minute of optimising with both sanitizers for the kernels alone."""


IN_ONE_UNIT = ["-DCMAKE_UNITY_BUILD=ON", "-DCMAKE_UNITY_BUILD_BATCH_SIZE=0"]
"""CMake options: each target's sources in one unit. Headers take most of the compiler's time, half of it in all."""


def run_cmake(*commands: Sequence[object]) -> None:
    """Run CMake once for each list of arguments."""
    for arguments in commands:
        command = [Path(cmake.CMAKE_BIN_DIR) / "cmake", *arguments]
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
        assert done.returncode == 0, " ".join((done.stdout[-4000:] + done.stderr[-4000:]).split())


def compilers(compiler: str, flags: str, more: str = "") -> list[str]:
    """Return CMake options for a build with these flags and no others; ``more``: flags for C++ alone."""
    return [
        "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={Path(ninja.BIN_DIR) / 'ninja'}", "-DCMAKE_BUILD_TYPE=None",
        f"-DCMAKE_C_COMPILER={compiler}", f"-DCMAKE_CXX_COMPILER={compiler.replace('gcc', 'g')}++",
        f"-DCMAKE_C_FLAGS={flags}", f"-DCMAKE_CXX_FLAGS={flags}{more}",
    ]  # fmt: skip


def build_robot(robot: Path, folder: Path, *, compiler: str, flags: str) -> list[str]:
    """Build and install a robot's library, of one vector width; return the CMake options for the client to find it."""
    name, root = robot.name, folder / "installed"
    run_cmake(
        ["-S", robot, "-B", folder, f"-D{name.upper()}_DISPATCH=OFF", *compilers(compiler, f"{flags} {EXACT}")],
        ["--build", folder, "-j2"],
        ["--install", folder, "--prefix", root],
    )
    return [f"-DROBOT_NAME={name}", f"-D{name}_DIR={root / 'lib' / 'cmake' / name}"]


def build_standin(folder: Path, version: str) -> list[str]:
    """Build the library that stands in for KUKA's; return the CMake options with which the client finds it."""
    source, root = ROOT / "fri" / "support" / "native" / "standin", folder / "installed"
    run_cmake(
        ["-S", source, "-B", folder, f"-DFRI_VERSION={version}", *compilers("gcc", "-O1")],
        ["--build", folder],
        ["--install", folder, "--prefix", root],
    )
    return [f"-DFRI_SDK_ROOT={root}", f"-DFRI_SDK_VERSION={version}"]


def build(
    folder: Path, options: Sequence[str], *, compiler: str, flags: str, targets: Sequence[str] = ("all",)
) -> Path:
    """Configure and build targets of fri/support/native with warnings as errors; return the folder of the programs."""
    fuzzer = FUZZER in targets
    # Coverage guides the fuzzer through the client alone: coverage of the controller only takes time.
    more = " -std=c++11 -Werror" + (" -fsanitize=fuzzer-no-link" if fuzzer else "")
    run_cmake(
        [
            "-S", ROOT / "fri" / "support" / "native", "-B", folder, f"-DFRI_FUZZER={'ON' if fuzzer else 'OFF'}",
            "-DIIWA14_DISPATCH=OFF", *compilers(compiler, flags, more), *options,
        ],
        ["--build", folder, "-j2", "--target", *targets],
    )  # fmt: skip
    return folder


class RobotScript:
    """Messages of the robot in a session: counts them and advances the robot's clock by the period.

    ``add`` takes fields of :class:`Monitoring` and ``change``, a function that may alter the protobuf message before
    it becomes a datagram.
    """

    def __init__(self, version: str, period: int = 5) -> None:
        self.protocol = Protocol(version)
        self.period = period
        self.sequence = 0
        self.clock = 1_700_000_000_000_000_000
        self.datagrams: list[bytes | None] = []

    def message(self, state: int, change: Callable[[Any], object] | None = None, **fields: Any) -> bytes:
        """Return the next message of the robot, with given fields, changed before it is encoded."""
        self.sequence += 1
        self.clock += self.period * 1_000_000
        commanding = state in (SessionState.COMMANDING_WAIT, SessionState.COMMANDING_ACTIVE)
        told = {
            "state": state, "quality": Quality.EXCELLENT, "send_period": self.period, "sequence": self.sequence,
            "sent_at": self.clock, "position": POSTURE, "ipo": POSTURE if commanding else None,
            "command_mode": CommandMode.TORQUE if commanding else CommandMode.NO_COMMAND_MODE, **fields,
        }  # fmt: skip
        message = self.protocol.monitoring_message(Monitoring(**told))
        if change is not None:
            change(message)
        return self.protocol.frame(message.SerializePartialToString())

    def add(self, state: int, count: int = 1, change: Callable[[Any], object] | None = None, **fields: Any) -> None:
        self.datagrams += [self.message(state, change, **fields) for _ in range(count)]

    def add_resting(self, count: int, change: Callable[[Any], object] | None = None) -> None:
        """Add an arm that rests but for the noise of its encoders: no position stands still to the last bit."""
        for _ in range(count):
            self.add(SessionState.COMMANDING_ACTIVE, 1, change, position=POSTURE + 1e-5 * (len(self.datagrams) % 3))

    def lose(self, count: int) -> None:
        """Add messages that never reach the client."""
        self.sequence += count
        self.clock += count * self.period * 1_000_000

    def begin(self, monitoring: int = 3, waiting: int = 3) -> None:
        """Add the messages up to COMMANDING_ACTIVE."""
        self.add(SessionState.MONITORING_WAIT, monitoring)
        self.add(SessionState.MONITORING_READY, monitoring)
        self.add(SessionState.COMMANDING_WAIT, waiting)


def write_short_trajectory(file: Path, start: Sequence[float] = tuple(POSTURE)) -> Path:
    """Write a trajectory of 1 s from a configuration, at rest at both ends, with samples 5 ms apart."""
    s = np.linspace(0.0, 1.0, 201)
    way = 10 * s**3 - 15 * s**4 + 6 * s**5
    np.savetxt(file, start + 0.2 * np.outer(way, [1, -1, 1, 1, -1, -1, 1]), delimiter=",", fmt="%.10f")
    return file


def button(pressed: bool) -> IOValue:
    """Return the value of the button at the media flange."""
    return IOValue("MediaFlange.UserButton", IOType.BOOLEAN, IODirection.INPUT, pressed)


def pack(datagrams: Iterable[bytes | None]) -> bytes:
    """Return datagrams in the format that the test programs read."""
    return b"".join(struct.pack("<I", 0xFFFFFFFF) if d is None else struct.pack("<I", len(d)) + d for d in datagrams)


def run_harness(folder: Path, datagrams: Iterable[bytes | None], *arguments: str | Path) -> list[dict[str, Any]]:
    """Return one dictionary per datagram with the client's reaction; in probe mode the statistics come last."""
    command = [str(folder / "harness"), *map(str, arguments)]
    done = subprocess.run(command, input=pack(datagrams), capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-4000:]
    return [json.loads(line) for line in done.stdout.decode().splitlines() if line.startswith("{")]


class Programs:
    """Folder with the test programs, and their version of the FRI."""

    def __init__(self, folder: Path, version: str) -> None:
        self.folder = folder
        self.version = version

    @property
    def client(self) -> Path:
        """Return the path of fri_wiping."""
        return self.folder / "client" / "fri_wiping"

    def script(self, period: int = 5) -> RobotScript:
        """Return a robot's script in this version."""
        return RobotScript(self.version, period)

    def probe(self, script: RobotScript) -> list[dict[str, Any]]:
        """Return the steps of a client that calls everything, on a script."""
        return run_harness(self.folder, script.datagrams, "probe")


def require_tools() -> str | None:
    """Return the tools that are missing to build the client against the open library, or None."""
    missing = [tool for tool in ("g++", "clang++", "protoc") if shutil.which(tool) is None]
    if not shutil.which("nanopb_generator.py") and not shutil.which("nanopb_generator"):
        missing.append("nanopb")
    return f"{', '.join(missing)} missing; .ci/run installs them" if missing else None


def sdk_options() -> list[str] | None:
    """Return CMake options for an installed KUKA SDK, or None without one."""
    root = os.environ.get("FRI_SDK_ROOT")
    version = os.environ.get("FRI_SDK_VERSION")
    return [f"-DFRI_SDK_ROOT={root}", *([f"-DFRI_SDK_VERSION={version}"] if version else [])] if root else None


def write_session(folder: Path, version: str) -> dict[str, str]:
    """Write session and corpus for the fuzz target; return the environment that it needs."""
    script = RobotScript(version)
    ios = [button(False), IOValue("Group.Level", IOType.ANALOG, IODirection.OUTPUT, 0.5)]
    script.begin(1, 1)
    rng = np.random.default_rng(1)
    script.add(4, external_torque=rng.normal(size=7), ios=ios)
    hostile = script.message(4, ios=ios)
    script.add(4, ios=ios)
    (folder / "session").write_bytes(pack(script.datagrams))
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    body = script.protocol.unframe(hostile)
    # The corpus: a first byte of 1 asks the fuzzer to frame the body, 0 to take the bytes as they are.
    sound = {"framed": b"\x01" + body, "raw": b"\x00" + hostile, "empty": b"", "long": b"\x00" + 1600 * b"\x0a"}
    for state in range(5):
        sound[f"state{state}"] = b"\x01" + script.protocol.unframe(script.message(state, ios=ios))
    sound["six"] = b"\x01" + script.protocol.unframe(
        script.message(4, lambda m: m.monitorData.measuredJointPosition.value.pop())
    )
    sound["length"] = b"\x00" + struct.pack("<I", 0xFFFFFFFF) + hostile[4:]
    for name, data in sound.items():
        (corpus / name).write_bytes(data)
    return {"FRI_FUZZ_SESSION": str(folder / "session"), "FRI_FUZZ_TRAJECTORY": str(TRAJECTORY)}


def fuzz(programs: Path, folder: Path, version: str, libfuzzer: Sequence[str]) -> int:
    """Run the fuzz target in the folder, which keeps its corpus, with libFuzzer's options; return its exit code."""
    # A small quarantine: pages met for the first time would take most of the time.
    environment = {"ASAN_OPTIONS": "quarantine_size_mb=8", **os.environ, **write_session(folder, version)}
    found = f"-artifact_prefix={folder}/"
    command = [str(programs / FUZZER), str(folder / "corpus"), "-max_len=1700", found, *libfuzzer]
    return subprocess.run(command, env=environment, check=False).returncode
