"""Where the project lies, its compilers, and when two arrays agree."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from stiffgen.check.verify import BOUND, relative_error

ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "urdf" / "iiwa14.urdf"


def assert_close(value, expected) -> None:
    """Two arrays agree to 1e-12 of the largest entry expected."""
    error = relative_error(np.asarray(value)[None], np.asarray(expected)[None])
    assert error <= BOUND, f"relative error {error:.2e}"


def compilers() -> list[str]:
    """gcc and clang. On CI both must be there; elsewhere a missing one is left out and said so by the test."""
    return ["gcc", "clang"]


def require_compiler(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        if os.environ.get("CI"):
            pytest.fail(f"{name} is missing; .ci/run installs it")
        pytest.skip(f"{name} is not installed (Debian: apt-get install {name})")
    return found


def require_32_bits(compiler: str) -> None:
    """Skip, or fail on CI, where 32-bit x86 programs cannot be built."""
    program = "#include <math.h>\nint main(void) { return 0; }\n"
    command = [compiler, "-m32", "-x", "c", "-", "-o", os.devnull, "-lm"]
    if subprocess.run(command, input=program, capture_output=True, text=True, check=False).returncode != 0:
        if os.environ.get("CI"):
            pytest.fail(f"{compiler} -m32 does not work; .ci/run installs gcc-multilib")
        pytest.skip("no 32-bit x86 (Debian: apt-get install gcc-multilib)")
