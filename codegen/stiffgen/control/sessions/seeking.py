# SPDX-License-Identifier: MIT
"""Session in which a controller goes to commanded poses, in and out of reach, undisturbed and for long enough.

Hostile sessions change too much too often for posture and equilibrium to come to rest short of a commanded pose.
"""

from __future__ import annotations

import numpy as np

from stiffgen.control.sessions.hostile import HostileSession, finite
from stiffgen.control.sessions.library import fill
from stiffgen.core.robot.geometry import FloatArray


class SeekingSession(HostileSession):
    """Session with commands that stay as they are, and an arm that follows the controller's posture, or stays behind.

    Commands by position and by pose take turns. The poses are those of earlier positions, which the arm now has to
    reach from another posture, or any others.
    """

    steps = 4500
    """Number of steps, enough for three poses, or for one to whose nearest point the posture creeps."""

    def _configure(self) -> None:
        """Take the defaults, with a fast equilibrium and weak springs: few steps bring the posture to its goal."""
        config, random, n = self.config, self.random, self.n
        self.both[0].call("default_config", config)
        config.sample_time, config.ramp_time = 5e-3, 0.01
        config.limit_zone = min(config.limit_zone, 0.02)  # less than the default where a joint has a short range
        config.stiffness_cap = 2
        config.tip_velocity_limit, config.tip_rotation_limit = 10.0, 40.0
        fill(config.reference_velocity_limit, random.uniform(20.0, 40.0, n))
        fill(config.velocity_limit, np.full(n, 60.0))
        self.slack = random.random() < 0.5  # springs so weak that an arm that stays behind has no load
        powers = (-3.0, -1.0) if self.slack else (-1.0, 1.0)
        fill(config.posture_stiffness, np.full(n, 10.0 ** random.uniform(*powers)))
        config.engagement_limit, config.energy_limit, config.tank_initial = 50.0, 50.0, 50.0
        self.patient = random.random() < 0.4  # the first command by pose stays to the end

    def _start(self) -> None:
        """Initialise both controllers; the first command is a position."""
        super()._start()
        self.command, self.until = 1, 0
        self.known: list[FloatArray] = []

    def _choose_stiffness(self) -> None:
        """Choose equal stiffnesses in all directions; slack springs leave an arm that stays behind without a load."""
        size = 10.0 ** self.random.uniform(*((-4.0, -2.0) if self.slack else (-2.0, 0.0)))
        tip = np.multiply.outer([500.0, 20.0], np.eye(3)) * size
        self.stiffness = np.stack([tip] * len(self.chain.tips), axis=1)

    def _choose_events(self, number: int) -> None:
        """Command another position, or a pose, and let the arm follow better or worse; reset faults."""
        random = self.random
        if number >= self.until:  # the next command; 1: a position, 2: a pose
            if self.command == 1 and number:
                self.known.append(np.reshape(np.array(self.output.equilibrium), (-1, 4, 4)))
            self.command = 3 - self.command if number else 1
            self.until = number + (200 if self.command == 1 else 1300)
            if self.command == 2 and self.patient:
                self.until = self.steps
            self.goal = random.uniform(self.lower, self.upper)
            self.poses = self._choose_poses()
            probabilities = [0.5, 0.1, 0.4] if self.slack else [0.1, 0.2, 0.7]
            self.following = float(random.choice([0.0, 0.02, 0.3], p=probabilities))  # share per step, see _move
        if self.output.fault and random.random() < 0.02:
            for each in self.both:
                each.call("reset", each.state)

    def _choose_poses(self) -> FloatArray:
        """Return the poses of an earlier position, or poses that lie any turn and up to some metres from the tips."""
        random = self.random
        if len(self.known) > 1 and random.random() < 0.7 and not self.patient:
            return self.known[int(random.integers(len(self.known) - 1))]  # not the last one, where the arm is now
        poses: FloatArray = np.reshape(np.array(self.output.equilibrium), (-1, 4, 4)).copy()
        for pose in poses:
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            pose[:3, :3] = turn * np.linalg.det(turn)
            pose[:3, 3] += random.normal(size=3) * random.choice([0.1, 0.5, 5.0])
        return poses

    def _spoil_sample(self) -> None:
        """Leave samples as they are; write the commanded poses."""
        if self.command == 2:
            fill(self.input.equilibrium, self.poses)

    def _overwrite_state(self) -> None:
        """Leave the states as they are."""

    def _move(self) -> None:
        """Move the arm by a share of its distance from the controller's posture."""
        time = float(self.config.sample_time)
        away = finite(np.array(self.output.reference)) - self.q
        self.dq = (self.following * away / time).clip(-10.0, 10.0)
        self.q = self.q + time * self.dq
