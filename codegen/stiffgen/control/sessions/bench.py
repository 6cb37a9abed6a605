# SPDX-License-Identifier: MIT
"""A controller at a drawn configuration, with poses, masses and springs for the law that it is compared with."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiffgen.control.page import pairs_of
from stiffgen.control.sessions.law import PERIOD, SpringArguments, differences, energy_of_all
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray

_STATED = {"sample_time": PERIOD, "delay_samples": 0, "motor_inertia": 0.5, "heaviest_wrench": (1e4, 1e4)}
"""Configuration fields without a default."""


class ControllerBench:
    """Robot's controller with samples around one configuration, close to which all limits lie.

    ``reach`` is the distance [rad or m] that each joint moves from ``q`` in these sessions. ``spring`` has the
    stiffnesses, ``tools`` the tools of a robot that takes them.
    """

    def __init__(self, robot: GeneratedRobot, seed: int) -> None:
        """Draw a configuration within the limits, tools and springs [N/m, N m/rad] of all tips and pairs."""
        self.robot, chain = robot, robot.chain
        self.random = np.random.default_rng(seed)
        lower, upper = self._bounds()
        span = upper - lower
        self.q = lower + span * self.random.uniform(0.35, 0.65, len(span))  # the middle third of each range
        self.reach = float(min(0.1, 0.2 * np.abs(span).min()))
        self.pairs = [(each.first, each.second) for each in pairs_of(chain, robot.springs.pairs)]
        tips = len(chain.tips)
        self.tools = np.broadcast_to(np.eye(4), (tips, 4, 4)).copy()
        # [m] off all axes, different for each tip
        self.tools[:, :3, 3] = np.array([0.02, -0.03, 0.1]) + np.arange(tips)[:, None] * (0.05, 0.0, 0.0)
        self.Kt, self.Ko = self._drawn_stiffness(tips + 2 * len(self.pairs))
        if tips == 1:  # the controller of one tip takes no axis over tips
            self.tools, self.Kt, self.Ko = self.tools[0], self.Kt[0], self.Ko[0]
        self.spring = {"translation_stiffness": self.Kt, "rotation_stiffness": self.Ko}
        self.count = 0

    def _drawn_stiffness(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return translational and rotational stiffnesses (count, 3, 3), of the size 300 N/m and 20 N m/rad.

        A A^T / 3 of a random A is positive semidefinite of the size 1; 0.3 on its diagonal make it definite.
        """
        roots = self.random.normal(size=(2, count, 3, 3))
        translation, rotation = roots @ np.swapaxes(roots, 2, 3) / 3 + 0.3 * np.eye(3)
        return translation * 300.0, rotation * 20.0

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the motors' positions; with closed loops they are near a closed configuration."""
        chain = self.robot.chain
        if chain.loops:
            middle = np.array(chain.start)[list(chain.actuated)]
            return middle - 0.15, middle + 0.15  # [rad or m]
        limits = np.array([c.range_within(1.5) for c in chain.motor_coordinates])
        return limits[:, 0], limits[:, 1]

    def joints(self, q: FloatArray) -> FloatArray:
        """Return the positions of all joints at the motors' positions q."""
        chain = self.robot.chain
        return np.asarray(self.robot.kernels["close"](q, np.array(chain.start))) if chain.loops else q

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return the motors' mass matrix: G^T M G with closed loops, G = d joints/dq by differences."""
        M = np.asarray(self.robot.kernels["mass_matrix"](self.joints(q)))
        if not self.robot.chain.loops:
            return M
        G = differences(self.joints, q).T
        return np.asarray(G.T @ M @ G)

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses (tips, 4, 4) of all tips at the motors' positions q, from the kernels."""
        chain, kernels = self.robot.chain, self.robot.kernels
        joints = self.joints(q)
        prefixes = [""] if len(chain.tips) == 1 else [f"{tip.name}_" for tip in chain.tips]
        found = []
        for prefix, tool in zip(prefixes, np.reshape(self.tools, (-1, 4, 4)), strict=True):
            forward_kinematics = kernels[f"{prefix}forward_kinematics"]
            found.append(forward_kinematics(joints, tool) if chain.runtime_tool else forward_kinematics(joints))
        return np.array(found)

    def controller(self, *, rests: int = 5, **config: Any) -> Any:
        """Return a controller engaged at rest at q, with limits beyond reach except for those in ``config``.

        The positions are coarse: an arm that stays where it is to the last bit is no frozen encoder.
        """
        fields: dict[str, Any] = {
            **_STATED, "lower_limit": self.q - 4 * self.reach, "upper_limit": self.q + 4 * self.reach,
            "velocity_limit": 10.0, "effort_limit": 1e4, "torque_rate_limit": 1e8, "tip_velocity_limit": 100.0,
            "tank_initial": 1e4, "position_quantum": 1e-5,
        }  # fmt: skip
        if self.robot.chain.runtime_tool:
            fields["tool_pose"] = self.tools
        self.count = 0
        controller = self.robot.module.Impedance(**{**fields, **config}, errors="ignore")
        for _ in range(rests):
            self.rest(controller)
        return controller

    def step(self, controller: Any, **given: Any) -> Any:
        """Step once, at the next sample time."""
        self.count += 1
        return controller.step(counter=self.count, **{**self.spring, **given})

    def rest(self, controller: Any, **changed: Any) -> Any:
        """Step once at q, at rest."""
        return self.step(controller, **{"q": self.q, "dq": np.zeros(len(self.q)), "q0": self.q, **changed})

    def springs_of(self, equilibrium: FloatArray, posture: FloatArray, posture_stiffness: Any) -> SpringArguments:
        """Return the springs at rest at poses of the tips, and the posture spring at joint positions."""
        return SpringArguments(
            equilibrium, posture, self.Kt, self.Ko, posture_stiffness, self.robot.springs.placement, self.pairs
        )

    def energy(self, tip: int, here: FloatArray, equilibria: FloatArray, pose: FloatArray) -> float:
        """Return the springs' energy [J] with the tips at poses ``here`` (tips, 4, 4), but one at another pose."""
        poses = here.copy()
        poses[tip] = pose
        return float(energy_of_all(poses, equilibria, self.Kt, self.Ko, self.robot.springs.placement, self.pairs))

    def status(self, out: Any, *names: str) -> bool:
        """Return whether any of the bits is set."""
        return any(out.status & self.robot.module.Status[name] for name in names)
