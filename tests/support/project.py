# SPDX-License-Identifier: MIT
"""Find the project and its compilers; compare arrays."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.core.opened import functions_of
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.result import BOUND, relative_error

ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "urdf" / "iiwa14.urdf"


def files_of_tests(pattern: str = "test_*.py") -> list[Path]:
    """Return the files of tests of that name, of the package and of the rooms around it."""
    return [file for room in ("tests", "fri", "ros2") for file in sorted((ROOT / room).rglob(pattern))]


Once = Callable[[str, Callable[[Path], object]], Path]
"""The fixture ``once``: a folder of that name, filled by the function in the first worker that asks for it."""


Compiled = Callable[[str, str, str], Path]
"""The fixture ``compiled``: the iiwa 14's object file of a compiler, a language and a level of optimisation."""


def assert_close(value: Any, expected: Any) -> None:
    """Assert that two arrays agree to 1e-12 of the largest expected entry."""
    error = relative_error(np.asarray(value)[None], np.asarray(expected)[None])
    assert error <= BOUND, f"relative error {error:.2e}"


def kernels_of(module: ModuleType, chain: stiffgen.Chain) -> dict[str, Callable[..., Any]]:
    """Return the functions of an imported robot by qualified name, for a chain other than its folder's, too."""
    return functions_of(module, chain_kernels(chain), Path(str(module.__file__)).parent)


def compilers() -> list[str]:
    """Return gcc and clang. On CI both must be there; elsewhere a test of a missing one is skipped."""
    return ["gcc", "clang"]


def require_program(name: str, package: str) -> str:
    """Return the path of a program of a Debian package; skip where it is missing, fail on CI."""
    found = shutil.which(name)
    if found is None:
        if os.environ.get("CI"):
            pytest.fail(f"{name} is missing; .ci/run installs it")
        pytest.skip(f"{name} is not installed (Debian: apt-get install {package})")
    return found


def require_compiler(name: str) -> str:
    return require_program(name, name)


def require_32_bits(compiler: str) -> None:
    """Skip, or fail on CI, where 32-bit x86 programs cannot be built."""
    program = "#include <math.h>\nint main(void) { return 0; }\n"
    command = [compiler, "-m32", "-x", "c", "-", "-o", os.devnull, "-lm"]
    if subprocess.run(command, input=program, capture_output=True, text=True, check=False).returncode != 0:
        if os.environ.get("CI"):
            pytest.fail(f"{compiler} -m32 does not work; .ci/run installs gcc-12-multilib or the like")
        pytest.skip("no 32-bit x86 (Debian: apt-get install gcc-$(gcc -dumpversion)-multilib)")
