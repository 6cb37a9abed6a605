# SPDX-License-Identifier: MIT
"""External wrenches against NumPy's least squares and statistics; deviations of a stiffness against drawn wrenches."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

import stiffgen
from support.c_program import STRICT
from support.chains import chain_urdf

K = np.diag([700.0, 700, 800, 30, 30, 30])


@pytest.fixture(scope="module")
def module(robot_folder):
    return stiffgen.open_robot(robot_folder).module


def test_wrench_of_exact_torques(module):
    """Torques of a wrench come back as the wrench, with nothing unexplained, for a stack of postures."""
    random = np.random.default_rng(0)
    q, wrench = random.uniform(-1, 1, (5, 7)), random.normal(size=(5, 6)) * 20
    torque = np.einsum("sij,si->sj", module.hybrid.jacobian(q), wrench)
    found = stiffgen.external_wrench(module, q, torque)
    np.testing.assert_allclose(found.wrench, wrench, rtol=0, atol=1e-9)
    assert np.abs(found.unexplained).max() < 1e-10
    np.testing.assert_allclose(found.condition, np.linalg.cond(np.swapaxes(module.hybrid.jacobian(q), 1, 2)), rtol=1e-9)


def test_weighted_least_squares(module):
    """Friction that no wrench explains: NumPy's solution of the scaled system, and covariances of drawn torques."""
    random, q = np.random.default_rng(1), np.linspace(-0.8, 0.9, 7)
    deviation, friction = np.array([3.0, 3, 2, 2, 1, 0.5, 0.5]), random.normal(size=7)
    across = module.hybrid.jacobian(q).T
    expected, *_ = np.linalg.lstsq(across / deviation[:, None], friction / deviation, rcond=None)
    found = stiffgen.external_wrench(module, q, friction, deviation)
    np.testing.assert_allclose(found.wrench, expected, rtol=1e-9)
    np.testing.assert_allclose(found.unexplained, friction - across @ expected, rtol=0, atol=1e-9)
    assert not np.allclose(stiffgen.external_wrench(module, q, friction).wrench, expected, rtol=0.01)
    drawn = stiffgen.external_wrench(module, q, random.normal(size=(20000, 7)) * deviation, deviation).wrench
    scale = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(scale, scale), found.covariance / np.outer(scale, scale), atol=0.04
    )


def test_no_wrench_from_a_singular_posture(module):
    """At zero the arm is stretched: some wrenches cause no torque, and no number is made up for them."""
    found = stiffgen.external_wrench(module, np.zeros((2, 7)), np.ones(7))
    assert np.all(found.condition > 1e10) and np.all(np.isnan(found.wrench))
    with np.errstate(invalid="ignore"):
        assert np.all(np.isnan(stiffgen.external_wrench(module, np.full(7, np.nan), np.ones(7)).wrench))


def test_deviations_of_the_stiffness(module):
    """Standard deviations of 20000 drawn wrenches, correlated ones."""
    random, q = np.random.default_rng(2), np.array([0.4, 0.9, -0.3, -1.2, 0.5, 1.0, 0.2])
    # [N, N m]; its square is the covariance
    root = np.diag([0.4, 0.5, 0.8, 0.02, 0.03, 0.05]) @ (np.eye(6) + 0.4 * random.normal(size=(6, 6)))
    mean, covariance = np.array([10.0, -20, 30, 5, -8, 3]), root @ root.T
    found = stiffgen.stiffness_deviation(module, q, mean, K, covariance)
    np.testing.assert_array_equal(found.joint_stiffness, module.hybrid.joint_stiffness(q, mean, K))
    wrenches = mean + random.normal(size=(20000, 6)) @ root.T
    drawn = module.hybrid.joint_stiffness(q, wrenches, K)
    np.testing.assert_allclose(found.deviation, drawn.std(axis=0), rtol=0.03, atol=1e-9)
    smallest = np.linalg.eigvalsh(drawn)[:, 0]
    assert found.smallest == pytest.approx(np.linalg.eigvalsh(found.joint_stiffness)[0], abs=1e-9)
    assert found.smallest_deviation == pytest.approx(smallest.std(), rel=0.03)
    conventional = module.hybrid.joint_stiffness_uncorrected(q, wrenches, K)
    sizes = np.linalg.norm((conventional - np.swapaxes(conventional, 1, 2)) / 2, ord=2, axis=(1, 2))
    assert found.antisymmetric == pytest.approx(sizes.mean(), rel=0.03)
    assert found.antisymmetric_deviation == pytest.approx(sizes.std(), rel=0.03)


def test_deviations_of_stacks(module):
    """Stacks of postures and covariances broadcast; an exact wrench leaves no deviation."""
    random = np.random.default_rng(3)
    q, wrench = random.uniform(-1, 1, (3, 7)), random.normal(size=(3, 6))
    stack = stiffgen.stiffness_deviation(module, q, wrench, K, np.eye(6))
    one = stiffgen.stiffness_deviation(module, q[1], wrench[1], K, np.eye(6))
    for name in ("deviation", "smallest_deviation", "antisymmetric_deviation"):
        np.testing.assert_allclose(getattr(stack, name)[1], getattr(one, name), rtol=1e-9, atol=1e-12)
    assert not stiffgen.stiffness_deviation(module, q, wrench, K, np.zeros((6, 6))).deviation.any()


PROGRAM = r"""
#include "NAME_sensor.h"
#include <stdio.h>
int main(void)
{
    double J[6 * N], torque[N], deviation[N], damping, wrench[6], unexplained[N];
    for (;;) {
        for (int i = 0; i < 6 * N + 2 * N + 1; ++i) {
            double x;
            if (scanf("%lf", &x) != 1) {
                return 0;
            }
            *(i < 6 * N ? &J[i] : i < 7 * N ? &torque[i - 6 * N] : i < 8 * N ? &deviation[i - 7 * N] : &damping) = x;
        }
        const double *told = deviation[0] > 0.0 ? deviation : NULL;
        printf("%.17g", NAME_external_wrench(J, torque, told, damping, wrench, unexplained));
        for (int i = 0; i < 6 + N; ++i) {
            printf(" %.17g", i < 6 ? wrench[i] : unexplained[i - 6]);
        }
        printf("\n");
    }
}
"""


def in_c(tmp_path, folder, rows):
    """Results of the C function for rows of Jacobian, torques, deviations (zeros: none) and damping."""
    n = stiffgen.open_robot(folder).chain.dof
    source, program = tmp_path / f"{folder.name}.c", tmp_path / f"{folder.name}_program"
    source.write_text(PROGRAM.replace("NAME", folder.name))
    command = ["gcc", "-std=c99", *STRICT, f"-DN={n}", f"-I{folder}", str(source), "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    given = "\n".join(" ".join(repr(float(x)) for x in np.concatenate([np.ravel(x) for x in row])) for row in rows)
    done = subprocess.run([program], input=given, check=True, capture_output=True, text=True)
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    return found[:, 0], found[:, 1:7], found[:, 7:]


def test_the_function_in_c(robot_folder, tmp_path):
    """Compare with NumPy's least squares of scaled rows, of damped ones, and the condition number of its singular
    values.
    """
    module, random = stiffgen.open_robot(robot_folder).module, np.random.default_rng(4)
    J = module.hybrid.jacobian(random.uniform(-2, 2, (40, 7)))  # 40 postures
    torque, deviation = random.normal(size=(40, 7)) * 20, random.uniform(0.2, 3, (40, 7))  # [N m]
    # even rows state no deviation; the wrench is damped in two quarters of the rows
    deviation[::2], damping = 0.0, np.repeat([0.0, 0.01, 0.3, 0.0], 10)
    condition, wrench, unexplained = in_c(tmp_path, robot_folder, zip(J, torque, deviation, damping, strict=True))
    for k in range(40):
        scale = 1 / np.where(deviation[k] > 0, deviation[k], 1.0)  # a joint counts by the certainty of its torque
        across = J[k].T * scale[:, None]
        rows, right = np.vstack([across, damping[k] * np.eye(6)]), np.r_[torque[k] * scale, np.zeros(6)]
        expected = np.linalg.lstsq(rows, right, rcond=None)[0]
        near = 1e-13 * np.linalg.cond(rows) * np.linalg.norm(expected)
        np.testing.assert_allclose(wrench[k], expected, rtol=0, atol=near)
        np.testing.assert_allclose(unexplained[k], torque[k] - J[k].T @ expected, rtol=0, atol=10 * near)
        assert condition[k] == pytest.approx(np.linalg.cond(across), rel=1e-11)


def test_the_function_in_c_makes_no_number_up(robot_folder, tmp_path):
    """Estimate at a stretched arm, with NaN, and with few joints: NaN, never an invented wrench."""
    J = stiffgen.open_robot(robot_folder).module.hybrid.jacobian(np.zeros(7))
    ones, none, holed = np.ones(7), np.zeros(7), np.where(np.arange(42) == 8, np.nan, 1.0)
    # Jacobian, torque, deviation, damping
    rows = [(J, ones, none, 0.0), (J, ones, none, 0.01), (holed, ones, none, 0.01), (J, ones * np.nan, none, 0.01)]
    condition, wrench, _ = in_c(tmp_path, robot_folder, [*rows, (0 * J, ones, none, 0.01)])
    assert condition[0] > 1e10 and np.isnan(wrench[0]).all() and np.isfinite(wrench[1]).all()
    assert np.isnan(condition[2]) and np.isnan(wrench[2:4]).all() and np.isinf(condition[4]) and not wrench[4].any()
    (tmp_path / "arm.urdf").write_text(chain_urdf("rp"))
    link = stiffgen.load_chain(tmp_path / "arm.urdf").tip
    small = stiffgen.generate(tmp_path / "arm.urdf", output=tmp_path, sensor=stiffgen.Sensor(link), build=False)
    J = np.random.default_rng(0).normal(size=(6, 2))
    condition, wrench, _ = in_c(tmp_path, small, [(J, [1.0, 2.0], [0, 0], 0.0), (J, [1.0, 2.0], [0, 0], 0.1)])
    assert np.isinf(condition).all() and np.isnan(wrench[0]).all()
    np.testing.assert_allclose(wrench[1], np.linalg.solve(J @ J.T + 0.01 * np.eye(6), J @ [1.0, 2.0]), rtol=1e-9)
