# SPDX-License-Identifier: MIT
"""Sessions of the controller in a program that floating-point exceptions end: none is raised."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from stiffgen import generate
from support.controller_library import compile_c
from support.project import ROOT, Once

SESSIONS = (
    "start", "poses", "zero", "lost", "clock", "press", "refused", "policy", "paper", "self-check",
)  # fmt: skip
PARTS = ("", "_impedance", "_follow", "_policy", "_paper")
URDFS = {"iiwa14": ROOT / "urdf" / "iiwa14.urdf", "scara": ROOT / "tests" / "data" / "scara.urdf"}


def build_program(name: str, output: Path) -> Path:
    """Compile the sessions with a robot's C files."""
    folder = generate(URDFS[name], output=output, build=False)
    headers = [f"-include{name}{part}.h" for part in PARTS]
    names = [f"-DROBOT(x)={name}_##x", f"-DUPPER(x)={name.upper()}_##x", "-D_GNU_SOURCE", f"-I{folder}"]
    sources = [ROOT / "tests" / "support" / "trapped_session.c"]
    sources += [folder / f"{name}{part}.c" for part in PARTS]
    return compile_c(output / "sessions", "-std=c99", "-O1", *names, *headers, *sources, "-lm")


@pytest.mark.slow
@pytest.mark.parametrize("name", URDFS)
def test_nothing_is_raised(once: Once, name: str) -> None:
    """Run with floating-point traps: none is raised. Before: 0/0 in the first step ended the program."""
    program = once(f"trapped-{name}", lambda folder: build_program(name, folder)) / "sessions"
    for session in SESSIONS:
        done = subprocess.run([program, session], capture_output=True, text=True, check=False)
        assert done.returncode == 0, (session, done.returncode)
        assert "done" in done.stdout, session
        if session == "self-check":
            assert done.stdout.startswith("0 ")


def test_the_header_says_what_nan_raises() -> None:
    """Both self-checks hand over NaN and infinity on purpose, and must run before traps are on."""
    header = " ".join((ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h").read_text().replace(" * ", " ").split())
    assert "raise no floating-point exception but inexact and underflow" in header
    assert "self-checks" in header
