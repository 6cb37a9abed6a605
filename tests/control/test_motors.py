# SPDX-License-Identifier: MIT
"""The controller in motor coordinates: an ankle with two motors, against MuJoCo's own closure.

MuJoCo reads the same MJCF file and closes its loops by Newton's method here, on its own constraints and Jacobians.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize

import stiffgen
from stiffgen import open_robot
from support.pages import blocks
from support.project import ROOT, Once

Array = np.ndarray
INERTIA = '<inertial pos="0.01 0.005 -0.02" mass="0.5" diaginertia="2e-3 2e-3 1e-3"/>'


def body(name: str, pos: str, axis: str, *inside: str) -> str:
    joint = f'<joint name="{name}" axis="{axis}" range="-1.2 1.2" armature="0.002"/>'
    return f'<body name="{name}" pos="{pos}">{joint}{INERTIA}{"".join(inside)}</body>'


def site(name: str, pos: str) -> str:
    return f'<site name="{name}" pos="{pos}"/>'


def crank_with_rod(side: str, y: float, z: float, length: float) -> str:
    """Return a crank of 0.05 m on the shank, with a rod that swings about two axes at the crank's end [m]."""
    hinge = body(f"{side}_rod", "0 0 0", "1 0 0", site(f"{side}_end", f"0 0 {-length}"))
    return body(side, f"0 {y} {z}", "0 1 0", body(f"{side}_swing", "-0.05 0 0", "0 1 0", hinge))


FOOT = (site("sole", "0.05 0 -0.06"), site("left_heel", "-0.05 0.05 0"), site("right_heel", "-0.05 -0.05 0"))
ANKLE = (
    '<mujoco model="ankle"><compiler angle="radian"/><option gravity="0 0 0" timestep="1e-4" iterations="200" '
    'tolerance="1e-14"/><worldbody><body name="shank">'
    + body("pitch", "0 0 -0.35", "0 1 0", body("roll", "0 0 0", "1 0 0", *FOOT))
    + crank_with_rod("left", 0.05, -0.05, 0.3)
    + crank_with_rod("right", -0.05, -0.12, 0.23)
    + "</body></worldbody><equality>"
    + "".join(
        f'<connect site1="{side}_end" site2="{side}_heel" solref="2e-4 1" solimp="0.9999 0.9999 0.001"/>'
        for side in ("left", "right")
    )
    + '</equality><actuator><motor joint="left"/><motor joint="right"/></actuator></mujoco>'
)
CONFIG = {
    "sample_time": 1e-3,
    "delay_samples": 0,
    "motor_inertia": 0.002,
    "heaviest_wrench": (400.0, 40.0),
    "velocity_limit": 8.0,
    "effort_limit": 60.0,
    "torque_rate_limit": 3000.0,
}
SPRING = {"translation_stiffness": np.diag([2000.0, 2000, 3000]), "rotation_stiffness": np.diag([60.0, 50, 20])}


def generated(once: Once, name: str, text: str, tip: str) -> Any:
    def make(folder: Path) -> None:
        (folder / "robot.xml").write_text(text)
        stiffgen.generate(folder / "robot.xml", name=name, tip=tip, close_loops=True, batches=False, output=folder)

    return open_robot(once(f"motors_{name}", make) / name)


@pytest.fixture(scope="module")
def ankle(once: Once) -> Any:
    return generated(once, "ankle", ANKLE, "sole")


class Linkage:
    """The ankle in MuJoCo, with joints by the names and in the order of the robot's q."""

    def __init__(self, module: ModuleType) -> None:
        self.model = mujoco.MjModel.from_xml_string(ANKLE)
        self.data = mujoco.MjData(self.model)
        self.joints = np.array([self.model.joint(name).qposadr[0] for name in module.JOINTS])
        self.motors = np.array([self.model.joint(name).qposadr[0] for name in module.ACTUATED])
        self.passive = np.setdiff1d(self.joints, self.motors)
        self.sole = self.model.site("sole").id

    def close(self, a: Array) -> Array:
        """Lead the motors to a, with the other joints where the constraints vanish. Return all joints, in order."""
        data, model = self.data, self.model
        before = data.qpos[self.motors].copy()
        for part in np.linspace(0.0, 1.0, 9)[1:]:
            data.qpos[self.motors] = before + part * (a - before)
            for _ in range(4):
                mujoco.mj_forward(model, data)
                C = data.efc_J.reshape(-1, model.nv)[: data.ne]
                data.qpos[self.passive] -= np.linalg.solve(C[:, self.passive], data.efc_pos[: data.ne])
        mujoco.mj_forward(model, data)
        return data.qpos[self.joints].copy()

    def pose(self) -> Array:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.data.site_xmat[self.sole].reshape(3, 3), self.data.site_xpos[self.sole]
        return pose


def energy(pose: Array, equilibrium: Array) -> float:
    """Return the energy of the trace form's spring, from the definition of docs/theory.md."""
    Kt, Ko = SPRING["translation_stiffness"], SPRING["rotation_stiffness"]
    e, R = pose[:3, 3] - equilibrium[:3, 3], equilibrium[:3, :3].T @ pose[:3, :3]
    weights = np.trace(Ko) / 2 * np.eye(3) - Ko
    return float(e @ Kt @ e / 2 + np.trace(weights) - np.trace(weights @ R))


def controller(robot: Any, **config: Any) -> Any:
    return robot.module.Impedance(**{**CONFIG, **config})


@pytest.mark.slow
def test_the_joints_are_mujocos(ankle: Any) -> None:
    linkage = Linkage(ankle.module)
    for a in np.random.default_rng(1).uniform(-0.6, 0.6, (10, 2)):
        joints = linkage.close(a)
        assert np.abs(ankle.module.close(a, ankle.module.START) - joints).max() < 1e-9
        assert np.abs(ankle.module.forward_kinematics(joints) - linkage.pose()).max() < 1e-9


@pytest.mark.slow
def test_the_torque_is_the_slope_of_the_springs_energy(ankle: Any) -> None:
    """Compare with differences of the energy along MuJoCo's closure, a tenth of half a turn from the reference."""
    linkage, arm = Linkage(ankle.module), controller(ankle, position_quantum=1e-3)
    a, goal = np.array([0.35, -0.2]), np.array([0.2, 0.1])
    linkage.close(goal)
    equilibrium = linkage.pose()
    for counter in range(1500):  # 1.5 s: the reference has reached the goal
        out = arm.step(q=a, dq=[0, 0], q0=goal, counter=counter, **SPRING)
    assert not out.fault, out.text
    np.testing.assert_allclose(out.reference, goal, atol=1e-9)

    def stored(a: Array) -> float:
        linkage.close(a)
        return energy(linkage.pose(), equilibrium) + float((a - goal) @ (a - goal)) / 2

    h = 1e-3  # [rad], for the five-point rule
    steps = h * np.eye(2)
    slope = [(8 * (stored(a + s) - stored(a - s)) - stored(a + 2 * s) + stored(a - 2 * s)) / (12 * h) for s in steps]
    assert np.abs(out.torque + slope).max() < 1e-7 * np.abs(slope).max()
    assert out.stored == pytest.approx(stored(a), rel=1e-9)


@pytest.mark.slow
def test_the_pages_lines(ankle: Any) -> None:
    (block,) = (each for each in blocks(ROOT / "docs" / "loops.md") if "ankle.Impedance" in each.code)
    names = {"ankle": ankle.module, "Kt": SPRING["translation_stiffness"], "Ko": SPRING["rotation_stiffness"]}
    exec(block.code, names)
    assert names["out"].torque.shape == (2,)
    assert not names["out"].fault


@pytest.mark.slow
@pytest.mark.parametrize("force", [(60.0, 0, 300), (-40.0, 30, 150)])
def test_a_loaded_ankle_rests_where_its_energy_is_least(ankle: Any, force: tuple[float, ...]) -> None:
    """MuJoCo simulates the linkage; torques act at the motors alone, a force at the sole. After 3 s it rests there."""
    linkage, arm = Linkage(ankle.module), controller(ankle)
    goal, model, data = np.array([0.2, 0.1]), linkage.model, linkage.data
    linkage.close(goal)
    equilibrium, J, load = linkage.pose(), np.zeros((6, model.nv)), np.array(force)
    for k in range(3000):
        out = arm.step(q=data.qpos[linkage.motors], dq=data.qvel[linkage.motors], q0=goal, counter=k, **SPRING)
        assert out.fault == 0, out.text
        for _ in range(10):
            mujoco.mj_jacSite(model, data, J[:3], J[3:], linkage.sole)
            data.qfrc_applied[:] = J[:3].T @ load * min(1.0, k / 300)
            data.qfrc_applied[linkage.motors] += out.torque
            mujoco.mj_step(model, data)
    rest, speed = data.qpos[linkage.motors].copy(), np.abs(data.qvel).max()

    def total(a: Array) -> float:
        linkage.close(a)
        pose = linkage.pose()
        return energy(pose, equilibrium) + float((a - goal) @ (a - goal)) / 2 - float(load @ pose[:3, 3])

    best = minimize(total, rest, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15}).x
    assert speed < 1e-3  # [rad/s] at rest
    assert np.abs(rest - goal).max() > 0.05  # [rad] the load moves the ankle
    assert np.abs(rest - best).max() < 1e-4  # [rad] to the least of its energy
