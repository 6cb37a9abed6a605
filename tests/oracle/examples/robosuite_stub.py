# SPDX-License-Identifier: MIT
"""Stand-in for robosuite 1.5.2, which needs MuJoCo 3 and NumPy 1 and cannot share this environment.

It has what examples/robosuite/controller.py takes from robosuite: the state that part controllers read, with the names
and frames of robosuite/controllers/parts/controller.py and osc.py, and the register of composite controllers.
"""

from __future__ import annotations

import logging
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest


class Simulation:
    """Counterpart of MjSim: a model with the names of robosuite's wrapper, and its data."""

    def __init__(self, xml: str) -> None:
        self.plain = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.plain)
        self.model = SimpleNamespace(
            site_name2id=lambda name: mujoco.mj_name2id(self.plain, mujoco.mjtObj.mjOBJ_SITE, name),
            body_id2name=lambda index: mujoco.mj_id2name(self.plain, mujoco.mjtObj.mjOBJ_BODY, index),
            jnt_bodyid=self.plain.jnt_bodyid,
            body_parentid=self.plain.body_parentid,
            opt=self.plain.opt,
            dof_armature=self.plain.dof_armature,
        )

    def joints(self, names: list[str]) -> dict[str, list[int]]:
        """Return robosuite's ``joint_indexes``."""
        joints = [self.plain.joint(name) for name in names]
        return {
            "joints": [joint.id for joint in joints],
            "qpos": [int(joint.qposadr[0]) for joint in joints],
            "qvel": [int(joint.dofadr[0]) for joint in joints],
        }


class OperationalSpaceController:
    """State and goals of robosuite's class; without actions, interpolation and law."""

    def __init__(self, sim: Simulation, ref_name: str, joint_indexes: Any, actuator_range: Any, kp: Any, **rest: Any):
        self.sim, self.ref_name = sim, ref_name
        self.joint_index = joint_indexes["joints"]
        self.qpos_index, self.qvel_index = joint_indexes["qpos"], joint_indexes["qvel"]
        self.joint_names = [sim.plain.joint(joint).name for joint in joint_indexes["joints"]]
        self.actuator_min, self.actuator_max = actuator_range
        self.kp = np.asarray(kp) * np.ones(6)
        self.part_name, self.naming_prefix = rest["part_name"], rest["naming_prefix"]
        self.input_ref_frame = rest["input_ref_frame"]
        self.new_update = True
        self.update()
        self.initial_joint = self.joint_pos

    def update(self) -> None:
        """Read the state once per step."""
        if self.new_update:
            self.joint_pos = np.array(self.sim.data.qpos[self.qpos_index])
            self.joint_vel = np.array(self.sim.data.qvel[self.qvel_index])
            site = self.sim.data.site(self.ref_name)
            self.ref_pos, self.ref_ori_mat = site.xpos.copy(), site.xmat.reshape(3, 3).copy()
            self.new_update = False

    def update_origin(self, position: np.ndarray, rotation: np.ndarray) -> None:
        """Set the pose of the "center" site in the world."""
        self.origin_pos, self.origin_ori = position, rotation

    def reset_goal(self, goal_update_mode: str = "achieved") -> None:
        """Set the goal to the present pose."""
        self.goal_pos, self.goal_ori = self.ref_pos, self.ref_ori_mat

    @property
    def torque_compensation(self) -> np.ndarray:
        """MuJoCo's bias forces: gravity, Coriolis and centrifugal forces."""
        return np.asarray(self.sim.data.qfrc_bias[self.qvel_index])


class CompositeController:
    """Maker of part controllers."""

    def __init__(self, robot_model: Any, configs: dict[str, Any]) -> None:
        self.robot_model, self.part_controller_config = robot_model, configs
        self.part_controllers: dict[str, Any] = {}
        self._init_controllers()

    def _init_controllers(self) -> None:
        raise NotImplementedError


def install(patch: pytest.MonkeyPatch) -> dict[str, type[CompositeController]]:
    """Put the stub in robosuite's place; return the register of composite controllers."""
    register: dict[str, Any] = {}
    names: dict[str, dict[str, Any]] = {
        "robosuite": {},
        "robosuite.controllers": {
            "controller_factory": lambda part_name, controller_type, controller_params: controller_type,
            "load_composite_controller_config": lambda robot: {"type": "BASIC", "body_parts": {}},
        },
        "robosuite.controllers.composite": {},
        "robosuite.controllers.composite.composite_controller": {
            "CompositeController": CompositeController,
            "register_composite_controller": lambda made: register.setdefault(made.name, made),
        },
        "robosuite.controllers.parts": {},
        "robosuite.controllers.parts.arm": {"OperationalSpaceController": OperationalSpaceController},
        "robosuite.utils": {},
        "robosuite.utils.log_utils": {"ROBOSUITE_DEFAULT_LOGGER": logging.getLogger("robosuite")},
    }
    for name, content in names.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        patch.setitem(sys.modules, name, module)
    return register
