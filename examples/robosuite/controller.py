# SPDX-License-Identifier: MIT
"""Impedance controller as a part of a robosuite robot.

robosuite 1.5 builds its part controllers from a fixed list of names; the place where a package adds its own is the
register of composite controllers. The composite controller "STIFFGEN" makes the arm's part controller of the type
"STIFFGEN_IMPEDANCE", and leaves all other parts to robosuite. Importing this module registers it.

Actions are those of OSC_POSE: the goals are robosuite's own code, and the law alone is another. A goal goes through the
controller's policy port, with the time of the simulation as its stamp: the port interpolates between goals.
"""

from __future__ import annotations

import tempfile
from collections import OrderedDict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from robosuite.controllers import controller_factory, load_composite_controller_config
from robosuite.controllers.composite.composite_controller import CompositeController, register_composite_controller
from robosuite.controllers.parts.arm import OperationalSpaceController
from robosuite.utils.log_utils import ROBOSUITE_DEFAULT_LOGGER

import stiffgen

COMPOSITE, PART = "STIFFGEN", "STIFFGEN_IMPEDANCE"
REPEATED = 0.05  # s, after which an old goal is proposed again, so that it does not fade
KP = (400.0, 400.0, 400.0, 20.0, 20.0, 20.0)  # N/m, N m/rad
VELOCITY_LIMITS = {
    "Panda": (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),  # Franka Control Interface documentation
    "Sawyer": (1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),  # URDF of Rethink Robotics' sawyer_description
    "IIWA": (1.710, 1.710, 1.745, 2.268, 2.443, 3.141, 3.141),  # KUKA, LBR iiwa 7 R800: 98 to 180 deg/s
    "UR5e": (3.141,) * 6,  # Universal Robots: 180 deg/s
    "Kinova3": (1.396,) * 4 + (1.221,) * 3,  # URDF of Kinova's kortex_description, Gen3 with seven joints
}
"""Joint velocity limits [rad/s] of the makers, which robosuite's MJCF does not have."""


class ImpedancePart(OperationalSpaceController):  # type: ignore[misc]
    """Part controller of an arm; ``kp`` is the stiffness of the tip, in N/m and N m/rad, in the base's axes.

    The tip is the grip site, the base the body that carries the arm's first joint. ``robot_xml`` is the MJCF of arm and
    gripper, ``impedance`` has fields of the controller's configuration. ``output`` is the output of the latest step.
    """

    def __init__(self, *, robot_xml: str, kp: Any = KP, damping_ratio: float = 1.0, impedance: Any = None, **rest: Any):
        if rest.get("impedance_mode", "fixed") == "variable":
            raise ValueError(f"{PART}: the damping ratio is constant; set impedance_mode to 'fixed' or 'variable_kp'")
        if rest.get("interpolation") is not None:
            raise ValueError(f"{PART}: the governor moves the goal; set interpolation to null")
        super().__init__(kp=kp, damping_ratio=damping_ratio, **rest)
        model = self.sim.model
        first = min(int(model.jnt_bodyid[joint]) for joint in self.joint_index)  # MuJoCo numbers parents first
        self.base_body = int(model.body_parentid[first])
        robot = load_robot(robot_xml, rest["robot_name"], self.ref_name, model.body_id2name(self.base_body))
        names = [coordinate.name for coordinate in robot.chain.coordinates]
        if sorted(names) != sorted(self.joint_names):
            raise ValueError(f"{PART}: the chain moves {names}, but robosuite's arm {self.joint_names}")
        self.module = robot.module
        self.order = [self.joint_names.index(name) for name in names]  # place of the chain's joints among robosuite's
        limit = (impedance or {}).get("velocity_limit", VELOCITY_LIMITS.get(rest["robot_name"]))
        if limit is None:
            raise ValueError(f"{PART}: {rest['robot_name']} has no velocity limits; set impedance['velocity_limit']")
        self.settings: dict[str, Any] = {
            "sample_time": float(model.opt.timestep),
            "damping_ratio": damping_ratio,
            "motor_inertia": model.dof_armature[self.qvel_index][self.order],
            "effort_limit": np.minimum(-self.actuator_min, self.actuator_max)[self.order],
            "velocity_limit": limit,
            "reference_velocity_limit": 0.9 * np.asarray(limit),
            "stiffness_cap": "accept",
        } | (impedance or {})
        self.controller: Any = None
        self.port: Any = None
        self.output: Any = None
        self.proposed: tuple[float, np.ndarray] = (-np.inf, np.zeros(22))

    def reset_goal(self, goal_update_mode: str = "achieved") -> None:
        """Set the goal to the present pose; the next step starts the controller anew."""
        super().reset_goal(goal_update_mode)
        self.controller = None

    def equilibrium(self) -> np.ndarray:
        """Return the pose of the goal in the chain's base frame."""
        position, rotation = np.asarray(self.goal_pos), np.asarray(self.goal_ori)
        if self.input_ref_frame == "base":
            position, rotation = self.origin_pos + self.origin_ori @ position, self.origin_ori @ rotation
        base = self.sim.data.xmat[self.base_body].reshape(3, 3)
        pose = np.eye(4)
        pose[:3, :3] = base.T @ rotation
        pose[:3, 3] = base.T @ (position - self.sim.data.xpos[self.base_body])
        return pose

    def propose(self, now: float) -> None:
        """Hand goal and stiffness to the policy port if they are new, or old."""
        goal = np.concatenate([self.equilibrium().ravel(), self.kp])
        last, old = self.proposed
        if now - last >= REPEATED or (now > last and not np.array_equal(goal, old)):
            self.port.propose(now=now, time=now, equilibrium=goal[:16].reshape(4, 4), stiffness=np.diag(self.kp))
            self.proposed = (now, goal)

    def run_controller(self) -> np.ndarray:
        """Return the joint torques: the controller's, and MuJoCo's bias forces as in robosuite's own controllers.

        robosuite limits the sum to the range of the actuators. The controller's own share keeps ``effort_limit``.
        """
        self.update()
        q, now = self.joint_pos[self.order], float(self.sim.data.time)
        if self.controller is None:
            self.controller = self.module.Impedance(self.settings)
            self.port = self.module.Policy(self.controller, pose=self.module.forward_kinematics(q), now=now)
            self.proposed = (-np.inf, self.proposed[1])
        self.propose(now)
        out = self.controller.step(
            q=q,
            dq=self.joint_vel[self.order],
            posture=np.asarray(self.initial_joint)[self.order],
            **self.port.command(now),
        )
        if out.fault and not (self.output is not None and self.output.fault):
            ROBOSUITE_DEFAULT_LOGGER.warning(f"{PART}: the springs are off: {out.reason.name}; reset the episode")
        self.output = out
        own = np.empty(len(self.order))
        own[self.order] = out.torque
        torque: np.ndarray = own + self.torque_compensation
        self.torques = torque
        self.new_update = True  # as Controller.run_controller does
        return torque

    @property
    def name(self) -> str:
        """Type of the part in a configuration."""
        return PART


@register_composite_controller
class StiffgenComposite(CompositeController):  # type: ignore[misc]
    """Composite controller that knows the part type STIFFGEN_IMPEDANCE, and robosuite's own types."""

    name = COMPOSITE

    def _init_controllers(self) -> None:
        for part, config in self.part_controller_config.items():
            if config["type"] == PART:
                xml = self.robot_model.get_xml()
                made = ImpedancePart(robot_xml=xml, **{key: value for key, value in config.items() if key != "type"})
            else:
                made = controller_factory(part_name=part, controller_type=config["type"], controller_params=config)
            self.part_controllers[part] = made


def load_robot(xml: str, name: str, tip: str, base: str) -> stiffgen.GeneratedRobot:
    """Generate the chain from robosuite's MJCF of arm and gripper, or open it from the cache.

    Masses that the file leaves to the shapes count collision shapes alone, as in robosuite's world (assets/base.xml).
    """
    root = ElementTree.fromstring(xml)
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    compiler.set("inertiagrouprange", "0 0")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name.lower()}.xml"
        ElementTree.ElementTree(root).write(file, encoding="utf-8")
        return stiffgen.load(file, tip=tip, base=base)


def controller_config(robot: str, **fields: Any) -> dict[str, Any]:
    """Return robosuite's configuration of a robot with the impedance controller in its arms.

    Args:
        robot: name of the robot.
        fields: fields of the arms' part controllers, as those of OSC_POSE; ``impedance`` has those of the controller.

    """
    config: dict[str, Any] = load_composite_controller_config(robot=robot)
    parts = OrderedDict(config["body_parts"])
    for name, part in parts.items():
        if part.get("type") == "OSC_POSE":
            parts[name] = {**part, "type": PART, "kp": list(KP), **fields}
    return {**config, "type": COMPOSITE, "body_parts": parts}
