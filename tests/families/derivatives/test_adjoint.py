# SPDX-License-Identifier: MIT
"""Reverse mode: every kernel's vector-Jacobian product against complex steps of the kernel itself."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import relative_error
from support.chains import chain_urdf
from support.complex_step import columns, gradients
from support.exact_tree import tree_urdf
from support.project import ROOT, URDF

BOUND = 1e-11
OPTIONS = KernelOptions(springs=("rotation_vector", "quaternion", "coupled"), derivatives=True)
ROBOTS = {
    "seven turning joints": lambda folder: stiffgen.load_chain(URDF),
    "sliding and mimic joints": lambda folder: of_types(folder, "rprmrr"),
    "nine joints": lambda folder: of_types(folder, "r" * 9),
    "tool at run time": lambda folder: of_types(folder, "rp", runtime_tool=True),
    "two tips": lambda folder: stiffgen.load_chain(
        ROOT / "tests" / "data" / "dual_arm.urdf", tip=["left hand", "right-hand"]
    ),
    "small": lambda folder: of_types(folder, "rpm"),
    "floating arm with a tool": lambda folder: of_types(folder, "rpr", runtime_tool=True, floating_base=True),
    "floating tree": lambda folder: tree(folder, "left", "right"),
    "small floating": lambda folder: of_types(folder, "rpm", floating_base=True),
    "floating slide and mimic joint with a tool": lambda folder: of_types(
        folder, "pm", runtime_tool=True, floating_base=True
    ),
}


def tree(folder, *tips):
    """Six joints with two tips, sliding and mimic ones among them, on a floating base."""
    urdf = folder / "tree.urdf"
    urdf.write_text(tree_urdf(7, joints=6))
    return stiffgen.load_chain(urdf, tip=tips, floating_base=True)


def of_types(folder, types, **options):
    urdf = folder / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    return stiffgen.load_chain(urdf, **options)


def worst_errors(chain, count, seed):
    """Return the worst error of each kernel's products at random states."""
    pool = argument_samples(chain, count, seed, OPTIONS)
    return {kernel.qualified_name: worst_error(chain, kernel, product, pool) for kernel, product in products(chain)}


def worst_error(chain, kernel, product, pool):
    """Return the largest error of a kernel's products at some states, relative to the gradient's largest entry."""
    forward, backward = casadi_function(chain, kernel), casadi_function(chain, product)
    stacks = [columns(pool[a], a.array(chain).shape) for a in product.arguments]
    given, cotangents = stacks[: len(kernel.arguments)], stacks[len(kernel.arguments) :]
    expected = gradients(forward, given, cotangents)
    count = len(stacks[0])
    found = backward.map(count)(*(np.concatenate(list(stack), axis=1) for stack in stacks))
    worst = 0.0
    for value, reference in zip(found if isinstance(found, tuple) else (found,), expected, strict=True):
        rows, width = reference.shape[1:]
        dense = np.asarray(value).reshape(rows, count, width).transpose(1, 0, 2)
        difference = np.abs(dense - reference).reshape(count, -1).max(axis=1)
        size = np.abs(reference).reshape(count, -1).max(axis=1)
        worst = max(worst, float((difference / np.where(size == 0, 1.0, size)).max()))
    return worst


def products(chain):
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain, OPTIONS) if not kernel.is_gradient}
    pairs = [(kernel, table[f"{name}_vjp"]) for name, kernel in table.items() if not name.endswith("_vjp")]
    assert 2 * len(pairs) == len(table)
    return pairs


@pytest.mark.parametrize(
    "robot",
    [
        "small",
        pytest.param("floating slide and mimic joint with a tool", marks=pytest.mark.slow),
        *(
            pytest.param(robot, marks=pytest.mark.wide)
            for robot in ("tool at run time", "small floating", "two tips", "floating arm with a tool", "floating tree")
        ),
    ],
)
def test_products_are_complex_steps(robot, tmp_path):
    """Compare all VJPs and JVPs with complex steps, which have no cancellation."""
    chain = ROBOTS[robot](tmp_path)
    errors = worst_errors(chain, 3, seed=5)
    assert {name: error for name, error in errors.items() if not error <= BOUND} == {}


@pytest.mark.wide(instead="test_products_are_complex_steps")
@pytest.mark.parametrize("robot", ["sliding and mimic joints", "small floating", "seven turning joints", "nine joints"])
def test_two_hundred_states(robot, tmp_path):
    chain = ROBOTS[robot](tmp_path)
    errors = worst_errors(chain, 200, seed=6)
    assert {name: error for name, error in errors.items() if not error <= BOUND} == {}


def test_gradients_of_stiffnesses_are_symmetric(chain):
    """task_stiffness_bar is the symmetric part of the gradient by a full K, to the last bit symmetric."""
    model = stiffgen.StiffnessModel(chain, derivatives=True, kernels=("hybrid.jacobian", "hybrid.joint_stiffness"))
    random = np.random.default_rng(3)
    q, F, K, C = (random.normal(size=shape) for shape in (chain.dof, 6, (6, 6), (chain.dof, chain.dof)))
    K_bar = np.asarray(model.hybrid.joint_stiffness_vjp(q, F, K, C)[2])
    assert np.array_equal(K_bar, K_bar.T)
    J = np.asarray(model.hybrid.jacobian(q))
    both = J @ C @ J.T  # Kq is linear in K: the gradient by a full K
    assert np.abs(K_bar - (both + both.T) / 2).max() <= 1e-12 * np.abs(both).max()


@pytest.mark.slow
def test_both_triangles_of_a_cotangent_count(chain):
    """Transpose the cotangent of a symmetric result: the products stay, up to rounding."""
    model = stiffgen.StiffnessModel(chain, derivatives=True, kernels=("hybrid.jacobian", "hybrid.joint_stiffness"))
    random = np.random.default_rng(4)
    q, F, K, C = (random.normal(size=shape) for shape in (chain.dof, 6, (6, 6), (chain.dof, chain.dof)))
    for one, other in zip(
        model.hybrid.joint_stiffness_vjp(q, F, K, C), model.hybrid.joint_stiffness_vjp(q, F, K, C.T), strict=True
    ):
        assert relative_error(np.asarray(one)[None], np.asarray(other)[None]) <= 1e-12


def test_gradients_of_energies_are_forces(tmp_path):
    """On a floating base, base_pose_bar and q_bar together are what torque and gravity's gradient are made of."""
    chain = ROBOTS["small floating"](tmp_path)
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain, OPTIONS)}
    pool = argument_samples(chain, 3, 8, OPTIONS)
    for energy, force, sign in (
        ("spring_energy", "spring_torque", -1),
        ("spring_rotation_vector_energy", "spring_rotation_vector_torque", -1),
        ("gravity_energy", "gravity_gradient", 1),
    ):
        product, known = (casadi_function(chain, table[name]) for name in (f"{energy}_vjp", force))
        assert [table[f"{energy}_vjp"].results[k].name for k in (0, 1)] == ["base_pose_bar", "q_bar"]
        for k in range(3):
            given = [pool[argument][k] for argument in table[energy].arguments]
            base, joints, *_ = (np.asarray(each) for each in product(*given, 1.0))
            expected = sign * np.asarray(known(*given))
            found = np.concatenate([base, joints])
            assert found.shape == expected.shape == (chain.dof, 1)
            assert relative_error(found[None], expected[None]) <= 1e-13


def test_what_does_not_depend_on_the_base_has_no_gradient_by_it(tmp_path):
    chain = ROBOTS["small floating"](tmp_path)
    for kernel, product in products(chain):
        takes = any(argument.name == "base_pose" for argument in kernel.arguments)
        assert takes == ("base_pose_bar" in [result.name for result in product.results])
        without = ("mass_matrix", "connection_correction", "manipulability")
        assert takes != (kernel.group in ("body", "posture", "limits") or kernel.name in without)


def test_default_table_has_no_products(chain):
    assert not any(kernel.name.endswith("_vjp") for kernel in chain_kernels(chain))
