# SPDX-License-Identifier: MIT
"""Run fri_wiping as a process, with a plain socket in the robot's place."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fri.support.python_client import free_port
from fri.support.session import TRAJECTORY


class Served:
    """Process of the client, which waits for the robot, and the robot's socket.

    A session must not end because this process was slow: give the client IDLE, or a ``--timeout`` to end it.
    """

    def __init__(self, client: subprocess.Popen[str], robot: socket.socket, port: int) -> None:
        self.client = client
        self.robot = robot
        self.port = port

    def send(self, datagram: bytes, sender: socket.socket | None = None) -> None:
        """Send a datagram from the robot, or from another sender."""
        (sender or self.robot).sendto(datagram, ("127.0.0.1", self.port))

    def answer(self, timeout: float = 30.0) -> bytes:
        """Return the next answer; TimeoutError if none comes in the time-out [s]."""
        self.robot.settimeout(timeout)
        return self.robot.recv(2000)

    def ask(self, datagram: bytes) -> bytes:
        """Send a datagram and return the answer."""
        self.send(datagram)
        return self.answer()

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stop the client's process inside the ``with`` statement."""
        self.client.send_signal(signal.SIGSTOP)
        os.waitpid(self.client.pid, os.WUNTRACED)
        yield
        self.client.send_signal(signal.SIGCONT)

    def end(self) -> tuple[int, str, str]:
        """Wait for the client's end; return exit code, output after the first line, and errors."""
        out, errors = self.client.communicate(timeout=60)
        return self.client.returncode, out, errors


@contextmanager
def served(program: Path, *arguments: object, environment: Mapping[str, str] | None = None) -> Iterator[Served]:
    """Start fri_wiping on a free port and wait until it is ready for the robot."""
    port = free_port()
    command = [program, "--trajectory", TRAJECTORY, "--port", port, "--timeout", 30000, *arguments]
    with (
        subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                         env={**os.environ, **(environment or {})}) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
    ):  # fmt: skip
        try:
            assert client.stdout is not None and "waiting" in client.stdout.readline()
            yield Served(client, robot, port)
        finally:
            if client.poll() is None:
                client.kill()


def unread(port: int) -> bool:
    """Return whether datagrams wait in a UDP port of this machine."""
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        _, local, _, _, queues, *_ = line.split()
        if int(local.rpartition(":")[2], 16) == port and int(queues.rpartition(":")[2], 16) > 0:
            return True
    return False


def waits(pid: int) -> bool:
    """Return whether a process's first thread waits or has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "SZ"
    except OSError:
        return True
