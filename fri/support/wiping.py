# SPDX-License-Identifier: MIT
"""Run the wiping client in process and as a program, with sessions written message by message."""

from __future__ import annotations

import contextlib
import json
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fri.robot.messages import SessionState
from fri.robot.replay import read_client_log
from fri.support.served import served
from fri.support.session import FULL, POSTURE, TRAJECTORY, Programs, RobotScript, run_harness

IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE = SessionState


def position_mode(message: Any) -> None:
    message.ipoData.clientCommandMode = 1


class Wiped:
    """Session of the wiping client: its steps, log and summary."""

    def __init__(self, programs: Programs, script: RobotScript, folder: Path, *options: str) -> None:
        """Run the client on the script's messages; its log, summary and commands (None: not sent) are read back."""
        files = (folder / "log.csv", folder / "summary.json")
        arguments = ("wiping", *map(str, files), "--trajectory", str(TRAJECTORY), *FULL, *options)
        self.steps = run_harness(programs.folder, script.datagrams, *arguments)
        self.summary = json.loads(files[1].read_text())
        self.faults = self.summary["faults"]
        self.log = read_client_log(*files)
        self.commands = [
            script.protocol.decode_command(bytes.fromhex(step["sent"])) if step["sent"] else None for step in self.steps
        ]


def minimum_jerk(time: float, duration: float, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    s = min(time / duration, 1.0)
    place, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    return start + place * (end - start), rate * (end - start)


def moving(robot: ModuleType, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a motion of the arm near the start: position, a wrench of the environment, and its joint torque."""
    q = POSTURE + 0.05 * np.sin(2 * np.pi * (0.3 + 0.1 * np.arange(7)) * time)
    wrench = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0]) * np.sin(2 * np.pi * 0.7 * time)
    return q, wrench, robot.hybrid.jacobian(q).T @ wrench


def moving_script(programs: Programs, robot: ModuleType, cycles: int) -> RobotScript:
    script = programs.script()
    script.begin()
    for k in range(cycles):
        q, _, torque = moving(robot, k * 0.005)
        script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
    return script


def assert_safe(wiped: Wiped, robot: ModuleType) -> None:
    """Assert that every torque sent is finite and within the limits of torque and rate."""
    last = np.zeros(7)
    for command in wiped.commands:
        if command is None or command.torque is None:
            continue
        assert np.isfinite(command.torque).all()
        assert command.position is not None and np.isfinite(command.position).all()
        assert (np.abs(command.torque) <= robot.EFFORT).all()
        if not command.torque.any():  # the client waits: a new start
            last = np.zeros(7)
        assert (np.abs(command.torque - last) <= 10 * robot.EFFORT * 0.005 * (1 + 1e-8)).all()
        last = command.torque


def fri_wiping(programs: Programs, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [programs.client, *arguments]
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=60)


def over_udp(
    programs: Programs, script: RobotScript, *arguments: str | Path, environment: dict[str, str] | None = None
) -> tuple[int, str, str]:
    """Run fri_wiping on a script's datagrams, one after the other; IDLE gets no answer."""
    with served(programs.client, "--simulated-time", *arguments, environment=environment) as session:
        for datagram in script.datagrams:
            assert datagram is not None
            session.send(datagram)
            state = script.protocol.decode_monitoring(datagram).connectionInfo.sessionState
            while state != IDLE and session.client.poll() is None:
                with contextlib.suppress(TimeoutError):
                    session.answer(0.2)
                    break
        return session.end()
