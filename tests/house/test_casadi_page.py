# SPDX-License-Identifier: MIT
"""The code of docs/derivatives.md: IPOPT takes the compiled functions and comes nearer to the wanted stiffness."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.pages import blocks
from support.project import ROOT

BEFORE = """
import numpy as np

wrench, task_stiffness = np.array([5.0, -10, 15, 4, -3, 8]), np.diag([700.0, 700, 800, 30, 30, 30])
wanted = 20 * np.eye(7)
"""
AFTER = """
limited = {"hessian_approximation": "limited-memory", "max_iter": 10, "print_level": 0, "sb": "yes"}
opti.solver("ipopt", {"print_time": False}, limited)
opti.set_initial(q, 0.3)
try:
    opti.solve()
except RuntimeError as stopped:  # by the ten iterations
    assert "Maximum_Iterations_Exceeded" in str(stopped), stopped
near = ca.sumsqr(iiwa14.hybrid.joint_stiffness(opti.debug.value(q), wrench, task_stiffness) - wanted)
far = ca.sumsqr(iiwa14.hybrid.joint_stiffness(np.full(7, 0.3), wrench, task_stiffness) - wanted)
assert near < far, (near, far)
"""


@pytest.mark.slow
def test_code_of_the_page(derived: Path, tmp_path: Path) -> None:
    page = ROOT / "docs" / "derivatives.md"
    (code,) = (block.code for block in blocks(page) if "ca.Opti()" in block.code)
    (tmp_path / "generated").symlink_to(derived.parent)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(tmp_path)])}
    subprocess.run([sys.executable, "-c", BEFORE + code + AFTER], cwd=tmp_path, env=environment, check=True)
