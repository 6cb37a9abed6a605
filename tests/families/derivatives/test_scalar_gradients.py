# SPDX-License-Identifier: MIT
"""Manipulability and its gradient, and the gradient of the joint stiffness along a direction."""

from __future__ import annotations

import numpy as np
import pytest

from stiffgen import StiffnessModel, load_chain
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.poses import gamma_F
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH, References
from stiffgen.families.derivatives.direction import DIRECTION
from stiffgen.families.derivatives.oracles import gradient_along
from stiffgen.families.manipulability.oracles import manipulability
from support.chains import chain_urdf
from support.complex_step import columns, gradients
from support.exact_tree import AT_ORIGIN, ExactTree, mp
from support.pinocchio_oracle import PinocchioChain, with_exact_right_angles
from support.project import ROOT, URDF, assert_close

DATA = ROOT / "tests" / "data"
ARMS = {URDF: "link_ee", DATA / "ur5.urdf": "tool0", DATA / "panda.urdf": "panda_hand", DATA / "solo12.urdf": "FL_FOOT"}

MEASURE = "manipulability", "manipulability_gradient"
ALONG = "hybrid.stiffness_direction_gradient"
BASES = pytest.mark.parametrize(
    "floating", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["fixed", "floating"]
)


def _arm(urdf, tmp_path):
    """Chain to the tip, and the same by Pinocchio."""
    file = tmp_path / urdf.name
    file.write_text(with_exact_right_angles(urdf.read_text()))
    return load_chain(file, tip=ARMS[urdf]), PinocchioChain(file.read_text(), ARMS[urdf])


@pytest.mark.parametrize("urdf", ARMS, ids=lambda urdf: urdf.stem)
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.DescriptionWarning")
def test_manipulability_by_pinocchio(urdf, tmp_path):
    """w by singular values, and w tr(J^+ dJ/dq_i); a leg of three joints has the determinant of J^T J."""
    chain, oracle = _arm(urdf, tmp_path)
    kernels = StiffnessModel(chain, kernels=MEASURE)
    for q in np.random.default_rng(3).uniform(-1.5, 1.5, (4, len(chain.coordinates))):
        state = oracle.at(q)
        J, rates = state.jacobian["hybrid"], state.derivative["hybrid"]
        w = np.prod(np.linalg.svd(J, compute_uv=False))
        assert abs(float(kernels.manipulability(q)) / w - 1) < 1e-12
        gradient = [w * np.trace(np.linalg.pinv(J) @ rate) for rate in rates]
        assert_close(np.array(kernels.manipulability_gradient(q)).ravel(), np.array(gradient))


def _exact_manipulability(tree, q):
    (J,) = tree.twists(AT_ORIGIN, q, len(q), lambda poses: [poses[tree.joints[-1].child]])
    return mp.sqrt(mp.det(J * J.T))


@pytest.mark.parametrize("elbow", [1.1, pytest.param(1e-3, marks=pytest.mark.wide), 1e-7], ids=["far", "near", "at"])
def test_sixty_digits_close_to_a_singularity(elbow):
    """Straighten the elbow: the error of w stays one rounding of J, which det(J J^T) would lose."""
    q = np.array([0.3, -0.7, 0.5, elbow, 0.9, -1.2, 0.4])
    chain = load_chain(URDF)
    tree, exact = ExactTree(URDF.read_text(), [c.name for c in chain.coordinates]), [mp.mpf(each) for each in q]
    kernels, w = StiffnessModel(chain, kernels=MEASURE), _exact_manipulability(tree, exact)
    assert abs(float(kernels.manipulability(q)) - float(w)) < 2e-16
    step, gradient = mp.mpf(10) ** -12, []
    for k in range(7):
        ends = [_exact_manipulability(tree, [e + s * step * (i == k) for i, e in enumerate(exact)]) for s in (1, -1)]
        gradient.append(float((ends[0] - ends[1]) / (2 * step)))
    found = np.array(kernels.manipulability_gradient(q)).ravel()
    assert np.abs(found - gradient).max() < max(1e-15 / elbow, 1e-15)


def test_measure_and_gradient_are_zero_where_w_is_zero(tmp_path):
    """Take six parallel slides, where w is 0: exact zeros give no NaN, but NaN in gives NaN out."""
    file = tmp_path / "slides.urdf"
    file.write_text(chain_urdf("pppppp"))
    kernels, q = StiffnessModel(load_chain(file), kernels=MEASURE), np.linspace(-1, 1, 6)
    assert float(kernels.manipulability(q)) == 0
    assert not np.array(kernels.manipulability_gradient(q)).any()
    file.write_text(chain_urdf("rrrrrr"))
    kernels, q[2] = StiffnessModel(load_chain(file), kernels=MEASURE), np.nan
    assert np.isnan(float(kernels.manipulability(q)))
    assert np.isnan(np.array(kernels.manipulability_gradient(q))).all()


@BASES
@pytest.mark.parametrize("types", ["rprrp", pytest.param("rrmrrprr", marks=pytest.mark.wide)])
def test_sliding_and_mimic_joints_and_a_tool_of_run_time(types, floating, tmp_path):
    """Compare manipulability and its gradients with the references, for other joints and tools."""
    file = tmp_path / "robot.urdf"
    file.write_text(chain_urdf(types))
    chain = load_chain(file, floating_base=floating, runtime_tool=True)
    kernels, references = StiffnessModel(chain, kernels=(*MEASURE, ALONG)), References(chain, 3, 5)
    expected = references.of(manipulability)
    along = gradient_along(references, references.samples[DIRECTION], references.samples[TASK_STIFFNESS])
    for k in range(3):
        seen, where = ([each[k] for each in references.posture_of(rep)] for rep in ("body", "hybrid"))
        assert_close(np.array(kernels.manipulability(*seen)).ravel(), expected.measure[k : k + 1])
        assert_close(np.array(kernels.manipulability_gradient(*seen)).ravel(), expected.gradient[k])
        held = references.samples[WRENCH][k], references.samples[TASK_STIFFNESS][k], references.samples[DIRECTION][k]
        found = np.array(kernels.hybrid.stiffness_direction_gradient(*where, *held)).ravel()
        assert_close(found, along[k].astype(float))


def _kernel(chain, name):
    (found,) = (each for each in chain_kernels(chain) if each.qualified_name == name)
    return found


@BASES
def test_direction_gradient_by_complex_steps(floating):
    """v^T Kq v of the joint stiffness, which Pinocchio confirms, with imaginary steps of q and of the base."""
    chain = load_chain(DATA / "ur5.urdf", tip="tool0", floating_base=floating)
    stiffness = _kernel(chain, "hybrid_joint_stiffness")
    references = References(chain, 4, 2)
    given = [*references.posture_of("hybrid"), references.samples[WRENCH], references.samples[TASK_STIFFNESS]]
    shaped = [columns(each, each.shape[1:]) for each in given]
    v = references.samples[DIRECTION]
    of = gradients(casadi_function(chain, stiffness), shaped, [v[:, :, None] * v[:, None, :]])
    expected = np.concatenate([each[..., 0] for each in of[: len(references.posture_of("hybrid"))]], axis=1)
    kernels = StiffnessModel(chain, kernels=ALONG)
    for k in range(4):
        found = kernels.hybrid.stiffness_direction_gradient(*(each[k] for each in given), v[k])
        assert_close(np.array(found).ravel(), expected[k])


def test_gradient_of_the_smallest_eigenvalue_by_pinocchio(tmp_path):
    """Compare with fourth-order differences of the smallest eigenvalue of Kq from Pinocchio's Hessian, F and K held."""
    chain, oracle = _arm(URDF, tmp_path)
    random = np.random.default_rng(9)
    F, K = random.normal(size=6) * 20, np.diag([700.0, 600, 800, 30, 20, 25])  # [N, N m], [N/m, N m/rad]
    kernels, step = StiffnessModel(chain, kernels=("hybrid.joint_stiffness", ALONG)).hybrid, 1e-3

    def smallest(q):
        return np.linalg.eigvalsh(oracle.at(q).joint_stiffness("hybrid", F, K + gamma_F("hybrid", F)))[0]

    for q in random.uniform(-1.5, 1.5, (3, 7)):
        _, vectors = np.linalg.eigh(np.array(kernels.joint_stiffness(q, F, K)))
        found = np.array(kernels.stiffness_direction_gradient(q, F, K, vectors[:, 0])).ravel()
        ends = [[smallest(q + k * step * e) for k in (-2, -1, 1, 2)] for e in np.eye(7)]
        expected = np.array(ends) @ [1, -8, 8, -1] / (12 * step)
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
