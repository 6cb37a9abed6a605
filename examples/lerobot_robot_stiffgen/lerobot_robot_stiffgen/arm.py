# SPDX-License-Identifier: MIT
"""Robot of LeRobot: actions are poses of the tip, and go through stiffgen's policy port to its impedance controller."""

from __future__ import annotations

import logging
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import stiffgen

from .config import StiffgenConfig
from .loop import PERIOD, ControlLoop
from .simulation import SimulatedArm, pose_matrix, rotation_vector

POSE = ("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz")
"""Position of the tip [m] and its rotation vector [rad], in the base frame; names as in LeRobot's kinematic steps."""
STIFFNESS = ("stiffness.translation", "stiffness.rotation")
"""Stiffness of the tip in every direction [N/m], and about every axis [N m/rad]."""


class Stiffgen(Robot):  # type: ignore[misc]
    """Simulated arm under stiffgen's impedance controller, which follows actions of 10 to 60 Hz.

    The controller runs at 1 kHz, in simulated time or in real time (``config.real_time``). The policy port interpolates
    actions, holds late ones, fades the springs under stale ones, and refuses what is no pose. The arm has no gripper.

    Attributes:
        refused: parts of the last action that were refused, and the names of the reasons. After a fault, "controller"
            is one of them: the springs are off until the robot is connected anew.

    """

    config_class = StiffgenConfig
    name = "stiffgen"

    def __init__(self, config: StiffgenConfig) -> None:
        super().__init__(config)
        self.config = config
        self.refused: dict[str, str] = {}
        self._loop: ControlLoop | None = None

    @cached_property
    def model(self) -> Any:
        """Python module of the generated robot."""
        path = self.config.robot
        if path.is_dir():
            return stiffgen.open_robot(path).module
        return stiffgen.load(path, tip=self.config.tip, base=self.config.base).module

    @cached_property
    def observation_features(self) -> dict[str, type]:
        """Positions JOINT.pos [rad], velocities JOINT.vel [rad/s], and the pose of the tip: ee.* as in actions."""
        joints = self.model.JOINTS
        return dict.fromkeys([*(f"{j}.pos" for j in joints), *(f"{j}.vel" for j in joints), *POSE], float)

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Pose of the tip in the base frame, ee.x, ee.y, ee.z [m] and rotation vector ee.wx, ee.wy, ee.wz [rad].

        With ``variable_stiffness`` also stiffness.translation [N/m] and stiffness.rotation [N m/rad].
        """
        return dict.fromkeys([*POSE, *(STIFFNESS if self.config.variable_stiffness else ())], float)

    @property
    def is_connected(self) -> bool:
        """Whether the control loop runs."""
        return self._loop is not None

    @property
    def is_calibrated(self) -> bool:
        """Always true: a simulated arm needs no calibration."""
        return True

    @property
    def loop(self) -> ControlLoop:
        """Control loop.

        Raises:
            DeviceNotConnectedError: the robot is not connected.

        """
        if self._loop is None:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first")
        return self._loop

    def connect(self, calibrate: bool = True) -> None:
        """Put the simulated arm to ``start``, at rest and without stiffness, and start the control loop.

        Raises:
            DeviceAlreadyConnectedError: the robot is connected.
            ValueError: ``start`` or ``model`` does not fit the robot.

        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected; call disconnect() first")
        config, robot = self.config, self.model
        if len(config.start) != robot.DOF:
            raise ValueError(f"start: {len(config.start)} positions, but the robot has {robot.DOF}: {robot.JOINTS}")
        if config.model is None and config.robot.is_dir():
            raise ValueError(f"{config.robot}: a folder has no model for MuJoCo; set model to the URDF or MJCF file")
        controller = robot.Impedance(
            sample_time=PERIOD,
            delay_samples=0,  # of the simulation
            motor_inertia=config.motor_inertia,
            heaviest_wrench=(config.heaviest_force, config.heaviest_moment),
        )
        file = Path(config.model or config.robot)
        arm = SimulatedArm(file, list(robot.JOINTS), config.start, controller.config.motor_inertia, PERIOD)
        times = {"hold_time": config.validity, "fade_time": config.fade_time}
        self._loop = ControlLoop(robot, arm, controller, config.real_time, **times)
        self.configure()

    def calibrate(self) -> None:
        """Do nothing: a simulated arm needs no calibration."""

    def configure(self) -> None:
        """Do nothing: the configuration is applied by :meth:`connect`."""

    def get_observation(self) -> dict[str, float]:
        """Return the state of the arm; keys and units are those of ``observation_features``."""
        q, dq = self.loop.state()
        values = np.concatenate([q, dq, _pose_values(self.model.forward_kinematics(q))])
        return dict(zip(self.observation_features, values.tolist(), strict=True))

    def send_action(self, action: dict[str, Any], stamp: float | None = None) -> dict[str, float]:
        """Hand an action to the policy port.

        Without real time, the simulation then advances by 1/``command_rate``.

        Args:
            action: values of ``action_features``, in their units.
            stamp: time at which the action was made, on the clock of ``loop.now`` [s]. Default: now.

        Returns:
            The action in force: pose of the controller's reference, which follows the action, and stiffness. In real
            time the method returns at once, and the action has only begun.

        Raises:
            ValueError: a key is missing or unknown. The arm is not told.

        """
        names = list(self.action_features)
        if set(action) != set(names):
            wrong = sorted(set(action) ^ set(names))
            raise ValueError(
                f"action: missing or unknown {', '.join(map(repr, wrong))}; the keys are {', '.join(names)}"
            )
        values = {name: float(action[name]) for name in names}
        self.refused = self.loop.propose(
            stamp,
            pose=pose_matrix([values[name] for name in POSE[:3]], [values[name] for name in POSE[3:]]),
            **self._springs(values),
        )
        if not self.config.real_time:
            self.loop.advance(1.0 / self.config.command_rate)
        if self.loop.fault:
            self.refused["controller"] = self.loop.fault.name
        if self.refused:
            reasons = ", ".join(f"{part}: {reason}" for part, reason in self.refused.items())
            logging.getLogger(__name__).warning("action refused (%s): %s", reasons, values)
        pose, *stiffness = self.loop.in_force
        return dict(zip(names, [*_pose_values(pose), *stiffness], strict=False))

    def disconnect(self) -> None:
        """Lead the arm to rest where it is, close its brakes and end the control loop.

        Raises:
            DeviceNotConnectedError: the robot is not connected.

        """
        at_rest = self.loop.stop(self._springs({}))
        self._loop = None
        if not at_rest:
            logging.getLogger(__name__).warning("%s did not come to rest; its brakes stopped it", self)

    def _springs(self, action: dict[str, float]) -> dict[str, Any]:
        """Return the stiffnesses (3, 3) of an action; what the action lacks is the configuration's."""
        parts, config = ("translation_stiffness", "rotation_stiffness"), self.config
        return {
            part: action.get(name, getattr(config, part)) * np.eye(3)
            for name, part in zip(STIFFNESS, parts, strict=True)
        }


def _pose_values(pose: Any) -> list[float]:
    return [*map(float, pose[:3, 3]), *map(float, rotation_vector(pose[:3, :3]))]
