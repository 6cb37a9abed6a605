# SPDX-License-Identifier: MIT
"""Compiler flags that change floating-point arithmetic: right, refused, or found by the self-check. Nothing else.

docs/performance.md sums up what was tried.
"""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from support.c_program import run_kernels
from support.chains import chain_urdf
from support.generated_c import kernel_text
from support.project import URDF, assert_close, require_32_bits, require_compiler

REORDERED = "-fassociative-math -fno-signed-zeros -fno-trapping-math"
REFUSED = [
    ("gcc", "-ffast-math"),
    ("gcc", "-Ofast"),
    ("gcc", "-ffinite-math-only"),
    ("gcc", "-Ofast -fno-finite-math-only"),
    ("gcc", "-funsafe-math-optimizations"),
    ("gcc", REORDERED),
    ("gcc", "-fno-signed-zeros"),
    ("gcc", "-fsingle-precision-constant"),
    ("gcc", "-D_M_FP_FAST"),  # what MSVC defines under /fp:fast
    ("clang", "-ffast-math"),
    ("clang", "-Ofast"),
    ("clang", "-ffinite-math-only"),
]
# A compiler that defines no macro for its flags; -U takes them away here.
BLIND = "-U__ASSOCIATIVE_MATH__ -U__NO_SIGNED_ZEROS__"
FOUND = [
    ("gcc", f"-O2 -fno-signed-zeros {BLIND}", 2),
    ("gcc", f"-O3 {REORDERED} {BLIND}", 2),  # the barriers hold: sines are right, infinities do not become NaN
    ("gcc", f"-O3 {REORDERED} {BLIND} -DNO_BARRIER", 3),
    ("clang", "-O2 -fno-honor-nans -fno-signed-zeros", 2),
    ("clang", "-O2 -fno-honor-nans", 2),  # before: 0, and every torque of the controller was NaN
]
RIGHT = [
    ("gcc", "-O2 -m32"),
    ("gcc", "-O0 -m32"),
    ("gcc", "-O2 -m32 -std=c99"),
    ("gcc", "-O3 -m32 -march=i386"),
    ("gcc", "-O2 -m32 -msse2 -mfpmath=sse"),
    ("gcc", "-O2 -mfpmath=387"),
    ("gcc", "-O2 -frounding-math -fsignaling-nans"),
    ("gcc", "-O3 -march=native -ffp-contract=fast -freciprocal-math -fno-trapping-math -fno-math-errno"),
    ("gcc", "-O3 -march=native -mno-fma"),
    ("clang", "-O2 -m32"),
    ("clang", f"-O2 {REORDERED}"),
    ("clang", "-O3 -funsafe-math-optimizations"),
    ("clang", "-Ofast -fno-finite-math-only"),
    ("clang", "-O3 -march=native -ffp-contract=fast -freciprocal-math -fapprox-func"),
    ("clang", "-O2 -frounding-math"),
]
QUICK = [("gcc", "-O0 -m32"), ("clang", f"-O2 {REORDERED}")]
FURTHER = [
    ("gcc", "-O2 -m32 -std=c99"),
    ("gcc", "-O3 -m32 -march=i386"),
    ("gcc", "-O2 -m32 -msse2 -mfpmath=sse"),
    ("gcc", "-O2 -mfpmath=387"),
    ("gcc", "-O3 -march=native -mno-fma"),
    ("clang", "-O2 -m32"),
    ("clang", "-Ofast -fno-finite-math-only"),
    ("clang", "-O2 -frounding-math"),
]
"""Wide. Of each kind one stays: 32 bits with x87 (its exponents, too), rounding, fused operations, reordered sums."""


def mark_of(build):
    if build in QUICK:
        return ()
    return pytest.mark.wide if build in FURTHER else pytest.mark.slow


def named(build: tuple) -> str:
    return " ".join(map(str, build[:2])).replace(BLIND, "blind")


@pytest.fixture(scope="module")
def folder(once):
    """The iiwa 14 with one function beside sines, cosines and the self-check."""
    few = {"kernels": "hybrid.joint_stiffness", "controller": False, "python": False, "build": False}
    return once("flags", lambda output: stiffgen.generate(URDF, output=output, **few)) / "iiwa14"


def compiled(build: tuple, folder: Path, target: Path) -> subprocess.CompletedProcess[str]:
    """Compile iiwa14.c of a folder to a shared library with one build's compiler and flags."""
    compiler, flags = build[:2]
    command = [
        require_compiler(compiler),
        *flags.split(),
        "-shared",
        "-fPIC",
        str(folder / "iiwa14.c"),
        "-o",
        str(target),
    ]
    return subprocess.run([*command, "-lm"], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("build", REFUSED, ids=named)
def test_refused(build, folder, tmp_path):
    done = compiled(build, folder, tmp_path / "robot.so")
    assert done.returncode != 0
    assert "compile without" in done.stderr or "constants_must_be_doubles" in done.stderr


@pytest.mark.slow  # the build with clang and a small robot, below, finds the same
@pytest.mark.parametrize("build", FOUND, ids=named)
def test_found_by_the_self_check(build, folder, tmp_path):
    """Compile with flags that break the arithmetic: the self-check returns the number of the broken property."""
    text = kernel_text(folder, "iiwa14")
    if "NO_BARRIER" in build[1]:  # the code as it would be without what makes it independent of the order of sums
        text = text.replace("__asm__", "(void)").replace('(void)("" : "+x"(x))', "(void)0")
        text = text.replace("halved.bits = turns.bits - 0x0010000000000000ULL;", "halved.number = 0.5 * turns.number;")
    (tmp_path / "iiwa14.c").write_text(text)
    (tmp_path / "iiwa14.h").write_text((folder / "iiwa14.h").read_text())
    done = compiled(build, tmp_path, tmp_path / "robot.so")
    assert done.returncode == 0, done.stderr
    assert ctypes.CDLL(str(tmp_path / "robot.so")).iiwa14_self_check() == build[2]


@pytest.mark.parametrize(
    "build",
    [pytest.param(build, marks=mark_of(build)) for build in RIGHT],
    ids=[named(build) for build in RIGHT],
)
def test_right(build, folder, golden, tmp_path):
    """Golden values, NaN for infinity, and the self-check agrees."""
    compiler, flags = build
    if "-m32" in flags:
        require_32_bits(require_compiler(compiler))
    arguments = [(s.q, s.wrench, s.task_stiffness) for s in golden]
    calls = [("hybrid_joint_stiffness", given, 49) for given in arguments]
    q, wrench, stiffness = arguments[0]
    for value in (np.inf, -np.inf, np.nan):
        calls.append(("hybrid_joint_stiffness", (np.where(np.arange(7) == 2, value, q), wrench, stiffness), 49))
        calls.append(("hybrid_joint_stiffness", (q, np.where(np.arange(6) == 3, value, wrench), stiffness), 49))
    # Too large for a double, not for a register of x87.
    calls.append(("hybrid_joint_stiffness", (q, wrench, np.full((6, 6), 1.7e308)), 49))
    found = run_kernels(folder, "iiwa14", calls, compiler, "gnu99", flags.split(), tmp_path)
    for sample, value in zip(golden, found, strict=False):
        assert_close(value.reshape(7, 7), sample.by["hybrid"]["joint_stiffness"])
    for value in found[len(golden) : -1]:
        assert np.isnan(value).all()
    assert not np.isinf(found[-1]).any()
    assert np.isnan(found[-1]).any()


def test_the_build_runs_the_self_check(tmp_path, monkeypatch):
    """``stiffgen generate`` with a compiler that drops NaN unseen."""
    clang = require_compiler("clang")
    monkeypatch.setenv("CC", f"{clang} -fno-honor-nans -fno-signed-zeros")
    monkeypatch.setenv("CFLAGS", "-O1")  # without optimisation nothing is dropped
    (tmp_path / "one.urdf").write_text(chain_urdf("r"))
    with pytest.raises(stiffgen.BuildError, match=r"change its arithmetic \(self-check 10"):
        stiffgen.generate(tmp_path / "one.urdf", output=tmp_path / "generated", kernels="hybrid", batches=False)
    assert not (tmp_path / "generated").exists()
