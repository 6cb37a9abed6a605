# SPDX-License-Identifier: MIT
"""Every kernel of the smallest robots by its oracles: one joint, one coordinate, one motor, paths of one joint.

A size of 1 makes a vector, a matrix and a number alike. Code that infers which of them an array is goes wrong here.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from stiffgen.core.errors import ChainError
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_oracles, check_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import Check
from stiffgen.families.derivatives.check import check_derivatives
from stiffgen.families.loops.oracles import CLOSE, check_loops
from support.small_robots import LINKAGES, TREES, Small, part

ALL_SPRINGS = KernelOptions(springs=("rotation_vector", "quaternion", "coupled", "bounded"))
FURTHER = (
    "one sliding joint", "two tips on one joint", "two tips of one joint each", "one coordinate of two joints",
    "four-bar", "slider-crank",
)  # fmt: skip
"""Robots that are wide with all springs: of each kind another one stays in CI."""


def cases(robots: Iterable[str], one_spring: dict[str, Any]) -> list[Any]:
    """Return every robot with one spring, quick but for the marks of ``one_spring``, and with all springs."""
    found = []
    for robot in robots:
        mark = one_spring.get(robot, ())
        found.append(pytest.param(robot, KernelOptions(), id=f"{robot}-one spring", marks=mark))
        mark = pytest.mark.wide if robot in FURTHER else pytest.mark.slow
        found.append(pytest.param(robot, ALL_SPRINGS, id=f"{robot}-all springs", marks=mark))
    return found


MARKS = dict.fromkeys(("one turning joint", "two tips on one joint", "slider-crank"), pytest.mark.slow) | {
    "four-bar": pytest.mark.wide
}


def failed_checks(robot: Small, options: KernelOptions, folder: Path) -> list[Check]:
    """Compare kernels with verify's oracles, the functions of motors too; each has one that compares it.

    Of several springs those kernels are compared that a robot with one spring does not have.
    """
    chain = robot.load(folder)
    known = {kernel.qualified_name for kernel in chain_kernels(chain, KernelOptions())} if options.springs else set()
    table = tuple(k for k in chain_kernels(chain, options) if k.qualified_name not in known - {CLOSE})
    assert table
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    checks = check_oracles(table, options) + check_robot(functions, chain, 2, 5, options, table)
    checks += check_loops(functions, chain, 6, 3, options, table)
    assert {check.kernel.partition(",")[0] for check in checks} >= set(functions)
    return [check for check in checks if not check.passed]


@pytest.mark.parametrize(("robot", "springs"), cases(TREES, MARKS))
def test_kernels_of_trees(robot: str, springs: KernelOptions, tmp_path) -> None:
    assert failed_checks(TREES[robot], springs, tmp_path) == []


@pytest.mark.parametrize(("robot", "springs"), cases(LINKAGES, MARKS))
def test_kernels_of_linkages(robot: str, springs: KernelOptions, tmp_path) -> None:
    """Functions of the motors at tips on crank, coupler and rocker; of the open tree, whose paths are as short."""
    chain = LINKAGES[robot].load(tmp_path)
    assert {len(chain.branch(tip).joints) for tip in chain.tips} <= {1, 2}
    assert failed_checks(LINKAGES[robot], springs, tmp_path) == []


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
