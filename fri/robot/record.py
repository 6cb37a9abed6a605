# SPDX-License-Identifier: MIT
"""Record a session: the messages of each cycle, as arrays in one NPZ file."""

from __future__ import annotations

import hashlib
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .messages import JOINTS

ROW = np.dtype(
    [
        ("time", "f8"),  # s of the robot's clock since the session began
        ("timestamp", "i8"),  # ns, as sent
        ("sequence", "u4"),  # of the monitoring message
        ("reflected", "u4"),  # command counter that it reflects
        ("state", "i1"),
        ("quality", "i1"),
        ("safety", "i1"),
        ("command_mode", "i1"),
        ("button", "?"),  # MediaFlange.UserButton
        ("tracking", "f8"),
        ("q", "f8", JOINTS),  # rad, measured
        ("dq", "f8", JOINTS),  # rad/s, true, not sent
        ("torque", "f8", JOINTS),  # N m, measured
        ("external_torque", "f8", JOINTS),  # N m
        ("sent_position", "f8", JOINTS),  # rad, last commanded, as sent
        ("sent_torque", "f8", JOINTS),  # N m, last commanded, as sent
        ("ipo", "f8", JOINTS),  # rad, NaN: not sent
        ("pose", "f8", 7),  # mm, quaternion w x y z; NaN where the version does not send it
        ("wrench", "f8", 6),  # N, N m, of the environment on the robot at the tip, base axes; 2.7 sends it
        ("in_contact", "?"),
        ("robot_fault", "i1"),  # index into faults.KINDS of what hit the sent datagram, -1: nothing
        ("client_fault", "i1"),  # the same for the last datagram received
        ("received", "i4"),  # datagrams received
        ("accepted", "i4"),  # commands accepted; the following are of the last of them
        ("command_sequence", "i8"),  # -1: none
        ("command_reflects", "i8"),  # -1: none
        ("has_position", "?"),  # whether that command has a position
        ("has_torque", "?"),  # and a torque
        ("command_position", "f8", JOINTS),  # rad, NaN: not commanded
        ("command_torque", "f8", JOINTS),  # N m, NaN: not commanded
        ("applied_torque", "f8", JOINTS),  # N m, by the controller in the last step of the cycle, compensation excluded
        ("latency", "f8"),  # s of wall time from sending to the accepted answer, NaN: none; not in the digest
    ]
)
BLOCK = 8192


class Recorder:
    """Rows of a session, kept in blocks, written at the end."""

    def __init__(self) -> None:
        self._blocks: list[Any] = []
        self._used = BLOCK

    def new_row(self) -> Any:
        """Return the next row of the log, zeroed, to be filled in."""
        if self._used == BLOCK:
            self._blocks.append(np.zeros(BLOCK, ROW))
            self._used = 0
        self._used += 1
        return self._blocks[-1][self._used - 1]

    @property
    def rows(self) -> Any:
        """Return all rows so far, (cycles,) with the fields of ROW."""
        if not self._blocks:
            return np.zeros(0, ROW)
        return np.concatenate([*self._blocks[:-1], self._blocks[-1][: self._used]])

    def write(self, file: Path, summary: dict[str, Any]) -> None:
        """Write one array for each field of ROW and ``summary`` (JSON), the whole file or nothing."""
        rows = self.rows
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=f".{file.name}.", delete=False) as stream:
            try:
                np.savez(stream, summary=json.dumps(summary), **{name: rows[name] for name in ROW.names or ()})
                Path(stream.name).chmod(0o644)
                Path(stream.name).replace(file)
            except BaseException:
                Path(stream.name).unlink(missing_ok=True)
                raise


def digest(rows: Any) -> str:
    """Return the SHA-256 of a log without its wall times: equal for equal sessions."""
    total = hashlib.sha256()
    for name in rows.dtype.names:
        if name != "latency":
            total.update(np.ascontiguousarray(rows[name]).tobytes())
    return total.hexdigest()
