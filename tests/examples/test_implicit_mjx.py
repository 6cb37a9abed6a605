# SPDX-License-Identifier: MIT
"""The implicit step in MJX, in a process of its own: JAX has threads, and other tests fork."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from support.project import ROOT


@pytest.mark.wide(instead="tests/examples/test_implicit.py::test_the_callback_solves_the_implicit_step")
@pytest.mark.parametrize("test", ["a_motion_into_a_wall", "the_tangent_stands"])
@pytest.mark.skipif(find_spec("mujoco.mjx") is None, reason="mujoco-mjx is not installed (extra mjx)")
def test_implicit_steps_in_mjx(test: str, tmp_path: Path) -> None:
    """Run the tests of steps_in_mjx.py in a process of their own, one case each."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "own")]
    done = subprocess.run(
        [*command, "-m", "slow", "-k", test, "tests/examples/steps_in_mjx.py"],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout + done.stderr
