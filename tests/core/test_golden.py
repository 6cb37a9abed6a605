# SPDX-License-Identifier: MIT
"""Values against the 80-digit golden file: CasADi functions, the compiled Python module, and a C program."""

from __future__ import annotations

import numpy as np
import pytest

from stiffgen.core.symbolic.connection import REPRESENTATIONS
from support.c_program import run_kernels
from support.project import assert_close, compilers

GOLDEN_KEYS = ("jacobian", "kinematic_stiffness", "connection_correction", "joint_stiffness")


def arguments(name, sample):
    """Return the arguments of a function at a golden sample."""
    return {
        "forward_kinematics": (sample.q,),
        "jacobian": (sample.q,),
        "jacobian_transpose_derivative": (sample.q,),
        "kinematic_stiffness": (sample.q, sample.wrench),
        "connection_correction": (sample.wrench,),
        "joint_stiffness": (sample.q, sample.wrench, sample.task_stiffness),
        "joint_stiffness_uncorrected": (sample.q, sample.wrench, sample.task_stiffness),
    }[name]


def reference(rep, name, sample):
    """Return the golden value of a function; the uncorrected stiffness is J^T K J plus the kinematic one."""
    golden = sample.by[rep]
    if name == "connection_correction":
        return golden["gamma_F"]
    if name == "joint_stiffness_uncorrected":
        J = golden["jacobian"]
        return golden["kinematic_stiffness"] + J.T @ sample.task_stiffness @ J
    return golden[name]


@pytest.mark.parametrize("rep", REPRESENTATIONS)
@pytest.mark.parametrize("name", [*GOLDEN_KEYS, "joint_stiffness_uncorrected"])
@pytest.mark.parametrize("implementation", ["casadi", "compiled"])
def test_kernel(implementation, rep, name, golden, model, robot):
    owner = getattr(model if implementation == "casadi" else robot, rep)
    for sample in golden:
        assert_close(getattr(owner, name)(*arguments(name, sample)), reference(rep, name, sample))


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_derivative_contracts_to_kinematic_stiffness(rep, golden, robot):
    for sample in golden:
        derivative = getattr(robot, rep).jacobian_transpose_derivative(sample.q)
        contracted = np.einsum("ibk,k->bi", derivative, sample.wrench)
        assert_close(contracted, sample.by[rep]["kinematic_stiffness"])


def test_pose(golden, model, robot):
    for sample in golden:
        assert_close(model.forward_kinematics(sample.q), sample.pose)
        assert_close(robot.forward_kinematics(sample.q), sample.pose)


def test_joint_hessian_of_the_golden_potential(golden, model, robot):
    """Compare the joint stiffness with the Hessian of a potential, in body and in hybrid form."""
    for sample in golden:
        potential = sample.potential
        data = potential["wrench_body"], potential["covariant_hessian_body"]
        assert_close(model.body.joint_stiffness(sample.q, *data), potential["joint_hessian"])
        assert_close(robot.body.joint_stiffness(sample.q, *data), potential["joint_hessian"])
        turn = np.kron(np.eye(2), sample.pose[:3, :3])
        hybrid = robot.hybrid.joint_stiffness(sample.q, turn @ data[0], turn @ data[1] @ turn.T)
        assert_close(hybrid, potential["joint_hessian"])


@pytest.mark.parametrize("compiler", compilers())
@pytest.mark.parametrize(
    ("language", "optimisation"),
    [
        pytest.param(*case, marks=() if case in (("c99", "-O2"), ("c++11", "-O0")) else pytest.mark.wide)
        for case in (("c99", "-O0"), ("c99", "-O2"), ("c99", "-O3"), ("c++11", "-O0"), ("c++11", "-O3"))
    ],
)
def test_c_program(compiler, language, optimisation, golden, robot_folder, compiled, tmp_path):
    """Compile a C program with each compiler, language and optimisation: golden values, up to rounding."""
    calls, expected = [], []
    for sample in golden:
        calls.append(("forward_kinematics", arguments("forward_kinematics", sample), 16))
        expected.append(sample.pose)
        for rep in REPRESENTATIONS:
            for name in (*GOLDEN_KEYS, "joint_stiffness_uncorrected"):
                value = reference(rep, name, sample)
                calls.append((f"{rep}_{name}", arguments(name, sample), value.size))
                expected.append(value)
    kernels = compiled(compiler, language, optimisation)
    found = run_kernels(robot_folder, "iiwa14", calls, compiler, language, [optimisation], tmp_path, kernels)
    for value, wanted in zip(found, expected, strict=True):
        assert_close(value.reshape(wanted.shape), wanted)
