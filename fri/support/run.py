# SPDX-License-Identifier: MIT
"""Run the C++ client against the simulated robot over UDP and record both sides."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

from fri.robot.messages import SessionState
from fri.robot.replay import ClientLog, check_commands, compare
from fri.support.python_client import Outcome

versions = pytest.mark.parametrize(
    "version",
    [
        pytest.param("1.15", marks=pytest.mark.slow),
        pytest.param("2.5", marks=pytest.mark.wide),
        "2.7",
    ],
)
"""Parameters for a test in each version of the FRI; 2.7 runs among the quick tests."""
newest = pytest.mark.parametrize(
    "version", [*(pytest.param(name, marks=pytest.mark.wide) for name in ("1.15", "2.5")), "2.7"]
)
"""For what lies above the messages: further versions are wide."""


@dataclass
class Run:
    """Session recorded on both sides."""

    robot: Outcome
    client: ClientLog | None
    code: int
    error: str
    output: str

    @property
    def faults(self) -> dict[str, int]:
        """Return the counters of the client."""
        assert self.client is not None
        return dict(self.client.summary["faults"])

    def check(self, robot: ModuleType) -> None:
        """Check that the torque sent is finite, within limits and rate, and the controller's for its inputs."""
        assert self.client is not None
        commands = check_commands(self.robot.log, self.client.summary)
        assert (commands.not_finite, commands.beyond_limit) == (0, 0)
        assert commands.worst_rate <= 1 + 1e-9
        found = compare(robot, self.client, self.robot.log)
        assert found.compared > 0
        assert max(found.worst, found.worst_step, found.worst_guarded) == 0.0

    def check_sent(self) -> None:
        """Check that the torque sent is finite, and within limits and rate of the robot's time."""
        assert self.client is not None
        commands = check_commands(self.robot.log, self.client.summary)
        assert (commands.not_finite, commands.beyond_limit) == (0, 0)
        assert commands.worst_rate <= 1 + 1e-9

    @property
    def torque(self) -> np.ndarray:
        """Return the torques (commands, 7) [N m] that the robot received in COMMANDING_ACTIVE."""
        log = self.robot.log
        sent: np.ndarray = log["command_torque"][(log["state"] == SessionState.COMMANDING_ACTIVE) & log["has_torque"]]
        return sent
