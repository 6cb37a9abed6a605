# SPDX-License-Identifier: MIT
"""The controller in motor coordinates: an ankle with two motors and a four-bar, against MuJoCo's own closure.

MuJoCo reads the same MJCF file and closes its loops by Newton's method here, on its own constraints and Jacobians.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize

import stiffgen
from stiffgen import open_robot
from stiffgen.control.sessions.check import check_controller
from stiffgen.core.emit.build import build_module
from support.folders import copy_folder, restamp
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
FOUR_BAR = (
    '<mujoco model="fourbar"><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body name="ground">'
    + body(
        "crank",
        "0 0 0",
        "0 0 1",
        body("coupler", "0.15 0 0", "0 0 1", site("pin", "0.35 0 0"), site("tip", "0.2 0.1 0")),
    )
    + body("rocker", "0.3 0 0", "0 0 1", site("eye", "0.25 0 0"))
    + '</body></worldbody><equality><connect site1="pin" site2="eye"/></equality>'
    + '<actuator><motor joint="{motor}"/></actuator></mujoco>'
).replace('range="-1.2 1.2" ', "")
LIMITS = {
    "velocity_limit": 8.0,
    "effort_limit": 60.0,
    "torque_rate_limit": 3000.0,
    "reference_velocity_limit": 4.0,
    "limit_stiffness": 60.0,
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


@pytest.fixture(scope="module")
def four_bar(once: Once) -> Callable[[str], Any]:
    return lambda motor: generated(once, f"by_{motor}", FOUR_BAR.format(motor=motor), "tip")


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
    return robot.module.Impedance({**LIMITS, "stiffness_cap": "accept", **config})


def test_the_joints_are_mujocos(ankle: Any) -> None:
    linkage = Linkage(ankle.module)
    for a in np.random.default_rng(1).uniform(-0.6, 0.6, (10, 2)):
        joints = linkage.close(a)
        assert np.abs(ankle.module.close(a, ankle.module.START) - joints).max() < 1e-9
        assert np.abs(ankle.module.forward_kinematics(joints) - linkage.pose()).max() < 1e-9


def test_torque_and_tangent_are_those_of_the_springs_energy(ankle: Any) -> None:
    """Differences of the energy along MuJoCo's closure, half a turn's tenth from the equilibrium."""
    linkage, arm = Linkage(ankle.module), controller(ankle)
    a, goal = np.array([0.35, -0.2]), np.array([0.2, 0.1])
    for _ in range(600):
        out = arm.step(q=a, dq=[0, 0], q0=goal, **SPRING)
    assert out.text == "mode ACTIVE"

    def stored(a: Array) -> float:
        linkage.close(a)
        k = arm.config.posture_stiffness
        return energy(linkage.pose(), np.array(out.equilibrium)) + float(k @ (a - goal) ** 2) / 2

    h = 1e-3
    steps = h * np.eye(2)
    slope = [(8 * (stored(a + s) - stored(a - s)) - stored(a + 2 * s) + stored(a - 2 * s)) / (12 * h) for s in steps]
    assert np.abs(out.elastic_torque + slope).max() < 1e-7 * np.abs(slope).max()
    bend = [
        [(stored(a + s + t) - stored(a + s - t) - stored(a - s + t) + stored(a - s - t)) / (4 * h * h) for t in steps]
        for s in steps
    ]
    assert np.abs(out.joint_stiffness - bend).max() < 1e-4 * np.abs(bend).max()
    assert out.elastic_energy == pytest.approx(stored(a), rel=1e-9)
    linkage.close(a)
    M = np.zeros((8, 8))
    mujoco.mj_fullM(linkage.model, linkage.data, M)
    h = 1e-6
    G = np.array([(linkage.close(a + s) - linkage.close(a - s)) / (2 * h) for s in h * np.eye(2)]).T
    M = (M - 0.002 * np.eye(8))[np.ix_(linkage.joints, linkage.joints)]
    # MuJoCo's mass matrix has the rotors of all joints, the controller's those of the motors
    assert np.abs(out.mass_matrix - G.T @ M @ G - 0.002 * np.eye(2)).max() < 1e-8


def test_the_pages_lines(ankle: Any) -> None:
    (block,) = (each for each in blocks(ROOT / "docs" / "loops.md") if "ankle.Impedance" in each.code)
    names = {"ankle": ankle.module, "Kt": SPRING["translation_stiffness"], "Ko": SPRING["rotation_stiffness"]}
    exec(block.code, names)
    assert names["out"].torque.shape == (2,)
    assert not names["out"].fault


@pytest.mark.slow
def test_no_work_round_a_closed_path(ankle: Any) -> None:
    """Round 0.3 rad of both motors, far from the equilibrium: the sum of torque times motion is 0 to 1e-10 J."""
    count, module = 100, ankle.module
    angle = 2 * np.pi * np.arange(count) / count
    path = np.array([0.1, -0.1]) + 0.3 * np.stack([np.cos(angle), np.sin(angle) + 0.3 * np.cos(2 * angle)], axis=1)
    rate = 0.3 * np.stack([-np.sin(angle), np.cos(angle) - 0.6 * np.sin(2 * angle)], axis=1)
    torques = []
    for a in path:
        arm = controller(ankle, tank_initial=1e4, energy_limit=1e4, engagement_limit=1e5,
                         effort_limit=1e4, torque_rate_limit=1e8)  # fmt: skip
        equilibrium = module.forward_kinematics(module.close(np.array([0.2, 0.1]), module.START))
        arm.step(q=a, dq=[0, 0], q0=a, **SPRING)
        for _ in range(400):
            out = arm.step(q=a, dq=[0, 0], equilibrium=equilibrium, posture=a, **SPRING)
        assert np.abs(out.equilibrium - equilibrium).max() < 1e-9
        torques.append(out.elastic_torque - arm.config.posture_stiffness * (out.reference - a))
    work = 2 * np.pi / count * np.sum(np.array(torques) * rate)
    assert np.abs(torques).max() > 10
    assert abs(work) < 1e-10


@pytest.mark.parametrize("force", [(60.0, 0, 300), (-40.0, 30, 150)])
def test_a_loaded_ankle_rests_where_its_energy_is_least(ankle: Any, force: tuple[float, ...]) -> None:
    """MuJoCo simulates the linkage; torques act at the motors alone, a force at the sole. After 3 s it rests there."""
    linkage, arm = Linkage(ankle.module), controller(ankle, heaviest_wrench=[400.0, 40.0])
    goal, model, data = np.array([0.2, 0.1]), linkage.model, linkage.data
    linkage.close(goal)
    J, load = np.zeros((6, model.nv)), np.array(force)
    for k in range(3000):
        out = arm.step(q=data.qpos[linkage.motors], dq=data.qvel[linkage.motors], q0=goal, **SPRING)
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
        k = arm.config.posture_stiffness
        return energy(pose, np.array(out.equilibrium)) + float(k @ (a - goal) ** 2) / 2 - float(load @ pose[:3, 3])

    best = minimize(total, rest, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15}).x
    assert speed < 1e-3
    assert np.abs(rest - goal).max() > 0.05
    assert np.abs(rest - best).max() < 1e-4


def test_pose_commands_end_on_a_pose_in_reach(ankle: Any) -> None:
    """The equilibrium goes to a pose that the ankle can reach; both energies have their minimum at the same q."""
    linkage, arm, module = Linkage(ankle.module), controller(ankle), ankle.module
    goal, a = np.array([0.35, -0.1]), np.zeros(2)
    linkage.close(goal)
    pose, v = linkage.pose(), np.zeros(2)
    for k in range(3000):
        out = (
            arm.step(q=a, dq=v, equilibrium=pose, posture=[0, 0], **SPRING)
            if k
            else arm.step(q=a, dq=v, q0=a, **SPRING)
        )
        v = v + 1e-3 * np.linalg.solve(np.array(out.mass_matrix), out.torque)
        a = a + 1e-3 * v
    assert out.text == "mode ACTIVE"
    assert np.abs(module.forward_kinematics(module.close(a, module.START)) - pose).max() < 1e-4


class TestOutOfReach:
    """The four-bar with its rocker as motor: beyond the dead centre no position of the crank closes the loop."""

    def at_rest(self, robot: Any, **config: Any) -> tuple[Any, Array]:
        a = np.array([robot.module.START[robot.module.JOINTS.index("rocker")]])
        arm = controller(robot, **config)
        for _ in range(20):
            out = arm.step(q=a, dq=[0], q0=a, **SPRING)
        assert out.text == "mode ACTIVE"
        return arm, a

    def ends(self, robot: Any, a: Array) -> tuple[float, float]:
        """Return the positions of the rocker between which the loop closes, to 1e-6 rad."""
        module, found = robot.module, []

        def closes(way: float, distance: float) -> bool:
            with np.errstate(invalid="ignore"):
                return bool(np.isfinite(module.close(a + way * distance, module.START)).all())

        for way in (-1.0, 1.0):
            inside, outside = 0.0, 0.01
            while closes(way, outside):
                inside, outside = outside, outside + 0.01
            while outside - inside > 1e-6:
                middle = (inside + outside) / 2
                inside, outside = (middle, outside) if closes(way, middle) else (inside, middle)
            found.append(float(a[0] + way * inside))
        return found[0], found[1]

    @pytest.mark.slow
    def test_a_command_is_refused(self, four_bar: Callable[[str], Any]) -> None:
        robot = four_bar("rocker")
        arm, a = self.at_rest(robot)
        with pytest.warns(robot.module.CommandWarning, match="command refused: q0"):
            out = arm.step(q=a, dq=[0], q0=[self.ends(robot, a)[1] + 0.1], **SPRING)
        assert out.status & robot.module.Status.COMMAND_REFUSED
        assert np.isfinite(out.torque).all()
        assert not out.fault

    def test_a_sample_is_not_believed(self, four_bar: Callable[[str], Any]) -> None:
        robot = four_bar("rocker")
        arm, a = self.at_rest(robot)
        end = self.ends(robot, a)[1]
        q, last = a, np.zeros(1)
        for _ in range(4000):
            before, q = q, np.minimum(q + 1e-3, end + 0.02)
            out = arm.step(q=q, dq=(q - before) / 1e-3, q0=a, **SPRING)
            assert np.isfinite(out.torque).all()
            assert np.abs(out.torque - last).max() <= 3.0 * (1 + 1e-9)
            last = out.torque
            if out.fault:
                break
        assert out.reason == robot.module.Reason.LOOPS, out.text
        assert abs(q[0] - end) < 5e-3
        assert "do not close" in out.text
        for _ in range(200):
            out = arm.step(q=q, dq=[0], q0=a, **SPRING)
        assert np.abs(out.torque).max() < 1e-12
        for _ in range(30):  # back in reach: reset
            q = q - 2e-3
            out = arm.step(q=q, dq=[-2.0], q0=q, **SPRING)
        arm.reset()
        for _ in range(20):
            out = arm.step(q=q, dq=[0], q0=q, **SPRING)
        assert not out.fault, out.text

    def test_a_pose_beyond_the_reach_moves_the_equilibrium_to_its_edge(self, four_bar: Callable[[str], Any]) -> None:
        robot = four_bar("rocker")
        module = robot.module
        low, high = self.ends(robot, robot.module.START[[robot.module.JOINTS.index("rocker")]])
        arm, a = self.at_rest(robot, lower_limit=low + 0.02, upper_limit=high - 0.02, limit_stiffness=600.0)
        pose = np.array(module.forward_kinematics(module.close(a, module.START)))
        pose[:3, 3] += [0.8, 0.2, 0]
        v = np.zeros(1)
        for _ in range(6000):
            out = arm.step(q=a, dq=v, equilibrium=pose, posture=a, **SPRING)
            assert np.isfinite(out.torque).all()
            assert np.isfinite(out.equilibrium).all()
            v = v + 1e-3 * np.linalg.solve(np.array(out.mass_matrix), out.torque)
            a = a + 1e-3 * v
            assert low < a[0] < high
        assert not out.fault, out.text


def coupler_pose(crank: float) -> Array:
    """Return the pose of the four-bar's tip on the branch of START: two circles meet at the coupler's end."""
    elbow = 0.15 * np.exp(1j * crank)
    away = 0.3 - elbow
    along = (abs(away) ** 2 + 0.35**2 - 0.25**2) / (2 * abs(away))
    end = elbow + away / abs(away) * (along + 1j * np.sqrt(0.35**2 - along**2))
    turn = (end - elbow) / 0.35
    tip, pose = elbow + turn * (0.2 + 0.1j), np.eye(4)
    pose[:2, :2] = [[turn.real, -turn.imag], [turn.imag, turn.real]]
    pose[:2, 3] = tip.real, tip.imag
    return pose


@pytest.mark.slow
def test_a_crank_turns_on_through_whole_turns(four_bar: Callable[[str], Any]) -> None:
    """Five turns, past postures close to a dead centre: the energy is that of the coupler in closed form."""
    robot = four_bar("crank")
    module = robot.module
    a = np.array([module.START[module.JOINTS.index("crank")]])
    arm = controller(robot)
    for _ in range(10000):
        a = a + np.pi / 1000
        out = arm.step(q=a, dq=[np.pi], q0=a, **SPRING)
        assert not out.status & module.Status.BAD_SAMPLE, a
        stored = energy(coupler_pose(a[0]), np.array(out.equilibrium))
        stored += float(arm.config.posture_stiffness @ (a - out.reference) ** 2) / 2
        assert abs(out.elastic_energy - out.scale * stored) < 1e-9
    assert not out.fault, out.text


@pytest.mark.slow
def test_verify_sees_a_controller_without_the_closures_term(ankle: Any, tmp_path: Path, unoptimised: None) -> None:
    """Verify differentiates the energy along ``close``; without the multipliers the tangent is that of a frozen G."""
    assert all(check.passed for check in check_controller(ankle, seed=3))
    folder = copy_folder(ankle.folder, tmp_path)
    file = folder / "ankle_impedance.c"
    right = "gradient[k] = -gradient[k];"
    assert file.read_text().count(right) == 1
    file.write_text(file.read_text().replace(right, "gradient[k] = 0.0 * gradient[k];"))
    restamp(folder)
    build_module(folder, "ankle")
    failed = [check.kernel for check in check_controller(open_robot(folder), seed=3) if not check.passed]
    assert "controller: tangent" in failed


def work_put_out(robot: Any, seed: int) -> tuple[float, float]:
    """Return the most work [J] that the ankle puts out in a hostile schedule, and its bound.

    The environment moves the motors as it likes within their velocity limits, or with the torque, to take out work. The
    work of an interval is exact, since the torque is held: torque times motion. The command is constant; its start is
    elsewhere for some seeds. Samples are lost, and stiffness changes.
    """
    random = np.random.default_rng(seed)
    tank, engagement, speed = 5.0, 4.0, np.array([8.0, 8.0])
    arm = controller(
        robot, tank_initial=tank, engagement_limit=engagement, loss_limit=100, lower_limit=-1.0,
        upper_limit=1.0, missed_limit=int(random.integers(1, 6)), torque_rate_limit=10 ** random.uniform(2.5, 4.5),
        posture_stiffness=random.choice([0.0, 1.0, 10.0]),
    )  # fmt: skip
    a, v, wanted = random.uniform(-0.5, 0.5, 2), np.zeros(2), random.uniform(-0.4, 0.4, 2)
    elsewhere = bool(random.random() < 0.5)
    wanted = wanted if elsewhere else a.copy()
    out, total, most, goal, missing, spring = np.zeros(2), 0.0, 0.0, a, 0, SPRING
    returns, fault, pace, follows = 0, False, 0.0, False
    for k in range(2000):
        if random.random() < 0.02:
            goal, follows = random.uniform(-0.9, 0.9, 2), bool(random.random() < 0.5)
            pace = float(random.choice([0.0, 0.1, 0.5, 0.95]))
        if random.random() < 0.01:
            spring = {name: value * 10 ** random.uniform(-2, 0) for name, value in SPRING.items()}
        if random.random() < 0.02:
            missing = int(random.integers(1, 6))
        if k:
            goal = np.clip(a + out, -0.9, 0.9) if follows else goal
            v = np.clip((goal - a) / 1e-3, -pace * speed, pace * speed)
            total += float(out @ (1e-3 * v))
            most, a = max(most, total), a + 1e-3 * v
        missing -= missing > 0
        result = arm.missed() if missing else arm.step(q=a, dq=v, q0=wanted, **spring)
        out = np.array(result.torque)
        if fault and not result.fault:
            returns += 1
        fault = bool(result.fault)
        if fault and random.random() < 0.02:
            arm.reset()
    return most, tank + engagement * (returns + elsewhere)


@pytest.mark.wide(instead="test_no_work_round_a_closed_path")
def test_no_schedule_puts_out_more_than_the_bound(ankle: Any) -> None:
    """20 of the schedules, of which some come near the bound."""
    results = np.array([work_put_out(ankle, seed) for seed in range(20)])
    assert (results[:, 0] <= results[:, 1] + 1e-9).all(), np.flatnonzero(results[:, 0] > results[:, 1] + 1e-9)
    assert (results[:, 0] > 0.5 * results[:, 1]).any()
