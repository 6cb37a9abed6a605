# SPDX-License-Identifier: MIT
"""Forty joints with nothing aligned: the size of the C source, and its values."""

from __future__ import annotations

import random
import subprocess

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.formulas import check_against_casadi
from stiffgen.core.verify.kernels.samples import argument_samples
from support.c_program import STRICT
from support.project import kernels_of

pytestmark = pytest.mark.wide(instead="tests/core/test_chain.py::test_forty_joints_are_generated_in_size")

LINK = (
    '<link name="l{0}"><inertial><origin xyz="0.01 0.02 0.05" rpy="0.1 0.2 0.3"/><mass value="1.5"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial></link>'
)
JOINT = (
    '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><origin xyz="{2}" rpy="{3}"/>'
    '<axis xyz="{4}"/><limit lower="-3" upper="3" velocity="1" effort="10"/></joint>'
)


def long_chain(joints: int) -> str:
    """Return a URDF with arbitrary origins and axes, the same every time."""
    source = random.Random(1)

    def vector(size: float) -> str:
        return " ".join(f"{source.uniform(-size, size):.6f}" for _ in range(3))

    links = [LINK.format(k) for k in range(joints + 1)]
    connections = [JOINT.format(k, k + 1, vector(0.3), vector(3), vector(1)) for k in range(joints)]
    return f'<robot name="chain">{"".join(links + connections)}</robot>'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    work = tmp_path_factory.mktemp("long")
    urdf = work / "chain.urdf"
    urdf.write_text(long_chain(40))
    return stiffgen.generate(urdf, output=work / "generated")


def test_size_and_warnings(folder, tmp_path):
    source = folder / "chain.c"
    functions = len(chain_kernels(stiffgen.load_chain(folder.parent.parent / "chain.urdf")))
    assert source.stat().st_size < 42_000 * functions
    assert "_batch(" not in (folder / "chain.h").read_text()
    subprocess.run(["gcc", "-std=c99", "-O1", *STRICT, "-c", str(source), "-o", str(tmp_path / "o")], check=True)


def test_values(folder):
    """Compare the compiled functions of a long chain with CasADi's; joint stiffnesses are symmetric to the bit."""
    chain = stiffgen.load_chain(folder.parent.parent / "chain.urdf")
    robot = open_robot(folder).module
    checks = check_against_casadi(kernels_of(robot, chain), chain, 2, 0)
    assert [check for check in checks if not check.passed] == []
    pool = argument_samples(chain, 3, 1)
    for kernel in chain_kernels(chain):
        if kernel.name == "joint_stiffness":
            Kq = kernels_of(robot, chain)[kernel.qualified_name](*(pool[a] for a in kernel.arguments))
            assert np.array_equal(Kq, Kq.transpose(0, 2, 1))
