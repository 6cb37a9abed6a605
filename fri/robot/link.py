# SPDX-License-Identifier: MIT
"""UDP socket of the robot."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable

from .messages import MOST_BYTES


class LinkError(Exception):
    """Failure to connect to the client; the text says why."""


class Link:
    """UDP socket of the robot, connected to the client's port.

    A client that takes datagrams from anyone answers to where a datagram came from, so that the robot's own port may be
    any free one. A client that names the robot's host takes datagrams from that address and its own port number alone:
    then choose ``own``. A connected socket reports that nobody listens at the other side. A ``deaf`` one does not, as
    behind a firewall that swallows the report: then silence alone tells that a client is gone.

    Parameters
    ----------
    host, port : str, int
        Address and port of the client.
    deaf : bool
    own : (str, int)
        Address and port that datagrams come from; "" and 0: any.

    """

    def __init__(self, host: str, port: int, deaf: bool = False, own: tuple[str, int] = ("", 0)) -> None:
        """Open the socket to the client; a deaf link takes answers from any address."""
        self.address = f"{host}:{port}"
        self.deaf = deaf
        self._peer = (host, port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind(own)
        except OSError as error:
            self.socket.close()
            raise LinkError(
                f"cannot send from {own[0] or '0.0.0.0'}:{own[1]}: {error.strerror or error}; choose another "
                "--robot-host or --robot-port, or run client and robot in two network namespaces "
                "(docs/fri.md)"
            ) from error
        try:
            if not deaf:
                self.socket.connect(self._peer)
        except OSError as error:
            self.socket.close()
            raise LinkError(f"cannot send to {host}:{port}: {error.strerror or error}") from error
        self._sensor = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def close(self) -> None:
        """Close the sockets."""
        self.socket.close()
        self._sensor.close()

    def send(self, datagram: bytes) -> None:
        """Send; ConnectionRefusedError if nobody listened to the datagram before."""
        if self.deaf:
            self.socket.sendto(datagram, self._peer)
        else:
            self.socket.send(datagram)

    def send_reading(self, reading: Iterable[float], port: int) -> None:
        """Send a sensor's reading (6), little-endian doubles, to a port of this machine, whoever listens."""
        self._sensor.sendto(struct.pack("<6d", *reading), ("127.0.0.1", port))

    def receive(self, timeout: float) -> bytes | None:
        """Return the next datagram, None if none comes in time [s]; ConnectionRefusedError if nobody listens."""
        self.socket.settimeout(max(timeout, 0.0))
        try:
            return self.socket.recv(MOST_BYTES + 1)
        except (TimeoutError, BlockingIOError):
            return None
