# SPDX-License-Identifier: MIT
"""Lift a cube with a Panda in robosuite, without rendering.

    python -m examples.robosuite [--seed N]

The exit status is 0 if the cube was lifted and frames, masses and torques agree with MuJoCo.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import mujoco
import numpy as np
import robosuite

from examples.robosuite.controller import ImpedancePart, controller_config

STEP = 0.05  # m of an action of 1
PHASES = (("above", 30, 0.1, -1.0), ("down", 30, 0.0, -1.0), ("close", 10, 0.0, 1.0), ("lift", 30, 0.15, 1.0))
"""Name, actions at 20 Hz, height over the cube's first place [m], gripper (-1 open, 1 closed)."""


def disagreements(env: Any) -> dict[str, float]:
    """Return the largest differences of the generated robot from MuJoCo: pose [m, 1], mass matrix [kg m^2].

    The fingers are moved to 0, where the chain has them.
    """
    robot, sim = env.robots[0], env.sim
    part: ImpedancePart = robot.composite_controller.part_controllers["right"]
    sim.data.qpos[robot._ref_gripper_joint_pos_indexes["right"]] = 0.0
    sim.forward()
    q = sim.data.qpos[part.qpos_index][part.order]
    base = np.eye(4)
    base[:3, :3] = sim.data.xmat[part.base_body].reshape(3, 3)
    base[:3, 3] = sim.data.xpos[part.base_body]
    pose, site = base @ part.module.forward_kinematics(q), sim.model.site_name2id(part.ref_name)
    mass = np.zeros((sim.model.nv, sim.model.nv))
    mujoco.mj_fullM(sim.model._model, mass, sim.data.qM)
    columns = np.asarray(part.qvel_index)[part.order]
    own = part.module.mass_matrix(q) + np.diag(part.settings["motor_inertia"])
    return {
        "position": float(np.abs(pose[:3, 3] - sim.data.site_xpos[site]).max()),
        "rotation": float(np.abs(pose[:3, :3] - sim.data.site_xmat[site].reshape(3, 3)).max()),
        "mass": float(np.abs(own - mass[np.ix_(columns, columns)]).max()),
    }


def lift(env: Any) -> dict[str, Any]:
    """Run the scripted motion; return success, worst position error of the tip while it is held [m], and faults."""
    obs, faults, error = env.reset(), set(), 0.0
    part: ImpedancePart = env.robots[0].composite_controller.part_controllers["right"]
    start = np.array(obs["cube_pos"])
    for _, actions, height, gripper in PHASES:
        for _ in range(actions):
            way = (start + np.array([0.0, 0.0, height]) - obs["robot0_eef_pos"]) / STEP
            obs, *_ = env.step(np.concatenate([np.clip(0.5 * way, -0.5, 0.5), np.zeros(3), [gripper]]))
            faults.add(part.output.fault.name)
        error = max(error, float(np.linalg.norm(way)) * STEP)
    return {"success": bool(env._check_success()), "error": error, "faults": sorted(faults - {"NONE"})}


def main() -> int:
    """Run the example."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=1, help="seed of the cube's place [1]")
    options = parser.parse_args()
    env = robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=controller_config("Panda"),
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        seed=options.seed,
    )
    found, differences = lift(env), disagreements(env)
    faults = ", ".join(found["faults"]) or "none"
    print(f"cube lifted: {found['success']}; faults: {faults}")
    print(f"largest position error at the end of a phase: {1e3 * found['error']:.1f} mm")
    print("largest differences from MuJoCo: " + ", ".join(f"{name} {value:.1e}" for name, value in differences.items()))
    return 0 if found["success"] and not found["faults"] and max(differences.values()) < 1e-9 else 1


if __name__ == "__main__":
    sys.exit(main())
