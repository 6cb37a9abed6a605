# SPDX-License-Identifier: MIT
"""Loaded arms on joint springs: Pinocchio's torques solved by scipy, arc length to a fold, and MuJoCo beside the limit.

Pinocchio and MuJoCo read the URDF by themselves; the references use no Hessian of this project.
"""

from __future__ import annotations

from types import ModuleType

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq, minimize_scalar, root

import stiffgen
from support.project import ROOT, URDF
from support.small_robots import LINKAGES

SOFT = np.array([150.0, 150, 120, 100, 60, 40, 30])  # N m/rad
BENDING = (  # postures and springs of an arm that snaps into another posture under a force along a direction
    np.array([-0.956, -0.704, 0.191, -1.642, -0.372, 0.728, 1.346]),
    np.array([11.9, 152.0, 16.2, 5.4, 369.0, 184.0, 29.6]),
    np.array([0.294, 0.524, 0.092]),
)
FLAT = (  # posture in a plane that holds the force, too: the arm leaves the plane
    np.array([0.0, 0.6, 0, -1.1, 0, 0.8, 0]),
    np.array([30.0, 80, 20, 60, 10, 40, 10]),
    np.array([-1.0, 0, -0.5]),
)


class Arm:
    """The iiwa on springs, by Pinocchio."""

    def __init__(self, rest: np.ndarray, springs: np.ndarray, gravity: tuple[float, ...] | None = None) -> None:
        self.model = pin.buildModelFromUrdf(str(URDF))
        self.model.gravity.linear = np.array(gravity or (0.0, 0, 0))
        self.data, self.tip = self.model.createData(), self.model.getFrameId("link_ee")
        self.rest, self.springs = rest, springs

    def residual(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Return the torque that is left: Kth (q - q0) + g - J^T F."""
        weight = pin.computeGeneralizedGravity(self.model, self.data, q)
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tip, pin.LOCAL_WORLD_ALIGNED)
        return self.springs * (q - self.rest) + weight - J.T @ wrench

    def softest(self, q: np.ndarray, wrench: np.ndarray) -> float:
        """Return the smallest eigenvalue of the residual's derivative, by differences."""
        step = 1e-5
        sides = [(self.residual(q + step * e, wrench) - self.residual(q - step * e, wrench)) for e in np.eye(7)]
        return float(np.linalg.eigvalsh(np.array(sides) / (2 * step))[0])

    def solved(self, start: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Return the equilibrium that scipy finds from a start."""
        found = root(self.residual, start, args=(wrench,), tol=1e-14)
        assert np.abs(self.residual(found.x, wrench)).max() < 1e-9
        return np.asarray(found.x)

    def fold(self, force: np.ndarray) -> float:
        """Return the largest multiple of a force along the path of equilibria, followed by arc length."""
        scale = 100.0

        def on_path(x: np.ndarray, before: np.ndarray, tangent: np.ndarray, length: float) -> np.ndarray:
            wrench = np.r_[scale * x[7] * force, 0, 0, 0]
            return np.r_[self.residual(x[:7], wrench), 100 * (tangent @ (x - before) - length)]

        def ahead(length: float) -> np.ndarray:
            found = root(on_path, points[-1] + length * tangent, args=(points[-1], tangent, length), tol=1e-14)
            assert np.abs(found.fun).max() < 1e-8
            return np.asarray(found.x)

        points, tangent = [np.r_[self.solved(self.rest, np.zeros(6)), 0.0]], np.eye(8)[7]
        while len(points) < 3 or points[-1][7] > points[-2][7]:
            points.append(ahead(0.02))
            tangent = points[-1] - points[-2]
            tangent = tangent / np.linalg.norm(tangent)
        points, tangent = points[:-2], points[-2] - points[-3]
        tangent = tangent / np.linalg.norm(tangent)
        top = minimize_scalar(lambda length: -ahead(length)[7], bounds=(0.0, 0.05), method="bounded",
                              options={"xatol": 1e-7})  # fmt: skip
        return float(-scale * top.fun)


def test_settled_postures_against_scipy_and_pinocchio(robot: ModuleType) -> None:
    """Settle 20 arms under forces and moments in one call, on soft springs, so that an arm moves by 0.3 rad."""
    random = np.random.default_rng(0)
    rest = random.uniform(-1.2, 1.2, (20, 7))
    wrench = random.normal(size=(20, 6)) * [30, 30, 30, 4, 4, 4]  # [N], [N m]
    found = stiffgen.settle(robot, rest, SOFT, wrench)
    assert found.converged.all()
    assert (found.stability > 0).all()
    assert found.residual.max() < 1e-11
    expected = np.array([Arm(q0, SOFT).solved(q0, F) for q0, F in zip(rest, wrench, strict=True)])
    assert np.abs(found.q - expected).max() <= 1e-9
    assert np.abs(found.q - rest).max() > 0.3
    stiff = stiffgen.settle(robot, rest[0], np.diag(100 * SOFT), wrench, start=rest[1])
    assert stiff.q.shape == (20, 7)
    assert np.abs(stiff.q[3] - Arm(rest[0], 100 * SOFT).solved(rest[0], wrench[3])).max() <= 1e-9


def test_an_arm_that_sags(robot: ModuleType) -> None:
    """Without compensation of gravity the springs hold the weight, too."""
    rest, springs, gravity, wrench = np.full(7, 0.4), 5 * SOFT, (0, 0, -9.81), np.array([10.0, 20, -30, 1, 2, 3])
    found = stiffgen.settle(robot, rest, springs, wrench, gravity=gravity)
    assert np.abs(found.q - Arm(rest, springs, gravity).solved(rest, wrench)).max() <= 1e-9
    assert np.abs(found.q - stiffgen.settle(robot, rest, springs, wrench).q).max() > 0.01


def test_a_saddle_is_told_and_left(robot: ModuleType) -> None:
    """Load a straight arm beyond its limit: at rest but unstable; from beside it, it settles."""
    wrench = np.array([0, 0, -100.0, 0, 0, 0])  # [N]; it buckles at 75 N
    held = stiffgen.settle(robot, np.zeros(7), np.full(7, 100.0), wrench)
    assert held.converged
    assert held.q.tolist() == [0.0] * 7
    assert held.stability == pytest.approx(Arm(np.zeros(7), np.full(7, 100.0)).softest(np.zeros(7), wrench), rel=1e-6)
    assert held.stability < -10  # [N m/rad]
    fallen = stiffgen.settle(robot, np.zeros(7), np.full(7, 100.0), wrench, start=np.full(7, 1e-3))
    assert fallen.converged
    assert fallen.stability > 10
    assert np.abs(fallen.q).max() > 0.5  # [rad]


def test_no_number_is_no_posture_and_few_steps_do_not_converge(robot: ModuleType) -> None:
    """Settle from NaN, under infinite load, or with two steps: not converged, and NaN where there is no posture."""
    rest = np.array([np.full(7, 0.3), np.full(7, np.nan), np.full(7, 0.3)])
    wrench = np.array([[10.0] * 6, [1.0] * 6, [np.inf] * 6])
    found = stiffgen.settle(robot, rest, SOFT, wrench)
    assert found.converged.tolist() == [True, False, False]
    assert np.isnan(found.q).any(axis=1).tolist() == [False, True, True]
    assert np.isnan(found.stability).tolist() == [False, True, True]
    short = stiffgen.settle(robot, rest[0], SOFT, wrench[0], steps=2)
    assert not short.converged
    assert short.residual > 1e-3


@pytest.mark.parametrize("gravity", [None, (0.1, 0.2, -0.3)], ids=["weightless", "heavy"])
def test_a_fold_against_arc_length(robot: ModuleType, gravity: tuple[float, ...] | None) -> None:
    """Compare the buckling load with the fold that arc-length continuation finds."""
    rest, springs, direction = BENDING
    found = stiffgen.buckling_load(robot, rest, springs, direction, gravity=gravity)
    expected = Arm(rest, springs, gravity).fold(direction / np.linalg.norm(direction))
    assert found.load == pytest.approx(expected, rel=1e-8)
    assert 0 < found.stability < 1e-3
    assert np.abs(found.q - rest).max() > 0.5


def test_leaving_a_plane_along_the_loaded_path(robot: ModuleType) -> None:
    """Compare the posture with SciPy, and the limit with where Pinocchio's derivative turns singular."""
    rest, springs, direction = FLAT
    arm, unit = Arm(rest, springs), np.r_[direction / np.linalg.norm(direction), 0, 0, 0]
    loads = np.linspace(0, 100, 101)
    path, stability = [rest], []
    for load in loads:
        path.append(arm.solved(path[-1], load * unit))
        stability.append(arm.softest(path[-1], load * unit))
        if stability[-1] < 0:
            break

    def softest(load: float) -> float:
        return arm.softest(arm.solved(path[-2], load * unit), load * unit)

    k = len(stability) - 1
    expected = brentq(softest, loads[k - 1], loads[k], xtol=1e-10)
    found = stiffgen.buckling_load(robot, rest, springs, 3 * direction)
    assert found.load == pytest.approx(expected, rel=1e-7)
    assert np.abs(found.mode[[1, 3, 5]]).max() < 1e-6  # it leaves the plane
    at_rest = stiffgen.settle(robot, rest, springs, 0 * unit)  # without the path, the load is another
    assert abs(brentq(lambda load: arm.softest(at_rest.q, load * unit), 1.0, 200.0) / found.load - 1) > 0.02


def test_stacks_and_no_limit(robot: ModuleType) -> None:
    """Pull an arm, take its springs away, pass NaN: no limit, the limit 0, and NaN."""
    rest = np.array([np.zeros(7), np.zeros(7), np.full(7, 0.3), np.full(7, np.nan)])
    springs = 100 * np.array([np.eye(7), np.eye(7), np.diag([1, 1, 1, -1, 1, 1, 1]), np.eye(7)])
    found = stiffgen.buckling_load(robot, rest, springs, [[0, 0, -1.0], [0, 0, 1], [0, 0, 1], [0, 0, 1]], most=500.0)
    assert found.load[:1] == pytest.approx(75.30863825186, rel=1e-9)  # three rods (tests/examples)
    assert found.load[1:].tolist()[:2] == [np.inf, 0.0]
    assert np.isnan(found.load[3])
    assert found.q.shape == found.mode.shape == (4, 7)
    np.testing.assert_array_equal(found.softest_load, [found.load[0], 0.0, 0.0, np.nan])  # pulled: softest without load
    np.testing.assert_allclose(found.softest_stability, [0.0, 100.0, -100.0, np.nan], rtol=1e-9, atol=1e-3)


@pytest.mark.parametrize("bend", [1e-12, 1e-6, 1e-3])
def test_a_posture_that_is_almost_straight_is_softest_near_the_straight_one_s_load(
    robot: ModuleType, bend: float
) -> None:
    """Bend a posture by 1e-12 rad: its softest load is found, where it sinks by 370 mm at 90 N."""
    rest, springs, straight = np.array([0, bend, 0, 0, 0, 0, 0]), np.full(7, 100.0), 75.30863825186
    # [rad], [N m/rad], [N]
    found = stiffgen.buckling_load(robot, rest, springs, [0, 0, -1], most=300.0)
    assert found.load == np.inf
    # an imperfection e lowers the load by a share of the order of e^(2/3), and leaves as much stability
    assert found.softest_load == pytest.approx(straight, rel=max(2 * bend ** (2 / 3), 1e-8))
    assert found.softest_load <= straight * (1 + 1e-8)
    assert 0 < found.softest_stability < max(200 * bend ** (2 / 3), 1e-5)
    below, above = (
        stiffgen.settle(robot, rest, springs, [0, 0, -share * straight, 0, 0, 0], start=rest + 1e-3).q
        for share in (0.9, 1.2)
    )
    heights = [robot.forward_kinematics(q)[2, 3] for q in (rest, below, above)]
    assert heights[0] - heights[1] < 1e-3  # [m] below the load it stands
    assert heights[0] - heights[2] > 0.3  # and above it sinks


@pytest.mark.parametrize("gravity", [None, (0.1, 0.2, -0.3)], ids=["weightless", "heavy"])
def test_the_softest_load_by_scipy(robot: ModuleType, gravity: tuple[float, ...] | None) -> None:
    """Compare with Pinocchio's torques along the growing force, solved by scipy: least eigenvalue of differences."""
    rest, springs = np.array([0.02, 0.05, 0, -0.03, 0.1, 0.02, 0]), np.array([100.0, 90, 80, 70, 60, 50, 40])
    arm, push = Arm(rest, springs, gravity), np.array([0, 0, -1.0, 0, 0, 0])
    loads, path = np.linspace(0, 200, 201), [rest]  # [N]; each posture begins the search for the next one
    for load in loads:
        path.append(arm.solved(path[-1], load * push))
    stability = [arm.softest(q, load * push) for q, load in zip(path[1:], loads, strict=True)]
    k = int(np.argmin(stability))
    assert 0 < k < 200  # the softest one is not at an end

    def softest(load: float) -> float:
        return arm.softest(arm.solved(path[k], load * push), load * push)

    expected = minimize_scalar(softest, bounds=(loads[k - 1], loads[k + 1]), method="bounded", options={"xatol": 1e-6})
    found = stiffgen.buckling_load(robot, rest, springs, push[:3], gravity=gravity, most=200.0)
    assert found.load == np.inf
    assert found.softest_load == pytest.approx(expected.x, rel=1e-3)
    assert found.softest_stability == pytest.approx(expected.fun, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("case", [BENDING, FLAT], ids=["fold", "plane"])
def test_mujoco_stays_below_and_falls_above(robot: ModuleType, case: tuple[np.ndarray, ...]) -> None:
    """Load MuJoCo's arm with 0.95 and 1.05 of the buckling load for 20 s: it stays, and it falls."""
    rest, springs, direction = case
    found = stiffgen.buckling_load(robot, rest, springs, direction)
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.discardvisual, spec.compiler.fusestatic = True, False
    spec.option.gravity, spec.option.timestep = [0, 0, 0], 1e-3
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    model = spec.compile()
    model.jnt_stiffness[:], model.qpos_spring[:], model.dof_damping[:] = springs, rest, 0.5  # [N m s/rad]
    unit, tip = direction / np.linalg.norm(direction), model.body("link_ee").id
    for share, is_stable in ((0.95, True), (1.05, False)):
        data = mujoco.MjData(model)
        start = stiffgen.settle(robot, rest, springs, np.r_[0.95 * found.load * unit, 0, 0, 0], start=found.q).q
        data.qpos[:] = start + 1e-4 * found.mode  # pushed a little in the direction in which it buckles
        for _ in range(20000):  # 20 s
            mujoco.mj_step1(model, data)
            J = np.zeros((3, 7))
            mujoco.mj_jac(model, data, J, None, data.xpos[tip], tip)
            data.qfrc_applied[:] = J.T @ (share * found.load * unit)
            mujoco.mj_step2(model, data)
        moved = np.abs(data.qpos - start).max()  # [rad]
        assert moved < 1e-4 if is_stable else moved > 0.1, (share, moved)


@pytest.mark.slow
def test_tips_and_loops(tmp_path, unoptimised) -> None:
    """Settle one tip's part and a robot with closed loops: only the first is an arm."""
    dual = stiffgen.generate(ROOT / "tests" / "data" / "dual_arm.urdf", output=tmp_path, name="dual",
                             tip=["left hand", "right-hand"], kernels="hybrid", batches=False,
                             controller=False, masses=False)  # fmt: skip
    module = stiffgen.open_robot(dual).module
    q0, wrench = np.full(module.DOF, 0.3), np.array([5.0, 10, -20, 1, 0, 2])
    found = stiffgen.settle(module.left_hand, q0, np.full(module.DOF, 200.0), wrench)
    left = 200 * (found.q - q0) - module.left_hand.hybrid.jacobian(found.q).T @ wrench
    assert np.abs(left).max() < 1e-10
    loop = LINKAGES["four-bar"]
    file = tmp_path / "loop.urdf"
    file.write_text(loop.urdf)
    closed = stiffgen.open_robot(
        stiffgen.generate(file, output=tmp_path, name="loop", batches=False, **loop.all_options())
    )
    with pytest.raises(stiffgen.StiffgenError, match="closed loops"):
        stiffgen.settle(closed, np.zeros(closed.module.DOF), np.ones(closed.module.DOF), wrench)
