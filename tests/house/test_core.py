# SPDX-License-Identifier: MIT
"""A unit test runs with the packages of the extra ``test-core`` alone."""

from __future__ import annotations

import subprocess
import sys

import pytest

from support.project import ROOT

ABSENT = (
    "cmake", "dask", "flint", "google", "hypothesis", "jax", "matplotlib", "mujoco", "ninja", "pinocchio", "scipy",
)  # fmt: skip
"""Packages of the extra ``test`` that the conftest and the unit tests of kernels go without."""

RUN = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named '{{name}}'", name=name)

sys.meta_path.insert(0, Absent())
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest", *sys.argv[1:]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["graph", "spots", "choices"])
def test_unit_tests_need_no_more_than_the_core(name: str) -> None:
    command = [sys.executable, "-c", RUN, "-m", "not slow", f"tests/core/test_{name}.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
