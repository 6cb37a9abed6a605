# SPDX-License-Identifier: MIT
"""Compliance of the tip: oracles beside the limit of stability, the closed form of Chen and Kao, MuJoCo, refusals.

``tests/campaigns/compliance.py`` compares 200 trees and 1000 postures beside the limit of stability.
"""

from __future__ import annotations

import importlib
import math

import casadi as ca
import numpy as np
import pytest

from stiffgen import StiffnessModel, generate, load_chain, open_robot
from stiffgen.core.errors import ChainError
from stiffgen.core.lower.steps import lowered
from stiffgen.core.lower.variant import BATCH
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels import formulas
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_oracles, check_robot
from stiffgen.core.verify.kernels.samples import Samples, argument_samples
from stiffgen.families.compliance import expressions as compliance
from stiffgen.families.loops.oracles import check_loops
from support.compliance_limit import FAMILY, Case
from support.exact_linkage import random_linkage
from support.exact_tree import tree_urdf
from support.project import ROOT
from support.small_robots import LINKAGES, TREES, Small, part

UR5 = ROOT / "tests" / "data" / "ur5.urdf"
WRENCH = np.array([20.0, -30, 60, 4, -3, 5])


@pytest.fixture(scope="module")
def ur5():
    """Return functions of one state by name."""
    chain = load_chain(UR5, tip="tool0")
    table = chain_kernels(chain, KernelOptions(kernels=("all", "compliance")))
    wanted = [each for each in table if each.on_request or each.group in ("hybrid", None)]
    functions = {each.qualified_name: function_of_stacks(chain, each) for each in wanted}
    return lambda name, *given: functions[name](*(np.asarray(each, dtype=float)[None] for each in given))[0]


@pytest.mark.parametrize(
    ("seed", "rep", "total", "floating"),
    [
        (0, "hybrid", True, False), (1, "body", False, False), (2, "spatial", True, False),
        pytest.param(3, "body", True, True, marks=pytest.mark.slow),
        *(
            pytest.param(3, rep, total, True, marks=pytest.mark.wide)
            for rep, total in (("hybrid", False), ("spatial", True), ("spatial", False))
        ),
    ],
    ids=str,
)  # fmt: skip
def test_trees_on_both_sides_of_the_limit(seed, rep, total, floating, tmp_path):
    """Load trees on both sides of the stability limit: values agree, and NaN exactly where unstable."""
    file = tmp_path / "tree.urdf"
    file.write_text(tree_urdf(seed, 4))
    case = Case(load_chain(file, tip=["left", "right"], floating_base=floating), rep, total=total, seed=seed)
    stable = set()
    for springs in (case.springs, case.near_the_limit(1e-2), case.near_the_limit(-1e-2)):
        checks = case.checks(springs)
        assert [check for check in checks if not check.passed] == []
        is_stable = case.eigenvalues(springs)[0] > 0
        assert set(case.refusals(springs).values()) == {not is_stable}
        assert len({check.kernel for check in checks}) >= (len(case.kernels) if is_stable else 0)
        stable.add(bool(is_stable))
    assert stable == {False, True}


def test_oracles_of_verify_see_a_wrong_sign(monkeypatch):
    """Turn the sign of the load's stiffness: each function of compliance must fail."""
    chain = load_chain(UR5, tip="tool0")
    table = [each for each in chain_kernels(chain, FAMILY) if each.on_request and each.group == "hybrid"]
    assert not check_oracles(table, FAMILY)

    def failed():
        functions = {each.qualified_name: function_of_stacks(chain, each) for each in table}
        return {each.kernel for each in check_robot(functions, chain, 3, 0, FAMILY, table) if not each.passed}

    assert not failed()
    for name in ("packed_hessian", "loaded_hessian"):
        right = getattr(compliance, name)
        monkeypatch.setattr(compliance, name, lambda chain, springs, load, right=right: right(chain, springs, -load))
    table = [each for each in chain_kernels(chain, FAMILY) if each.on_request and each.group == "hybrid"]
    assert failed() == {each.qualified_name for each in table}


@pytest.mark.parametrize(
    "robot",
    [
        "one coordinate of two joints",
        *(pytest.param(robot, marks=pytest.mark.slow) for robot in ("four-bar", "one joint on a floating base")),
        *(pytest.param(robot, marks=pytest.mark.wide) for robot in ("one turning joint", "slider-crank")),
    ],
)
def test_smallest_scope(robot, tmp_path):
    """Evaluate robots with one joint or motor, where H is a number; loops stay closed many turns away."""
    chain = {**TREES, **LINKAGES}[robot].load(tmp_path)
    table = [each for each in chain_kernels(chain, FAMILY) if each.on_request]
    every = (*chain_kernels(chain), *table)
    functions = {each.qualified_name: function_of_stacks(chain, each) for each in every}
    checks = check_robot(functions, chain, 5, 0, FAMILY, table)
    checks += check_loops(functions, chain, 5, 0, FAMILY, table) if chain.actuated else []
    assert {each.kernel for each in checks} >= {each.qualified_name for each in table}
    assert [each for each in checks if not each.passed] == []


def test_far_angles_are_whole_turns(tmp_path, monkeypatch):
    """Check the samples far away: they differ from the near ones by whole turns, some by more than 1e8."""
    pools = []
    monkeypatch.setattr(formulas, "compare", lambda kernels, chain, pool, options: pools.append(pool) or [])
    chain = LINKAGES["four-bar"].load(tmp_path)
    formulas.check_far_angles({}, chain, 1)
    near = argument_samples(chain, len(pools[0][Q]), 1, None)[Q]
    turns = (pools[0][Q] - near) / math.tau
    assert np.abs(turns).max() > 1e8
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-7)


def test_chen_and_kao_for_a_pure_force(ur5):
    """Compare with the conservative congruence transformation: equal and symmetric without a moment."""
    random = np.random.default_rng(0)
    force = np.array([20.0, -30, 60, 0, 0, 0])
    for _ in range(10):
        q = np.array([0, -1, 1.5, 0.3, 1, 0]) + random.uniform(-0.5, 0.5, 6)
        springs = np.diag(random.uniform(2e3, 8e3, 6))
        J, load = ur5("hybrid_jacobian", q), ur5("hybrid_kinematic_stiffness", q, force)
        inverse = np.linalg.inv(J)
        expected = inverse.T @ (springs - load) @ inverse
        found = ur5("hybrid_tip_stiffness", q, force, springs)
        rounding = 1e-15 * np.linalg.cond(J) * np.linalg.cond(springs) * np.abs(expected).max()
        assert np.abs(found - expected).max() <= rounding


def test_representations_agree_and_an_unloaded_arm_needs_no_wrench(ur5):
    q, springs = np.array([0.3, -1, 1.2, 0.4, 0.9, -0.2]), np.diag([900.0, 800, 700, 300, 200, 100])
    J = ur5("hybrid_jacobian", q)
    found = ur5("hybrid_tip_compliance", q, np.zeros(6), springs)
    assert np.abs(found - J @ np.linalg.inv(springs) @ J.T).max() <= 1e-15 * np.abs(found).max() * 100
    stability = [ur5(f"{rep}_stability", q, np.zeros(6), springs) for rep in ("body", "hybrid")]
    assert np.allclose(stability, 100.0, rtol=1e-15, atol=0)


def at_origin(pose, wrench):
    """Return X, which moves a twist from the tip to the origin, and a wrench with its moment about the origin."""
    X = np.eye(6)
    X[:3, 3:] = np.cross(np.eye(3), pose[:3, 3])
    return X, np.linalg.solve(X.T, wrench)


def test_one_load_has_one_hessian(ur5):
    """Compare the spatial with the hybrid compliance of one load. Before, they answered two loads, 1 to 38 % apart."""
    random = np.random.default_rng(5)
    for _ in range(10):
        q = np.array([0, -1, 1.5, 0.3, 1, 0]) + random.uniform(-0.5, 0.5, 6)
        # [N m/rad]; [N], [N m]
        springs, wrench = np.diag(random.uniform(300, 900, 6)), random.normal(size=6) * [60, 60, 60, 8, 8, 8]
        X, moved = at_origin(ur5("forward_kinematics", q), wrench)
        expected = X @ ur5("hybrid_tip_compliance", q, wrench, springs) @ X.T
        found = ur5("spatial_tip_compliance", q, moved, springs)
        assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max()
        found = X.T @ ur5("spatial_tip_stiffness", q, moved, springs) @ X
        expected = ur5("hybrid_tip_stiffness", q, wrench, springs)
        assert np.abs(found - expected).max() <= 1e-12 * np.linalg.cond(X) ** 2 * np.abs(expected).max()


def test_a_straight_arm_beyond_its_load_is_refused_in_all_representations():
    """Load a straight arm beyond its limit: NaN in all representations. Before: 27 N m/rad in place of -99."""
    chain = load_chain(ROOT / "urdf" / "iiwa14.urdf", tip="link_ee")
    model = StiffnessModel(chain, kernels="compliance")
    q, springs, push = np.zeros(7), 100 * np.eye(7), np.array([0, 0, -150.0, 0, 0, 0])
    _, spatial = at_origin(np.array(model.forward_kinematics(q)), push)
    assert float(model.hybrid.stability(q, push, springs)) == pytest.approx(-99.18, abs=0.01)
    assert float(model.body.stability(q, push, springs)) == pytest.approx(-99.18, abs=0.01)
    for group, wrench in ((model.body, push), (model.spatial, spatial), (model.hybrid, push)):
        assert np.isnan(np.array(group.tip_compliance(q, wrench, springs))).all()


def test_joint_quantities_have_no_spatial_form(tmp_path, unoptimised):
    """Ask for removed functions: refused with the reason, by command, model, module and wrappers."""
    file = tmp_path / "tree.urdf"
    file.write_text(TREES["two tips on one way"].urdf)
    options = {"tip": TREES["two tips on one way"].options["tip"], "controller": False, "batches": False}
    chain = load_chain(file, tip=options["tip"])
    model = StiffnessModel(chain, kernels="spatial.tip_compliance")
    folder = generate(file, name="tree", output=tmp_path, kernels="spatial.tip_compliance", derivatives=True, **options)
    module = open_robot(folder).module
    wrapper = importlib.import_module(f"{module.__name__}.casadi")  # the others have the same namespaces
    tip = chain.tips[0].name
    for name in ("loaded_hessian", "deflection", "stability"):
        for place in (model, module, wrapper):
            for group, function in ((getattr(place, tip).spatial, name), (place.spatial, f"{name}_total")):
                with pytest.raises(AttributeError, match=f"no function '{function}': one load has one Hessian"):
                    getattr(group, function)
                assert not hasattr(group, "another")
        with pytest.raises(ChainError, match=f"spatial.{name}: one load has one Hessian.*take {name} of hybrid"):
            chain_kernels(chain, KernelOptions(kernels=("all", f"spatial.{name}")))
    assert vars(module.spatial).keys() >= {"tip_compliance_total"}


def planar():
    """Return an arm in the plane, whose tip cannot move in three directions."""
    flat = {"xyz": "0.3 0 0", "axis": "0 0 1", "rpy": "0 0 0"}
    joints = (("base", "one"), ("one", "two"), ("two", "three"))
    parts = "".join(part(parent, child, **flat) for parent, child in joints)
    return Small(parts + part("three", "end", "fixed", "0.3 0 0", rpy="0 0 0"), {"tip": "end"})


SMALL = {**TREES, **LINKAGES, "planar": planar()}


FURTHER = "one sliding joint", "two tips on one way", "two tips of one joint each", "slider-crank"


@pytest.mark.parametrize(
    "robot", [pytest.param(robot, marks=pytest.mark.wide if robot in FURTHER else ()) for robot in SMALL]
)
def test_the_model_refuses_whole_results(robot, tmp_path):
    """Evaluate unstable postures: the whole result is NaN. Before, 27 of 36 entries stayed zeros."""
    chain = SMALL[robot].load(tmp_path)
    pool = Samples(chain, 3, seed=0)
    for kernel in (each for each in chain_kernels(chain, FAMILY) if each.on_request):
        if kernel.name.startswith(("loaded_hessian", "stability")):
            continue
        for factor in (1e4, -1.0):  # stable, and unstable
            stacks = [(factor if each.name == "joint_stiffness" else 1) * pool[each] for each in kernel.arguments]
            found = np.isnan(function_of_stacks(chain, kernel)(*stacks))
            assert (found == (factor < 0)).all(), kernel.qualified_name


def test_mujoco_with_springs_in_the_joints(ur5, tmp_path):
    """Push the tip in MuJoCo, with springs in the joints: its compliance by differences of the force is C."""
    mujoco = pytest.importorskip("mujoco")
    optimize = pytest.importorskip("scipy.optimize")
    spec = mujoco.MjSpec.from_file(str(UR5))
    spec.compiler.discardvisual, spec.compiler.fusestatic = True, False
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    q0, springs = np.array([0.3, -1, 1.2, 0.4, 0.9, -0.2]), np.array([900.0, 800, 700, 300, 200, 100])
    model.jnt_stiffness[:], model.qpos_spring[:] = springs, q0
    data, body = mujoco.MjData(model), model.body("tool0").id
    J, rotations = np.zeros((3, 6)), np.zeros((3, 6))

    def forces(q, force):
        data.qpos[:], data.qvel[:] = q, 0
        mujoco.mj_forward(model, data)
        mujoco.mj_jac(model, data, J, rotations, data.xpos[body], body)
        return data.qfrc_passive + J.T @ force

    def tip(force, start):
        found = optimize.root(forces, start, args=(force,), tol=1e-14).x
        assert np.abs(forces(found, force)).max() < 1e-9
        return found, data.xpos[body].copy()

    force, step = np.array([20.0, -30, 60]), 1e-2  # [N]
    q, _ = tip(force, q0)
    sides = [[tip(force + s * step * axis, q)[1] for s in (1, -1)] for axis in np.eye(3)]
    measured = np.array([(up - down) / (2 * step) for up, down in sides]).T
    found = ur5("hybrid_tip_compliance", q, [*force, 0, 0, 0], np.diag(springs))[:3, :3]
    assert np.abs(found - measured).max() <= 1e-4 * np.abs(measured).max()
    without = J @ np.diag(1 / springs) @ J.T  # the load's terms left out
    assert np.abs(without - measured).max() > 1e-2 * np.abs(measured).max()


@pytest.mark.parametrize("scale", [1.0, 1e-150, 1e150])
def test_smallest_eigenvalues(scale):
    """Diagonal, double, zero and tiny eigenvalues; every size of a matrix from one to nine."""
    random = np.random.default_rng(2)
    for n in range(1, 10):
        triangle = ca.SX.sym("h", n * (n + 1) // 2)
        diagonal, squares = ca.SX.sym("d", n), ca.SX.sym("s", n - 1)
        interval = ca.SX.sym("x", 2)
        first = ca.Function("t", [triangle], [compliance.tridiagonal(None, triangle).result])
        step = ca.Function("s", [diagonal, squares, interval], [
            compliance.halved(None, diagonal, squares, interval).result
        ])  # fmt: skip
        cases = [np.zeros((n, n)), np.eye(n), np.diag(np.arange(n) - 1.0), np.ones((n, n))]
        cases += [(lambda a: a + a.T)(random.normal(size=(n, n))) for _ in range(5)]
        for matrix in (scale * case for case in cases):
            form = np.array(first(matrix[np.triu_indices(n)])).ravel()
            ends = form[2 * n - 1 :]
            for _ in range(compliance.CALLS):
                ends = np.array(step(form[:n], form[n : 2 * n - 1], ends)).ravel()
            expected = np.linalg.eigvalsh(matrix)
            assert abs(ends.mean() - expected[0]) <= 1e-15 * n * np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, pytest.param(True, marks=pytest.mark.wide)])
def test_compiled_calls_refuse_as_the_model_does(floating, tmp_path, unoptimised):
    """Single calls and stacks of a tree with mimic joints: stable, unstable, and joint stiffnesses that are no numbers.

    Single calls take the product from a helper of their own, whose Jacobian is by joints, coordinates or tips.
    """
    file, count = tmp_path / "tree.urdf", 24
    file.write_text(tree_urdf(3, 4))
    tips = ["left", "right"]
    options = {"tip": tips, "floating_base": floating, "kernels": "compliance", "controller": False}
    folder = generate(file, name="tree", output=tmp_path, **options)
    robot = open_robot(folder)
    pool = Samples(robot.chain, count, seed=3)
    # compliance and deflection of each tip
    table = [each for each in robot.table if each.on_request and each.name.startswith(("tip_comp", "deflec"))]
    assert {each.tip.name if each.tip else "" for each in table} == {"left", "right", ""}
    refused = 0
    for kernel in table:
        stacks = [pool[each].copy() for each in kernel.arguments]
        springs = stacks[[each.name for each in kernel.arguments].index("joint_stiffness")]
        springs *= np.where(np.arange(count) % 2, 10.0, 1e-3)[:, None, None]  # stable, and mostly not
        # Odd states get entries that are infinite, NaN, zero or huge, on the diagonal and beside it.
        last = springs.shape[1] - 1
        springs[1, 0, 0], springs[3, last, last], springs[5, last, last] = np.inf, np.inf, np.nan
        springs[7, 0, last], springs[9, 0, 0], springs[11] = np.inf, 0.0, 1e160 * springs[11]
        springs[13, 1, 1] = -np.inf
        with np.errstate(all="ignore"):
            expected = function_of_stacks(robot.chain, kernel)(*stacks)
            stacked = robot.kernels[kernel.qualified_name](*stacks)
            single = np.array([robot.kernels[kernel.qualified_name](*state) for state in zip(*stacks, strict=True)])
        no_number = np.isnan(expected.reshape(count, -1))
        assert no_number[[1, 3, 5, 7, 13]].all(), kernel.qualified_name  # those with infinity or NaN
        assert (no_number.all(axis=1) == no_number.any(axis=1)).all()
        refused += no_number[::2].all(axis=1).sum()
        for found in (stacked, single):
            np.testing.assert_array_equal(np.isnan(found.reshape(count, -1)), no_number, kernel.qualified_name)
            sizes = np.abs(expected.reshape(count, -1)).max(axis=1, initial=0.0)
            errors = np.abs(found - expected).reshape(count, -1).max(axis=1)
            assert (errors[~no_number.any(axis=1)] <= 1e-11 * sizes[~no_number.any(axis=1)]).all(), (
                kernel.qualified_name
            )
    assert refused > 10  # enough even states are unstable for the comparison of refusals to mean something


def test_products_are_lowered_column_by_column():
    """Reverse mode reads the cotangent of J by columns: a batch would read lanes of an array written as a whole."""
    chain = load_chain(UR5, tip="tool0")
    kernels = ("hybrid.tip_compliance", "body.deflection", "spatial.tip_compliance")
    options = KernelOptions(kernels=kernels, derivatives=True)
    functions = lowered(chain, BATCH)
    for kernel in chain_kernels(chain, options):
        assert functions.kernel(kernel).items


def test_kernels_on_request_alone():
    """Choose kernels: those of compliance and tangents come only when named."""
    chain = load_chain(UR5, tip="tool0")
    whole, more = chain_kernels(chain), chain_kernels(chain, KernelOptions(kernels=("all", "compliance")))
    assert not any(each.on_request for each in whole)
    assert [each.function for each in more if not each.on_request] == [each.function for each in whole]
    assert {each.function for each in more if each.on_request} >= {"hybrid_tip_compliance", "body_stability"}
    tangents = StiffnessModel(chain, kernels=("all", "tangents"))
    assert tangents.spring.positive_tangent.size_out(0) == (6, 6)
    assert not hasattr(StiffnessModel(chain).spring, "positive_tangent")
    assert list(vars(StiffnessModel(chain, kernels="hybrid.stability").hybrid)) == ["stability"]
    one = chain_kernels(chain, KernelOptions(kernels=("hybrid.tip_compliance",)))
    assert [each.function for each in one] == ["forward_kinematics", "hybrid_tip_compliance"]
    assert not any(each.on_request for each in chain_kernels(chain, KernelOptions(kernels=("hybrid",))))
    with pytest.raises(ChainError, match="compliance"):
        chain_kernels(chain, KernelOptions(kernels=("hybrid.compliance",)))


def test_a_tip_that_cannot_move_in_all_directions_has_no_stiffness():
    chain = load_chain(UR5, tip="wrist_1_link")
    names = {each.name for each in chain_kernels(chain, FAMILY)}
    assert "tip_stiffness" not in names
    assert "tip_compliance" in names


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_gradients_of_the_compliance_of_motors(tmp_path):
    """Compare gradients with central differences along closed configurations, in batches, too."""
    linkage, random, step = random_linkage(1), np.random.default_rng(0), 1e-5
    file = tmp_path / "linkage.urdf"
    file.write_text(linkage.urdf)
    kernels = "close", "motors.jacobian", "motors.tip_compliance"
    options = {"derivatives": True, "kernels": kernels, "controller": False}
    folder = generate(file, name="linkage", output=tmp_path, **options, **linkage.options)
    robot = open_robot(folder).module
    with np.errstate(invalid="ignore"):  # some positions of the motors have no closed configuration
        q = np.array([robot.close(each, robot.START) for each in random.uniform(-0.3, 0.3, (30, 2))])
    q = q[np.isfinite(q).all(axis=1)]
    count = len(q)
    roots, wrench = random.normal(size=(count, 2, 2)), 5 * random.normal(size=(count, 6))
    springs = 50 * roots @ roots.swapaxes(1, 2) + 2000 * np.eye(2)
    cotangent = random.normal(size=(count, 6, 6))
    q_bar, wrench_bar, springs_bar = robot.motors.tip_compliance_vjp(q, wrench, springs, cotangent)

    def moved(size):
        motors = q[:, list(actuated)] + size * turns
        return np.array([robot.close(each, near) for each, near in zip(motors, q, strict=True)])

    def product(*given):
        return (cotangent * robot.motors.tip_compliance(*given)).sum(axis=(1, 2))

    actuated = load_chain(file, **linkage.options).actuated
    turns, push = random.normal(size=(count, 2)), random.normal(size=(count, 6))
    stiffer = 100 * np.eye(2) * random.normal(size=(count, 1, 1))
    changes = (
        (product(moved(step), wrench, springs) - product(moved(-step), wrench, springs),
         (q_bar * np.einsum("nij,nj->ni", robot.motors.jacobian(q), turns)).sum(axis=1)),
        (product(q, wrench + step * push, springs) - product(q, wrench - step * push, springs),
         (wrench_bar * push).sum(axis=1)),
        (product(q, wrench, springs + step * stiffer) - product(q, wrench, springs - step * stiffer),
         (springs_bar * stiffer).sum(axis=(1, 2))),
    )  # fmt: skip
    assert count > 6
    for difference, expected in changes:
        np.testing.assert_allclose(difference / (2 * step), expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
