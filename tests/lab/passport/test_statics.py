# SPDX-License-Identifier: MIT
"""Statics of the passport: against linear programming, springs that are solved, and differences of the energy."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

import stiffgen
from stiffgen.lab.passport.passport import PassportOptions, make_passport
from stiffgen.lab.passport.statics import DIRECTIONS, UNITS, available_force

KP = (400.0, 400.0, 300.0, 250.0, 150.0, 100.0, 80.0)
KC = (9e3, 9e3, 8e3, 8e3, 6e3, 4e3, 4e3)
POSTURES = np.array([[0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5], [-1.0, 0.2, 0.5, 1.4, -0.8, -1.1, 0.3]])


@pytest.fixture(scope="module")
def robot(robot_folder):
    return stiffgen.open_robot(robot_folder)


def test_force_is_the_largest_of_a_linear_program(robot):
    """Maximise f with every |g + J^T u f| <= effort."""
    module = robot.module
    passport = make_passport(robot, PassportOptions(), POSTURES)
    effort = np.array(module.EFFORT)
    for number, q in enumerate(POSTURES):
        gravity = module.gravity.gradient(q, np.array([0.0, 0.0, -9.81]))
        J = module.hybrid.jacobian(q)[:3]
        for unit, name in zip(UNITS, DIRECTIONS, strict=True):
            a = J.T @ unit
            solved = linprog([-1.0], A_ub=np.r_[a, -a][:, None], b_ub=np.r_[effort - gravity, effort + gravity])
            assert passport[f"force {name}"][number] == pytest.approx(solved.x[0], rel=1e-9)


def test_no_force_where_gravity_takes_all_torque(robot):
    module = robot.module
    J = module.hybrid.jacobian(POSTURES)
    gravity = module.gravity.gradient(POSTURES, np.array([0.0, 0.0, -9.81]))
    assert (available_force(J, gravity, np.full(7, 1.0)) == 0).all()


def tip_of_springs(module, q, stiffness, force):
    """Return the tip's displacement by a small force, solved by Newton: K (q - q0) = J(q)^T f."""
    at = q.copy()
    for _ in range(30):
        J = module.hybrid.jacobian(at)[:3]
        at = at - np.linalg.solve(stiffness, stiffness @ (at - q) - J.T @ force)
    return module.forward_kinematics(at)[:3, 3] - module.forward_kinematics(q)[:3, 3]


def test_stiffness_by_kp_is_that_of_springs_that_give_way(robot):
    """The softest of many directions, by displacements of 1e-3 N; gears in series add their own displacement."""
    module = robot.module
    plain = make_passport(robot, PassportOptions(kp=KP), POSTURES)["by kp"]
    geared = make_passport(robot, PassportOptions(kp=KP, kc=KC), POSTURES)["by kp"]
    for number, q in enumerate(POSTURES):
        for found, flexibility in ((plain, 1 / np.array(KP)), (geared, 1 / np.array(KP) + 1 / np.array(KC))):
            columns = [tip_of_springs(module, q, np.diag(1 / flexibility), 1e-3 * axis) for axis in np.eye(3)]
            softest = 1e-3 / np.linalg.eigvalsh(np.array(columns) / 2 + np.array(columns).T / 2)[-1]
            assert found[number] == pytest.approx(softest, rel=1e-5)


def test_the_share_lost_is_that_of_motors_and_links(robot):
    """Minimise the energy of controller and gears over motors and links under a force, and compare displacements."""
    passport = make_passport(robot, PassportOptions(kc=KC), POSTURES)
    for number, q in enumerate(POSTURES):
        J, k, Kc = robot.module.hybrid.jacobian(q), passport["rendered"][number], np.diag(KC)
        Kq = J.T @ np.diag([k] * 3 + [0.05 * k] * 3) @ J + np.eye(7)
        both = np.block([[Kq + Kc, -Kc], [-Kc, Kc]])
        moved = np.linalg.solve(both, np.vstack([np.zeros((7, 3)), J[:3].T]))[7:]
        alone = np.linalg.solve(Kq, J[:3].T)
        lost = 1 - np.linalg.eigvalsh(J[:3] @ alone)[-1] / np.linalg.eigvalsh(J[:3] @ moved)[-1]
        assert passport["lost to gears"][number] == pytest.approx(100 * lost, rel=1e-6)


def test_buckling_is_where_the_energy_loses_its_curvature(robot):
    """Differentiate the torques of springs and force at the reported force: the smallest eigenvalue is zero."""
    module = robot.module
    passport = make_passport(robot, PassportOptions(kp=KP), POSTURES)
    for number, q in enumerate(POSTURES):
        force = passport["buckling"][number]
        smallest = []
        for unit in UNITS:

            def torque(at, unit=unit, force=force):
                return module.hybrid.jacobian(at)[:3].T @ unit * force

            rows = [(torque(q + 1e-5 * e) - torque(q - 1e-5 * e)) / 2e-5 for e in np.eye(7)]
            H = np.diag(KP) - (np.array(rows) + np.array(rows).T) / 2
            smallest.append(np.linalg.eigvalsh(H)[0])
        assert min(smallest) == pytest.approx(0.0, abs=1e-4)


FRICTION = 0.01 * np.array([3.0, 4.0, 2.0, 2.5, 1.0, 0.8, 0.6])
"""[N m] so small that equilibria are linear in it within a percent."""


def stuck(module, q, stiffness, friction, normal=None):
    """Return the tip's way [m] along x, y, z, or its force on a wall across ``normal`` [N], where friction holds it.

    Newton steps: torque of the generated spring, posture springs of 1 N m/rad, friction of the joints, force of a wall.
    """
    pose, n = module.forward_kinematics(q), len(q)
    at, force = q.copy(), 0.0
    tangent = module.spring.joint_stiffness(q, pose, *stiffness) + np.eye(n)
    for _ in range(40):
        J = module.hybrid.jacobian(at)[:3]
        left = module.spring.torque(at, pose, *stiffness) - (at - q) + friction
        way = module.forward_kinematics(at)[:3, 3] - pose[:3, 3]
        if normal is None:
            at = at + np.linalg.solve(tangent, left)
            continue
        row = normal @ J
        system = np.block([[tangent, -row[:, None]], [row[None], np.zeros((1, 1))]])
        step = np.linalg.solve(system, np.append(left + row * force, -normal @ way))
        at, force = at + step[:n], force + step[n]
    assert np.abs(left + (0.0 if normal is None else row * force)).max() < 1e-9
    return way if normal is None else force


def test_errors_by_friction_are_those_of_equilibria(robot):
    """The worst of all signs of the joints' friction, solved without linearising."""
    module = robot.module
    passport = make_passport(robot, PassportOptions(friction=tuple(FRICTION)), POSTURES)
    for number, q in enumerate(POSTURES):
        k = passport["rendered"][number]
        stiffness = (k * np.eye(3), 0.05 * k * np.eye(3))
        signs = np.array(list(product((-1.0, 1.0), repeat=7)))[:64]  # the others are their opposites
        ways = np.abs([stuck(module, q, stiffness, each * FRICTION) for each in signs])
        forces = [abs(stuck(module, q, stiffness, each * FRICTION, u)) for each in signs for u in np.eye(3)]
        assert passport["rest error"][number] == pytest.approx(1e3 * np.max(ways), rel=0.02)
        assert passport["force error"][number] == pytest.approx(np.max(forces), rel=0.02)


def test_errors_by_friction_grow_with_it(robot):
    """Twice the friction, twice the errors; friction of one number is that of all joints; none is no quantity."""
    single, double = (make_passport(robot, PassportOptions(friction=c), POSTURES) for c in ((1.0,), (2.0,) * 7))
    for name in ("rest error", "force error"):
        np.testing.assert_allclose(double[name], 2 * single[name])
        assert double.quantity(name).worst == double[name].argmax()
    assert "rest error" not in {each.name for each in make_passport(robot, PassportOptions(), POSTURES).quantities}
