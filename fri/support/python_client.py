# SPDX-License-Identifier: MIT
"""Run sessions of the simulated robot in this process, and a small FRI client in Python."""

from __future__ import annotations

import io
import json
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from fri.robot import __main__ as fri_robot
from fri.robot.messages import Command, IOValue, MessageError, Protocol, SessionState

Answer = Callable[[Any], tuple[Any, Any] | None]


@dataclass
class Outcome:
    """Session as the robot saw it: exit code, output, log and summary."""

    code: int
    text: str
    log: dict[str, np.ndarray]
    summary: dict[str, Any]

    @property
    def states(self) -> list[str]:
        """Return the states in their order."""
        states = self.log["state"]
        return [SessionState(s).name for s in states[np.flatnonzero(np.diff(states, prepend=-1))]]


def emulate(folder: Path, robot: Path, version: str, port: int, *options: object) -> Outcome:
    """Run the robot in this process until the session ends; its log goes to ``folder``."""
    log = folder / f"robot-{port}.npz"
    given = ["--protocol", version, "--port", port, "--robot", robot, "--log", log, *options]
    output = io.StringIO()
    code = fri_robot.run(fri_robot.arguments().parse_args([*map(str, given)]), Console(file=output, width=200))
    with np.load(log) as arrays:
        rows = {name: arrays[name] for name in arrays.files}
    log.unlink()
    return Outcome(code, output.getvalue(), rows, json.loads(str(rows.pop("summary"))))


def free_port() -> int:
    """Return a free UDP port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def follow(message: Any) -> tuple[Any, Any]:
    """Return the measured position and zero torque: the arm floats."""
    return np.array(message.monitorData.measuredJointPosition.value), np.zeros(7)


class PythonClient(threading.Thread):
    """Client that answers each message through a function, until IDLE comes or for 5 s of silence.

    With a ``robot_host`` it accepts datagrams only from that host and its own port number, as the SDK's client does.
    """

    def __init__(
        self, version: str, answer: Answer = follow, outputs: tuple[IOValue, ...] = (), robot_host: str | None = None
    ) -> None:
        """Open the client's socket; `answer` maps a message to position and torque, or to None."""
        super().__init__(daemon=True)
        self.protocol = Protocol(version)
        self.answer = answer
        self.outputs = outputs
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.port = self.socket.getsockname()[1]
        if robot_host is not None:
            self.socket.connect((robot_host, self.port))
        self.seen: list[Any] = []
        self.bad: list[str] = []

    def __enter__(self) -> PythonClient:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.join(10.0)

    def run(self) -> None:
        """Answer messages until the session is IDLE or 5 s pass without one."""
        sent = received = 0
        with self.socket:
            while True:
                try:
                    datagram, address = self.socket.recvfrom(2000)
                    message = self.protocol.decode_monitoring(datagram)
                except TimeoutError:
                    return
                except MessageError as error:
                    self.bad.append(str(error))
                    continue
                self.seen.append(message)
                if message.connectionInfo.sessionState == SessionState.IDLE:
                    return
                values = self.answer(message)
                received += 1
                if values is None or received % message.connectionInfo.receiveMultiplier:
                    continue
                command = Command(sent, message.header.sequenceCounter, *values, self.outputs)
                self.socket.sendto(self.protocol.encode_command(command), address)
                sent += 1
