# SPDX-License-Identifier: MIT
"""Control loop at 1 kHz: policy port, follower, controller and simulated arm, in real time or as fast as it can."""

from __future__ import annotations

import logging
import threading
import time
from types import ModuleType
from typing import Any

import numpy as np

from .simulation import Array, SimulatedArm

PERIOD = 0.001
"""[s] of the control loop."""
LONGEST_BACKLOG = 20
"""Steps that the loop catches up after a delay of the computer; it leaves out the others."""
AT_REST = 1e-3
"""[rad/s] of the fastest joint of an arm that counts as at rest."""


class ControlLoop:
    """Arm under the controller. All methods may be called while the loop runs in its thread.

    Attributes:
        port: policy port.
        in_force: pose of the controller's reference (4, 4), at which the springs are at rest, and the commanded
            stiffness in translation [N/m] and rotation [N m/rad], all of the last step.
        fault: fault of the controller.

    """

    def __init__(
        self, robot: ModuleType, arm: SimulatedArm, controller: Any, real_time: bool, **settings: float
    ) -> None:
        """Start policy and follower at the arm's pose, and the thread if the loop runs in real time."""
        self._robot, self._arm, self._controller = robot, arm, controller
        pose: Array = robot.forward_kinematics(arm.q)
        self._follow = robot.Follow(arm.q, sample_time=PERIOD)
        self.port = robot.Policy(pose=pose, now=0.0, **settings)
        self.in_force: tuple[Array, float, float] = (pose, 0.0, 0.0)
        self.fault = robot.Fault.NONE
        self._steps, self._begin = 0, time.monotonic()
        self._lock, self._stop = threading.RLock(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True) if real_time else None
        if self._thread:
            self._thread.start()

    @property
    def now(self) -> float:
        """Time since the start [s]: of the clock in real time, otherwise of the simulation."""
        return time.monotonic() - self._begin if self._thread else self._steps * PERIOD

    def state(self) -> tuple[Array, Array]:
        """Return joint positions [rad] and velocities [rad/s] of one instant."""
        with self._lock:
            return self._arm.q, self._arm.dq

    def propose(self, stamp: float | None, **parts: Any) -> dict[str, str]:
        """Hand a proposal to the port; return the refused parts and the names of the reasons."""
        with self._lock:
            now = self.now
            refused = self.port.propose(now=now, time=now if stamp is None else stamp, **parts)
        return {part: reason.name for part, reason in refused.items()}

    def advance(self, seconds: float) -> None:
        """Simulate for some time, or wait for it in real time."""
        if self._thread:
            time.sleep(seconds)
            return
        for _ in range(round(seconds / PERIOD)):
            self._step(self._steps * PERIOD)

    def stop(self, springs: dict[str, Array], limit: float = 5.0) -> bool:
        """Lead the arm to rest where it is, close the brakes, end the loop; return whether it came to rest by itself.

        ``springs``, stiffnesses as of a proposal, hold the arm; ``limit`` [s] is the longest time before the brakes
        close.
        """
        q, _ = self.state()
        self.propose(None, pose=self._robot.forward_kinematics(q), **springs)
        end, at_rest = self.now + limit, False
        while not at_rest and self.now < end:
            self.advance(0.02)
            at_rest = bool(np.abs(self.state()[1]).max() < AT_REST)
        self._stop.set()
        if self._thread:
            self._thread.join()
        self._arm.brake()
        return at_rest

    def _step(self, now: float) -> None:
        """Do one cycle at the time `now` [s]: policy, follower, controller, arm."""
        with self._lock:
            command = self.port.command(now)
            springs = {name: getattr(command, name) for name in ("translation_stiffness", "rotation_stiffness")}
            q0 = self._follow.step(pose=command.pose).q0
            out = self._controller.step(
                q=self._arm.q, dq=self._arm.dq, q0=q0, shaped=True, counter=self._steps, **springs
            )
            pose: Array = self._robot.forward_kinematics(out.reference)
            translation, rotation = (float(each[0, 0]) for each in springs.values())
            self.in_force = pose, translation, rotation
            if out.fault != self.fault:
                self.fault = out.fault
                logging.getLogger(__name__).error("controller: %s", out.text or out.fault.name)
            self._arm.step(np.array(out.torque))
            self._steps += 1

    def _run(self) -> None:
        """Follow the clock; after a delay of the computer the simulation is late by what it leaves out."""
        skipped = 0
        while not self._stop.is_set():
            behind = int(self.now / PERIOD) - self._steps - skipped
            skipped += max(behind - LONGEST_BACKLOG, 0)
            for _ in range(min(behind, LONGEST_BACKLOG)):
                self._step((self._steps + skipped) * PERIOD)
            self._stop.wait(PERIOD)
