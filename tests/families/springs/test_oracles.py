# SPDX-License-Identifier: MIT
"""Every kernel has an oracle, or a failed check says that it has none; what is not compared is said to be so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.core.lower.scalar import DOUBLE
from stiffgen.core.opened import open_robot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import KERNELS, chain_kernels
from stiffgen.core.verify.kernels import batches
from stiffgen.core.verify.kernels.batches import LONG, check_stacks
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.not_finite import check_not_finite
from stiffgen.core.verify.kernels.oracles import check_kernels, check_oracles
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import NO_ORACLE, Check, as_results, compared
from stiffgen.families.rounding.certified import check_certified_bounds
from support.chains import chain_urdf
from support.project import ROOT

DATA = ROOT / "tests" / "data"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    urdf = tmp_path_factory.mktemp("oracles") / "chain.urdf"
    urdf.write_text(chain_urdf("rpr"))
    return stiffgen.load_chain(urdf)


@pytest.mark.parametrize("case", ["one tip", "two tips", "floating base, tool at run time"])
def test_every_kernel_has_an_oracle(case: str) -> None:
    """Look up an oracle for each kernel, springs, totals and VJPs included."""
    options = KernelOptions(springs=KINDS, derivatives=True)
    tips = {"tip": ["left hand", "right-hand"]} if case == "two tips" else {"tip": "left hand"}
    moved = {"floating_base": True, "runtime_tool": True} if case.startswith("floating") else {}
    chain = stiffgen.load_chain(DATA / "dual_arm.urdf", **tips, **moved)
    assert check_oracles(chain_kernels(chain, options), options) == []


def test_a_kernel_without_an_oracle_is_a_failed_check() -> None:
    """Add a kernel without an oracle: a failed check. Before, verify passed it."""
    unknown = replace(KERNELS[0], name="tip_height")
    (check,) = check_oracles((*KERNELS, unknown))
    assert not check.passed and check.kernel == "tip_height" and 'ORACLES["tip_height"]' in check.detail
    (product,) = check_oracles((*KERNELS, replace(unknown, name="a_vjp", product_of="a")))
    assert product.kernel == "a_vjp", "the kernel of which it is a product is not there"
    assert check.oracle == NO_ORACLE


def functions_of(chain: Chain) -> dict[str, Any]:
    return {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in chain_kernels(chain)}


def test_each_kernel_is_found_wrong_by_its_own_oracle(small: Chain) -> None:
    """Multiply one result after the other by 1 + 1e-9: a row of the kernel fails."""
    references, functions = References(small, 4, 0), functions_of(small)
    assert [check for check in check_kernels(functions, references) if not check.passed] == []
    missed = []
    for kernel in chain_kernels(small):
        right = functions[kernel.qualified_name]

        def wrong(*given: Any, right: Any = right) -> Any:
            results = tuple(each * (1 + 1e-9) for each in as_results(right(*given)))
            return results if len(results) > 1 else results[0]

        checks = check_kernels(functions | {kernel.qualified_name: wrong}, references, [kernel])
        if all(check.passed for check in checks):
            missed.append(kernel.qualified_name)
    assert missed == []


def test_a_reference_that_is_nan_is_said_to_be_nan() -> None:
    """Compare with NaN on one side: a fault that names the side, and not a pass."""
    right = np.arange(6.0).reshape(2, 3)
    spoiled = np.array(right)
    spoiled[1, 2] = np.nan
    check = compared("f", "oracle", right, spoiled)
    assert not check.passed and "the reference is NaN in 1 of 2 states" in check.detail
    check = compared("f", "oracle", spoiled, right)
    assert not check.passed and "the result is NaN in 1 of 2 states" in check.detail
    assert compared("f", "oracle", right, right).detail == ""


def _one(chain: Chain, name: str) -> Any:
    return next(kernel for kernel in chain_kernels(chain) if kernel.qualified_name == name)


def test_values_that_are_all_nan_do_not_reach_another_configuration(small: Chain) -> None:
    """Compare results that are all NaN: not blamed on another configuration, as before."""
    kernel, pool = _one(small, "forward_kinematics"), argument_samples(small, LONG, 0)

    def nowhere(q: np.ndarray) -> np.ndarray:
        return np.full((*q.shape[:-1], 4, 4), np.nan)

    check = check_not_finite({kernel.qualified_name: nowhere}, (kernel,), pool)[0]
    assert not check.passed and check.detail.startswith("no random arguments give a finite result")
    right = function_of_stacks(small, kernel)

    def mostly(q: np.ndarray) -> np.ndarray:
        """Return NaN for one configuration of the pool, as a kernel that refuses it does."""
        poses = np.array(right(np.atleast_2d(q))) if q.size else np.zeros((0, 4, 4))
        poses[~np.isfinite(poses)] = np.nan
        poses[(np.atleast_2d(q) == pool[kernel.arguments[0]][0]).all(axis=1)] = np.nan
        return poses if q.ndim > 1 else poses[0]

    check = check_not_finite({kernel.qualified_name: mostly}, (kernel,), pool)[0]
    assert check.passed, check.detail

    def stacks(q: np.ndarray, out: Any = None) -> np.ndarray:
        if out is not None:
            out[0][...] = mostly(q)
        return mostly(q)

    single = {kernel.qualified_name: mostly}
    (check, *_) = check_stacks({kernel.qualified_name: stacks}, single, (replace(kernel, batch=False),), small, pool)
    assert check.passed, check.detail


def test_a_wrong_batch_has_its_rounding_analysed_once_per_layout(small: Chain, monkeypatch: Any) -> None:
    """Verify a wrong batch: rounding is analysed once per layout. Before, 11 minutes and no end."""
    kernel, pool = _one(small, "hybrid_joint_stiffness"), argument_samples(small, LONG, 0)
    analysed = []
    errors = batches.rounding_errors

    def counted(*given: Any, **options: Any) -> Any:
        analysed.append(1)
        return errors(*given, **options)

    class Wrong:
        """Library whose batch writes nothing."""

        def __getitem__(self, name: str) -> Any:
            return lambda *given: None

    monkeypatch.setattr(batches, "rounding_errors", counted)
    single = {kernel.qualified_name: function_of_stacks(small, kernel)}
    checks = batches.check_c_batches({"a": Wrong(), "b": Wrong()}, "chain", single, (kernel,), small, pool, DOUBLE)  # type: ignore[dict-item]
    assert [check.passed for check in checks] == [False, False]
    layouts = 3 + len(kernel.arguments)
    assert len(analysed) == layouts * len(kernel.batches)


def test_a_function_without_a_certified_bound_has_a_row_with_the_reason() -> None:
    """Verify functions without a rounding bound: a row that states why there is none."""
    robot = open_robot(ROOT / "generated" / "iiwa14")
    rounding, pool = robot.manifest["rounding"], argument_samples(robot.chain, 2, 0)
    table = [kernel for kernel in robot.table if kernel.qualified_name in ("posture_energy", "manipulability")]
    rows = check_certified_bounds([], table, robot.chain, robot.scalar, rounding, rounding, pool)
    reasons = {check.kernel: check.oracle for check in rows}
    assert all(isinstance(check, Check) and check.passed for check in rows)
    assert reasons["posture_energy"].endswith("no certified bound: no range is known of the argument posture")
    assert "the operation " in reasons["manipulability"]
