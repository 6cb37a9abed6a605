"""A little FRI client in Python, for tests of the robot: answers each message with what a function makes of it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from examples.fri_robot.messages import Command, MessageError, Protocol, SessionState

Answer = Callable[[Any], tuple[Any, Any] | None]


def follow(message: Any) -> tuple[Any, Any]:
    """Position as measured, torque zero: the arm floats."""
    return np.array(message.monitorData.measuredJointPosition.value), np.zeros(7)


class PythonClient(threading.Thread):
    """Listens on a port of its own until IDLE comes or it is stopped."""

    def __init__(self, version: str, answer: Answer = follow) -> None:
        super().__init__(daemon=True)
        self.protocol = Protocol(version)
        self.answer = answer
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.port = self.socket.getsockname()[1]
        self.seen: list[Any] = []
        self.bad: list[str] = []
        self.datagrams: list[bytes] = []

    def run(self) -> None:
        count = received = 0
        with self.socket:
            while True:
                try:
                    datagram, address = self.socket.recvfrom(2000)
                except TimeoutError:
                    return
                self.datagrams.append(datagram)
                try:
                    message = self.protocol.decode_monitoring(datagram)
                except MessageError as error:
                    self.bad.append(str(error))
                    continue
                self.seen.append(message)
                if message.connectionInfo.sessionState == SessionState.IDLE:
                    return
                values = self.answer(message)
                received += 1
                if values is None or received % max(message.connectionInfo.receiveMultiplier, 1):
                    continue
                command = Command(count, message.header.sequenceCounter, *values, ())
                self.socket.sendto(self.protocol.encode_command(command), address)
                count += 1
