# SPDX-License-Identifier: MIT
"""The check of every CUDA launch function (``make campaign NAME=cuda``), compiled for the host, finds what is wrong."""

from __future__ import annotations

import re

import pytest

import stiffgen
from stiffgen.core.options import GenerationOptions
from support.chains import chain_urdf
from support.cuda_device import DeviceCheck
from support.project import require_compiler

FAULTS = {
    "sign": (r"(hybrid_joint_stiffness_thread\((?:.|\n)*?) - ", r"\1 + ", "joint_stiffness of configuration 0 differs"),
    "entry not written": (
        r"(void store\((?:.|\n)*?k = )0;",
        r"\g<1>1;",
        "jacobian 0 of configuration 0 is not written",
    ),
    "row not written": (
        r"(int j = i); j < n",
        r"\1; j + 1 < n",
        "joint_stiffness 1 of configuration 0 is not written",
    ),
    "one configuration too many": (r"c < count; c", "c < count + 1; c", "of configuration 40 is written, beyond"),
    "infinity passes": (r"return x \+ 0.0 \* x;", "return x;", "is infinite"),
    "short strides pass": (r"if \(stride < count\)", "if (stride + 1 < count)", "a stride below the count is accepted"),
    "one stiffness for all": (
        r"load\(task_stiffness \+ \(task_stiffness_stride \? c : 0\)",
        "load(task_stiffness + 0",
        "joint_stiffness 0 of configuration 9 is a number, in C NaN",
    ),
}
KERNELS = ("hybrid.jacobian", "hybrid.joint_stiffness")


@pytest.fixture(scope="module")
def check(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    urdf = folder / "arm.urdf"
    urdf.write_text(chain_urdf("rp"))
    options = GenerationOptions(cuda=True, kernels=KERNELS, controller=False, masses=False)
    return DeviceCheck(stiffgen.load_chain(urdf), "arm", options, folder, 40)


def said_by(check, *words):
    program = check.compile([require_compiler("g++"), "-std=c++17"], ["-O0"])
    return check.run(program, *words)


def test_every_launch_function_is_right(check):
    done = said_by(check, 100)
    assert done.returncode == 0, done.stdout + done.stderr
    names = re.findall(r"^  (\w+) +\d\.\de", done.stdout, re.MULTILINE)
    declared = re.findall(r"arm_(\w+)_cuda\(", (check.folder / "arm_cuda.h").read_text())
    assert names == declared and "hybrid_joint_stiffness_each" in names
    assert "3 launch functions, 7 launches of 40 configurations (one of 100), 0 wrong" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found(fault, check):
    """Seed a fault in the CUDA code: the check program says WRONG and where."""
    pattern, text, message = FAULTS[fault]
    source = check.folder / "arm.cu"
    right = source.read_text()
    broken, count = re.subn(pattern, text, right, count=0 if fault == "one configuration too many" else 1)
    assert count > 0
    source.write_text(broken)
    try:
        done = said_by(check)
    finally:
        source.write_text(right)
    assert done.returncode == 1 and "WRONG" in done.stdout
    assert message in done.stdout, done.stdout


def test_a_launch_function_that_is_not_in_the_table_is_found(check, monkeypatch):
    monkeypatch.setattr(DeviceCheck, "_launches", lambda self: iter(()))
    options = GenerationOptions(cuda=True, kernels=KERNELS, controller=False, masses=False)
    with pytest.raises(ValueError, match="declares other launch functions"):
        DeviceCheck(check.chain, "arm", options, check.folder, 5)
