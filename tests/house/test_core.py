# SPDX-License-Identifier: MIT
"""A unit test runs with the packages of the extra ``test-core`` alone."""

from __future__ import annotations

import re
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
sys.exit(pytest.main(["-p", "no:cacheprovider", "-p", "no:hypothesispytest", *sys.argv[1:]]))
"""


@pytest.mark.slow
def test_unit_tests_need_no_more_than_the_core() -> None:
    files = [f"tests/core/test_{name}.py" for name in ("graph", "spots", "choices")]
    command = [sys.executable, "-c", RUN, "-v", "-m", "not slow", *files]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    for file in files:
        assert re.search(rf"^{file}::.* PASSED", done.stdout, re.MULTILINE), done.stdout
