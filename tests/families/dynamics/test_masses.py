# SPDX-License-Identifier: MIT
"""``verify DIR URDF`` reads the masses of the URDF by itself; contributions that cancel are no false alarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_kernels, check_robot
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.core.verify.result import Check, compared
from stiffgen.families.dynamics.masses import check_masses
from stiffgen.families.dynamics.oracles import dynamics
from support.project import ROOT

NAMES = ("mass_matrix", "bias_forces", "gravity_gradient")
BODY = '<link name="{}"><inertial><origin xyz="0.1 0.02 0.2" rpy="0.1 0.2 0.3"/><mass value="{}"/><inertia ixx="0.02" '
BODY += 'iyy="0.03" izz="0.025" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>'
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="0 0.02 0.3" rpy="0.3 0.1 0.2"/>'
JOINT += '<axis xyz="0 1 1"/><limit lower="-1" upper="1" velocity="1" effort="10"/>{}</joint>'
GRIPPER = (
    '<robot name="gripper"><link name="base"/>'
    + "".join(BODY.format(*each) for each in (("palm", 2.0), ("left", 0.5), ("right", 3.0)))
    + JOINT.format("a", "revolute", "base", "palm", "")
    + JOINT.format("l", "prismatic", "palm", "left", "")
    + JOINT.format("r", "prismatic", "palm", "right", '<mimic joint="l" multiplier="-1" offset="0.01"/>')
    + "</robot>"
)


def function(chain: Chain, kernel: Kernel) -> Callable[..., Any]:
    """Return a kernel's CasADi function as one of stacks."""
    formula, shape = casadi_function(chain, kernel), kernel.results[0].array(chain).shape
    folds = [folded(argument.array(chain).shape) for argument in kernel.arguments]

    def call(*stacks: Any) -> Any:
        states = [
            [one.reshape(fold) for one, fold in zip(state, folds, strict=True)] for state in zip(*stacks, strict=True)
        ]
        return np.array([np.array(formula(*state)).reshape(shape) for state in states])

    return call


def checks_of(urdf: Path, kernels_of: Chain, chain: Chain) -> list[Check]:
    table = tuple(kernel for kernel in chain_kernels(chain) if kernel.qualified_name in NAMES)
    kernels = {kernel.qualified_name: function(kernels_of, kernel) for kernel in table}
    return check_masses(kernels, table, chain, urdf, Samples(chain, 5, 0))


@pytest.mark.parametrize("options", [{"tip": "left"}, {"tip": "right"}, {"tip": ["left", "right"]}])
def test_a_parallel_gripper(options: dict[str, Any], tmp_path: Path) -> None:
    """Verify the masses of a parallel gripper, for each tip and for both."""
    urdf = tmp_path / "gripper.urdf"
    urdf.write_text(GRIPPER)
    chain = stiffgen.load_chain(urdf, **options)
    checks = checks_of(urdf, chain, chain)
    assert [check.kernel for check in checks] == list(NAMES)
    assert all(check.passed and check.error < 1e-11 for check in checks)


def test_forces_that_are_zero_are_no_false_alarm(tmp_path: Path) -> None:
    """Turn a body about its centre: bias forces are rounding, and no alarm."""
    urdf = tmp_path / "wheel.urdf"
    urdf.write_text(
        '<robot name="wheel"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    chain, options = stiffgen.load_chain(urdf), KernelOptions()
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in chain_kernels(chain, options)}
    checks = check_robot(functions, chain, 40, 0, options)
    assert "bias_forces" in {check.kernel for check in checks}
    assert [check for check in checks if not check.passed] == []


def test_a_finger_that_does_not_move_is_found(tmp_path: Path) -> None:
    """Take the following finger's mass away: each function of masses must fail."""
    urdf = tmp_path / "gripper.urdf"
    urdf.write_text(GRIPPER)
    chain = stiffgen.load_chain(urdf, tip="left")
    light = chain.joints[-1].body
    still = replace(light, mass=0.0, moment=(0.0, 0.0, 0.0), tensor=(0.0,) * 6)
    wrong = replace(chain, joints=(*chain.joints[:-1], replace(chain.joints[-1], body=still)))
    assert [check.passed for check in checks_of(urdf, wrong, chain)] == [False, False, False]


def test_a_floating_base() -> None:
    urdf = ROOT / "tests" / "data" / "solo12.urdf"
    chain = stiffgen.load_chain(urdf, tip="FL_FOOT", floating_base=True)
    checks = checks_of(urdf, chain, chain)
    assert len(checks) == 3 and all(check.passed and check.error < 1e-11 for check in checks)


ARM = (
    '<robot name="arm"><link name="base"/>{}<link name="tip"/><joint name="j" type="prismatic"><parent link="base"/>'
    '<child link="l"/><origin xyz="0.631 1.039 1.031" rpy="1.818 -0.385 0.544"/><axis xyz="-0.366 -1.425 -0.704"/>'
    '<limit lower="-2" upper="2" velocity="1" effort="10"/></joint><joint name="t" type="fixed"><parent link="l"/>'
    '<child link="tip"/><origin xyz="0.136 -0.915 -0.191" rpy="1.120 0.570 0.572"/></joint></robot>'
)


def test_terms_that_cancel_are_no_false_alarm(tmp_path: Path) -> None:
    """Verify a state whose energy of gravity nearly cancels (1.9e-12 left): no alarm."""
    urdf = tmp_path / "arm.urdf"
    body = BODY.format("l", 1.0).replace("0.1 0.02 0.2", "0.1 0 0").replace(' rpy="0.1 0.2 0.3"', "")
    urdf.write_text(ARM.format(body))
    chain = stiffgen.load_chain(urdf)
    table = [kernel for kernel in chain_kernels(chain) if kernel.of_masses]
    kernels = {kernel.qualified_name: function(chain, kernel) for kernel in table}
    references = References(chain, 200, 1)
    checks = check_kernels(kernels, references, table)
    assert all(check.passed for check in checks)
    (energy,) = (kernel for kernel in table if kernel.qualified_name == "gravity_energy")
    value, reference = function(chain, energy)(*references.samples.of(energy.arguments)), references.of(dynamics)
    plain_check = compared("gravity_energy", "", value, reference["gravity_energy"].reshape(200))
    assert not plain_check.passed, "the rule is needed"


@pytest.mark.parametrize(
    ("text", "masses", "reason"),
    [
        (GRIPPER, False, "without masses"),
        ("<mujoco/>", True, "of another format"),
        ('<robot name="a" xmlns:xacro="x"/>', True, "xacro"),
        ('<robot name="a"><joint name="j" type="planar"/></robot>', True, "type planar"),
    ],
)
def test_masses_that_are_not_compared_have_a_row_with_the_reason(
    text: str, masses: bool, reason: str, tmp_path: Path
) -> None:
    """Verify masses where it is impossible: a row that states the reason, not silence."""
    urdf, file = tmp_path / "gripper.urdf", tmp_path / "other.urdf"
    urdf.write_text(GRIPPER)
    file.write_text(text)
    chain = stiffgen.load_chain(urdf, tip="left", masses=masses)
    (row,) = check_masses({}, (), chain, file, None)
    assert row.passed and reason in row.oracle
