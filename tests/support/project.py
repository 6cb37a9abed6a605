"""Where the project lies, its compilers, and when two arrays agree."""

from __future__ import annotations

import os
import shutil
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
