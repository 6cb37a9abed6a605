# SPDX-License-Identifier: MIT
"""Forty joints with nothing aligned: the size of the C source, and its values."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

import stiffgen
from benchmarks.generation import long_chain
from stiffgen import open_robot
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.formulas import check_against_casadi
from stiffgen.core.verify.kernels.samples import argument_samples
from support.c_program import STRICT
from support.project import kernels_of

pytestmark = pytest.mark.wide(instead="tests/core/test_chain.py::test_forty_joints_are_generated_in_size")


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
    chain = stiffgen.load_chain(folder.parent.parent / "chain.urdf")
    robot = open_robot(folder).module
    checks = check_against_casadi(kernels_of(robot, chain), chain, 2, 0)
    assert [check for check in checks if not check.passed] == []
    pool = argument_samples(chain, 3, 1)
    for kernel in chain_kernels(chain):
        if kernel.name == "joint_stiffness":
            Kq = kernels_of(robot, chain)[kernel.qualified_name](*(pool[a] for a in kernel.arguments))
            assert np.array_equal(Kq, Kq.transpose(0, 2, 1))
