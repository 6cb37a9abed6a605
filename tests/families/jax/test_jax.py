# SPDX-License-Identifier: MIT
"""NAME.jax, in a process of its own: JAX has threads, and other tests fork."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from support.project import ROOT
from support.wrappers import small_robot


@pytest.mark.parametrize(
    "chosen", [pytest.param("not wide", marks=pytest.mark.slow), pytest.param("wide", marks=pytest.mark.wide)]
)
def test_wrapper_for_jax(chosen, tmp_path):
    """Run the tests of tests/campaigns/jax_wrapper.py, those of CI or the others."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # their search reads every package's metadata, for a second
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "own")]
    done = subprocess.run(
        [*command, "-m", chosen, "tests/campaigns/jax_wrapper.py"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_generating_does_not_load_jax(tmp_path):
    """Its headers are found without it: what generates a folder may fork afterwards."""
    assert (small_robot(tmp_path, "r", "hybrid.jacobian").folder / "python" / "arm_jax.so").exists()
    assert "jax" not in sys.modules
