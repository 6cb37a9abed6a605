# SPDX-License-Identifier: MIT
"""Gradients of the tip's compliance: vector-Jacobian products of the kernel, and differences by Pinocchio."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from support.project import URDF

SPRINGS = np.diag([150.0, 150, 120, 100, 60, 40, 30]) + 2.0  # N m/rad, coupled
BLOCKS = {"all": slice(0, 6), "translation": slice(0, 3), "rotation": slice(3, 6)}


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joint positions, wrenches and directions."""
    random = np.random.default_rng(0)
    wrench = random.normal(size=(6, 6)) * [20, 20, 20, 3, 3, 3]
    return random.uniform(-1.2, 1.2, (6, 7)), wrench, random.normal(size=(6, 6))


class Pinocchio:
    """Compliance of the iiwa by Pinocchio: H from differences of the torque, and half of both triangles."""

    def __init__(self) -> None:
        self.model = pin.buildModelFromUrdf(str(URDF))
        self.data, self.tip = self.model.createData(), self.model.getFrameId("link_ee")

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return J (6, 7), hybrid."""
        return np.array(pin.computeFrameJacobian(self.model, self.data, q, self.tip, pin.LOCAL_WORLD_ALIGNED))

    def compliance(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Return C (6, 6); the symmetric half of d(J^T F)/dq is Kload, whose connection has no symmetric part."""
        step = 1e-4
        near, far = (
            np.array(
                [(self.jacobian(q + k * step * e) - self.jacobian(q - k * step * e)).T @ wrench for e in np.eye(7)]
            )
            for k in (1, 2)
        )
        load = (8 * near - far) / (12 * step)
        J = self.jacobian(q)
        return np.asarray(J @ np.linalg.solve(SPRINGS - (load + load.T) / 2, J.T))


def test_gradients_of_a_direction_against_the_kernels_products(robot: ModuleType, chain, states) -> None:
    """Compare with the VJP of tip_compliance for the cotangent u u^T: another program."""
    q, wrench, u = states
    options = KernelOptions(kernels=("hybrid.tip_compliance",), derivatives=True)
    compliance, product = (
        casadi_function(chain, next(each for each in chain_kernels(chain, options) if each.qualified_name == name))
        for name in ("hybrid_tip_compliance", "hybrid_tip_compliance_vjp")
    )
    value, gradient = stiffgen.compliance_gradient(robot, q, wrench, SPRINGS, u)
    for k in range(len(q)):
        C = np.array(compliance(q[k], wrench[k], SPRINGS))
        assert value[k] == pytest.approx(u[k] @ C @ u[k], rel=1e-13)
        expected, *_ = product(q[k], wrench[k], SPRINGS, np.outer(u[k], u[k]))
        assert np.abs(gradient[k] - np.array(expected).ravel()).max() <= 1e-12 * np.abs(gradient[k]).max()
    force = stiffgen.compliance_gradient(robot, q[0], wrench, SPRINGS, [0, 0, 1.0])
    assert force[1].shape == (6, 7)
    assert force[0][0] == pytest.approx(np.array(compliance(q[0], wrench[0], SPRINGS))[2, 2], rel=1e-13)


@pytest.mark.parametrize("block", BLOCKS)
def test_gradients_of_determinants_against_differences_by_pinocchio(robot: ModuleType, states, block) -> None:
    """Compare log determinant and gradient with differences of fourth order (step 1e-3 rad) by Pinocchio."""
    (q, wrench, _), arm, step, rows = states, Pinocchio(), 1e-3, BLOCKS[block]
    logarithm, gradient = stiffgen.compliance_determinant_gradient(robot, q, wrench, SPRINGS, block)

    def expected(position: np.ndarray, load: np.ndarray) -> float:
        return float(np.linalg.slogdet(arm.compliance(position, load)[rows, rows])[1])

    for k in range(3):
        assert logarithm[k] == pytest.approx(expected(q[k], wrench[k]), rel=1e-8)
        sides = {
            size: np.array([expected(q[k] + size * step * e, wrench[k]) for e in np.eye(7)]) for size in (-2, -1, 1, 2)
        }
        difference = (8 * (sides[1] - sides[-1]) - (sides[2] - sides[-2])) / (12 * step)
        assert np.abs(gradient[k] - difference).max() <= 1e-6 * np.abs(difference).max()


def test_unstable_and_singular_postures_have_none(robot: ModuleType) -> None:
    """Mix unstable and infinite rows with good ones: only these are NaN; a straight arm has no volume."""
    q = np.array([np.full(7, 0.4), np.zeros(7), np.full(7, np.nan)])
    wrench = np.array([[0.0] * 6, [0, 0, -100.0, 0, 0, 0], [0.0] * 6])
    value, gradient = stiffgen.compliance_gradient(robot, q, wrench, np.full(7, 100.0), [1.0, 0, 0])
    assert np.isnan(value).tolist() == [False, True, True]
    assert np.isnan(gradient).all(axis=1).tolist() == [False, True, True]
    assert np.isfinite(gradient[0]).all()
    straight = stiffgen.compliance_determinant_gradient(robot, np.zeros(7), np.zeros(6), np.full(7, 100.0))
    assert np.isnan(straight[0])
    assert np.isnan(straight[1]).all()


def test_what_is_refused(robot: ModuleType) -> None:
    """Pass wrong shapes or blocks: refused, and the argument is named."""
    q, F, K = np.zeros(7), np.zeros(6), np.ones(7)
    for call, words in (
        (lambda: stiffgen.compliance_gradient(robot, q, F, K, np.ones(4)), "takes directions"),
        (lambda: stiffgen.compliance_gradient(robot, q, F[:3], K, np.ones(3)), "takes wrenches"),
        (lambda: stiffgen.compliance_gradient(robot, q[:3], F, K, np.ones(3)), "takes a robot with a fixed base"),
        (lambda: stiffgen.compliance_determinant_gradient(robot, q, F, K, "force"), "no block 'force'"),
    ):
        with pytest.raises(stiffgen.StiffgenError, match=words):
            call()
