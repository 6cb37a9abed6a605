# SPDX-License-Identifier: MIT
"""Every kernel of the smallest robots against 60 digits: one joint, one coordinate, one motor, paths of one joint.

A size of 1 makes a vector, a matrix and a number alike. Code that infers which of them an array is goes wrong here.
"""

from __future__ import annotations

import numpy as np
import pytest

from core.kernel_references import MotorReferences, References
from stiffgen.core.errors import ChainError
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Q, configuration_arguments
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import as_results
from stiffgen.families.derivatives.check import check_derivatives
from support.exact_linkage import ExactLinkage, closed_state
from support.small_robots import LINKAGES, TREES, Small, part

BOUND = 1e-11
CANCELLED = 1e-3
"""Share of the largest argument that counts as size of a result whose terms cancel, or which is zero."""
ALL_SPRINGS = KernelOptions(springs=("rotation_vector", "quaternion", "coupled", "bounded"))
SPRINGS = [
    pytest.param(KernelOptions(), id="one spring"),
    pytest.param(ALL_SPRINGS, id="all springs", marks=pytest.mark.slow),
]
ELSEWHERE = {"condition"}
"""Kernels of closed loops that other tests cover: test_loops.py has the closed form."""


def given_to(kernel: Kernel, pool: dict, sample: int) -> dict[str, np.ndarray]:
    return {argument.name: pool[argument][sample] for argument in kernel.arguments}


def error(chain: Chain, kernel: Kernel, given: dict[str, np.ndarray], reference: list[np.ndarray]) -> float:
    """Return the largest error of a kernel's results relative to the reference's largest entry or what cancelled."""
    shaped = [np.reshape(given[a.name], folded(a.array(chain).shape) or (1,)) for a in kernel.arguments]
    values = as_results(casadi_function(chain, kernel)(*shaped))
    worst, cancelled = 0.0, CANCELLED * max(float(np.abs(each).max()) for each in given.values())
    for value, expected, result in zip(values, reference, kernel.results, strict=True):
        assert expected.shape == result.array(chain).shape, kernel.qualified_name
        difference = np.abs(np.asarray(value).reshape(expected.shape) - expected).max()
        worst = max(worst, float(difference) / (float(np.abs(expected).max()) + cancelled))
    return worst


@pytest.mark.parametrize("springs", SPRINGS)
@pytest.mark.parametrize("robot", [
    pytest.param(name, marks=() if name.startswith("one sliding") else pytest.mark.slow) for name in TREES
])  # fmt: skip
def test_kernels_of_trees(robot: str, springs: KernelOptions, tmp_path) -> None:
    chain, errors = TREES[robot].load(tmp_path), {}
    pool = argument_samples(chain, 2, 5, springs)
    where = {each.name: pool[each][1] for each in configuration_arguments(runtime_tool=False, floating=chain.floating)}
    for kernel in chain_kernels(chain, springs):
        given = given_to(kernel, pool, 1)
        reference = References(TREES[robot].urdf, chain, where | given).of(kernel)
        errors[kernel.qualified_name] = error(chain, kernel, given, reference)
    assert {name: each for name, each in errors.items() if not each <= BOUND} == {}
    assert len(errors) == len(chain_kernels(chain, springs))


@pytest.mark.parametrize("springs", SPRINGS)
@pytest.mark.parametrize("robot", [
    pytest.param(name, marks=pytest.mark.slow if name == "four-bar" else ()) for name in LINKAGES
])  # fmt: skip
def test_motors_of_linkages(robot: str, springs: KernelOptions, tmp_path) -> None:
    """Against energies whose loops are closed again for every difference, at tips on crank, coupler and rocker."""
    small, seed = LINKAGES[robot], 3
    chain, errors = small.load(tmp_path), {}
    assert {len(chain.branch(tip).joints) for tip in chain.tips} <= {1, 2}
    _, q = closed_state(chain, seed)
    exact = ExactLinkage(small.linkage, [each.name for each in chain.coordinates], chain.actuated, q)
    pool = argument_samples(chain, 2, seed, springs)
    for kernel in chain_kernels(chain, springs):
        if kernel.group == "motors" and kernel.name not in ELSEWHERE:
            given = given_to(kernel, pool, 1)
            closed = given if kernel.name == "residual" else given | {"q": np.array([float(x) for x in exact.q])}
            reference = MotorReferences(exact, chain, closed).of(kernel)
            errors[kernel.qualified_name] = error(chain, kernel, closed, reference)
    assert {name: each for name, each in errors.items() if not each <= BOUND} == {}
    assert len(errors) >= 8


@pytest.mark.slow
@pytest.mark.parametrize("robot", [
    pytest.param(name, marks=pytest.mark.wide if name == "four-bar" else ()) for name in LINKAGES
])  # fmt: skip
def test_kernels_of_linkages_as_trees(robot: str, tmp_path) -> None:
    """Open loops leave a tree whose paths to the tips hold one or two of its three coordinates."""
    chain, errors = LINKAGES[robot].load(tmp_path), {}
    pool = argument_samples(chain, 2, 5)
    for kernel in chain_kernels(chain):
        if kernel.group != "motors" and kernel.name != "close":
            given = given_to(kernel, pool, 1)
            reference = References(LINKAGES[robot].urdf, chain, {"q": pool[Q][1]} | given).of(kernel)
            errors[kernel.qualified_name] = error(chain, kernel, given, reference)
    assert {name: each for name, each in errors.items() if not each <= BOUND} == {}


def test_verify_accepts_the_product_of_a_mass_matrix(tmp_path) -> None:
    """Few entries of a floating base with one joint depend on q: the others' rounding must not enter the difference."""
    chain = TREES["one joint on a floating base"].load(tmp_path)
    table = tuple(k for k in chain_kernels(chain, KernelOptions(derivatives=True)) if k.name.startswith("mass_matrix"))
    kernels = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    for seed in range(5):
        pool = argument_samples(chain, 24, seed, KernelOptions(derivatives=True))
        assert [each for each in check_derivatives(kernels, table, chain, pool) if not each.passed] == []


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("tips", ["fixed", ["one", "fixed"]])
def test_a_tip_whose_path_holds_no_joint_is_refused(tips, floating: bool, tmp_path) -> None:
    robot = Small(part("base", "one") + part("base", "fixed", "fixed"), {"tip": tips, "floating_base": floating})
    with pytest.raises(ChainError, match="no moving joint between base 'base' and tip 'fixed'; choose another tip"):
        robot.load(tmp_path)
