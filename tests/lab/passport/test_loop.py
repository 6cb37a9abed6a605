# SPDX-License-Identifier: MIT
"""The sampled loop of the passport: against the compiled controller, and against the loop of all joints at once."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.linalg import expm

import stiffgen
from stiffgen.control.presets import motor_tables
from stiffgen.lab.passport.loop import (
    MOST_STIFFNESS,
    POSTURE_STIFFNESS,
    Arms,
    LoopTiming,
    contact_limit,
    find_modes,
    largest,
    passive_limit,
    rendered_limit,
    slowest_roots,
    stable_limit,
    step_torque,
)

ROTATION = 0.05
POSTURES = np.array([[0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5], [-1.0, 0.2, 0.5, 1.4, -0.8, -1.1, 0.3]])
TIMINGS = [
    LoopTiming(1000.0, 0, 0.0), LoopTiming(1000.0, 1, 1e-5), LoopTiming(500.0, 2, 0.0), LoopTiming(250.0, 2, 1e-4),
    LoopTiming(1000.0, 5, 1e-6),
]  # fmt: skip


@pytest.fixture(scope="module")
def robot(robot_folder):
    return stiffgen.open_robot(robot_folder)


@pytest.fixture(scope="module")
def arms(robot):
    motors, module = motor_tables(robot.chain), robot.module
    mass = module.mass_matrix(POSTURES) + np.diag(motors.motor_inertia)
    return Arms(mass, module.hybrid.jacobian(POSTURES), ROTATION)


class AtRest:
    """Compiled controller at rest in a posture, with a stiffness in force."""

    def __init__(self, robot, posture, k, timing):
        """Start the controller at rest with the translation stiffness `k` [N/m], and let it settle for five steps."""
        n = len(posture)
        self.controller = robot.module.Impedance(
            sample_time=timing.period, delay_samples=timing.delay, heaviest_wrench=(100.0, 20.0),
            motor_inertia=motor_tables(robot.chain).motor_inertia, lower_limit=np.full(n, -np.inf),
            upper_limit=np.full(n, np.inf), torque_rate_limit=1e8, errors="raise",
        )  # fmt: skip
        self.posture = posture
        self.springs = {"translation_stiffness": k * np.eye(3), "rotation_stiffness": ROTATION * k * np.eye(3)}
        for counter in range(5):
            self.out = self.step(self.controller, np.zeros(n), counter)

    def step(self, controller, dq, counter):
        return controller.step(q=self.posture, dq=dq, q0=self.posture, counter=counter, **self.springs)

    def damping_torque(self, dq):
        """Return the damping torque of a velocity that one sample has."""
        return self.step(copy.deepcopy(self.controller), dq, 5).damping_torque

    def damping(self):
        """Return the damping matrix, column by column: small velocities, so that no joint is braked."""
        return np.array([-self.damping_torque(1e-4 * e) / 1e-4 for e in np.eye(len(self.posture))]).T


@pytest.mark.parametrize("timing", [
    *(LoopTiming(1000.0, delay) for delay in (0, 1, 2, 4)), LoopTiming(200.0, 1), LoopTiming(100.0, 2),
])  # fmt: skip
def test_damping_and_cap_are_the_controllers(robot, arms, timing):
    """The compiled controller has the same matrix B, and STIFFNESS_CAPPED begins at the rendered limit."""
    limit = rendered_limit(arms, timing)
    capped = robot.module.Status.STIFFNESS_CAPPED
    for number, posture in enumerate(POSTURES):
        for share in (0.02, 0.3, 0.99):
            k = share * limit[number]
            at_rest = AtRest(robot, posture, k, timing)
            assert not at_rest.out.status & capped
            wanted = find_modes(arms, np.full(2, k), timing).matrix[number]
            np.testing.assert_allclose(at_rest.damping(), wanted, rtol=1e-8, atol=1e-8 * np.abs(wanted).max())
        if limit[number] < MOST_STIFFNESS:
            assert AtRest(robot, posture, 1.01 * limit[number], timing).out.status & capped
        else:
            with pytest.raises(ValueError, match=r"translation_stiffness.*5000"):
                AtRest(robot, posture, 1.01 * limit[number], timing)
    assert (limit < MOST_STIFFNESS).all() == (timing.rate < 500.0)  # both ends are seen


def test_an_encoder_step_moves_the_controllers_torque(robot, arms):
    """The joint and the signs of one step that move a damping torque most, by the compiled controller."""
    timing, k = LoopTiming(1000.0, 0, 1e-6), 400.0
    told = step_torque(arms, np.full(2, k), timing)
    for number, posture in enumerate(POSTURES):
        signs = np.sign(find_modes(arms, np.full(2, k), timing).matrix[number])
        at_rest = AtRest(robot, posture, k, timing)
        moved = [np.abs(at_rest.damping_torque(row * timing.quantum / timing.period)).max() for row in signs]
        assert max(moved) == pytest.approx(told[number], rel=1e-8)


@pytest.mark.parametrize(("delay", "cap"), [(0, 0.25), (1, 0.25), (2, 0.25), (3, 0.1875), (4, 0.15), (5, 0.125)])
def test_the_damping_of_stiff_springs_ends_at_its_cap(arms, delay, cap):
    """The largest eigenvalue of M^-1 B T, in docs/controller.md; the joint damping has its share of it."""
    B = find_modes(arms, np.full(2, 1e8), LoopTiming(500.0, delay)).matrix
    largest_damping = np.linalg.eigvals(np.linalg.solve(arms.mass, B)).real.max(axis=1) / 500.0
    assert (largest_damping <= cap + 1e-12).all() and (largest_damping > 0.97 * cap).all()


def loop_of_all_joints(K, B, M, timing, environment):
    """Return the matrix of a step: state q, v, earlier q with an encoder, torques on their way."""
    n, T, d = len(M), timing.period, timing.delay
    back = int(timing.quantum > 0)
    continuous = np.zeros((3 * n, 3 * n))  # q, v, held torque
    continuous[:n, n : 2 * n] = np.eye(n)
    continuous[n : 2 * n, :n] = -np.linalg.solve(M, environment)
    continuous[n : 2 * n, 2 * n :] = np.linalg.inv(M)
    exact = expm(continuous * T)[: 2 * n]
    size = n * (2 + back + d)
    A, law = np.zeros((size, size)), np.zeros((n, size))
    law[:, :n] = -K
    A[: 2 * n, : 2 * n] = exact[:, : 2 * n]
    if back:
        law[:, :n] -= B / T
        law[:, 2 * n : 3 * n] = B / T
        A[2 * n : 3 * n, :n] = np.eye(n)
    else:
        law[:, n : 2 * n] = -B
    queue = n * (2 + back)
    if d == 0:
        A[: 2 * n] += exact[:, 2 * n :] @ law
    else:
        A[: 2 * n, queue : queue + n] = exact[:, 2 * n :]
        for k in range(d - 1):
            A[queue + k * n : queue + (k + 1) * n, queue + (k + 1) * n : queue + (k + 2) * n] = np.eye(n)
        A[-n:] = law
    return A


@pytest.mark.parametrize("timing", TIMINGS)
@pytest.mark.parametrize("wall", [0.0, 0.7])
def test_roots_are_those_of_all_joints_at_once(arms, timing, wall):
    """The slowest root of each mode is a root of the whole loop; the joint damping couples modes by less than 1e-4."""
    stiffness = np.array([0.5, 0.9]) * stable_limit(arms, timing)
    modes = find_modes(arms, stiffness, timing)
    of_wall = wall * modes.tip
    roots = slowest_roots(modes, timing, of_wall)
    for number, M in enumerate(arms.mass):
        K = arms.springs(stiffness)[number]
        held = wall * (K - POSTURE_STIFFNESS * np.eye(7))
        A = loop_of_all_joints(K, modes.matrix[number], M, timing, held)
        away = np.abs(np.linalg.eigvals(A)[:, None] - roots[number]).min(axis=0)
        assert away.max() < 1e-4


@pytest.mark.parametrize("timing", TIMINGS)
def test_limits_are_where_their_conditions_end(arms, timing):
    """Evaluate the conditions beside the limits: they hold at 0.999 of the stiffness, and not at 1.01."""
    for limit, holds in (
        (stable_limit(arms, timing), lambda k: (np.abs(slowest_roots(find_modes(arms, k, timing), timing)) < 1)),
        (passive_limit(arms, timing), lambda k: (lambda m: m.damping >= m.stiffness * timing.late)(
            find_modes(arms, k, timing))),
    ):  # fmt: skip
        assert holds(0.999 * limit).all()
        assert not holds(1.01 * limit).all(axis=1).any()


def test_without_delay_passive_and_stable_are_one(arms):
    """With a velocity that is measured and no delay, b > lambda T/2 is the condition of both (Colgate, Schenkel)."""
    timing = LoopTiming(1000.0)
    np.testing.assert_allclose(passive_limit(arms, timing), stable_limit(arms, timing), rtol=2e-3)


def test_a_wall_is_softer_the_later_the_torque(arms):
    k = np.full(2, 500.0)
    walls = [contact_limit(arms, k, LoopTiming(1000.0, delay)) for delay in (0, 1, 2)]
    assert (np.diff(walls, axis=0) < 0).all()


def test_the_largest_is_below_the_first_failure():
    """Conditions that hold again beyond a gap do not count; one that never holds gives 0."""
    found = largest(lambda k: (k < np.array([333.0, 5e4, 0.0])) | (k > 1e6), 3)
    np.testing.assert_allclose(found[:2], [333.0, 5e4], rtol=1e-3)
    assert found[2] < 0.01
