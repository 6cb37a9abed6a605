# SPDX-License-Identifier: MIT
"""The section on threads: its code runs as it stands, with fewer configurations, and gives what one call gives."""

from __future__ import annotations

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from support.project import ROOT

PAGE = (ROOT / "docs" / "performance.md").read_text()


@pytest.mark.slow
def test_code_of_the_page(robot, monkeypatch):
    """Run the code of docs/threads.md with fewer rows: the results of one call."""
    monkeypatch.setitem(sys.modules, "generated", SimpleNamespace(iiwa14=robot))
    code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
    assert "COUNT = 10_000_000" in code
    names = {}
    exec(code.replace("COUNT = 10_000_000", "COUNT = 300_001"), names)  # the page's own text
    arm, q, wrench, K = names["iiwa14"], names["q"], names["wrench"], names["task_stiffness"]
    at_once = arm.hybrid.joint_stiffness(q, wrench, K)
    np.testing.assert_array_equal(names["traces"], at_once.trace(axis1=1, axis2=2))
    np.testing.assert_array_equal(names["diagonals"], np.diagonal(at_once, axis1=1, axis2=2))
    np.testing.assert_array_equal(names["matrix"], at_once[0])
    np.testing.assert_allclose(names["mean"], at_once.mean(axis=0), rtol=1e-9, atol=1e-9)
    for threads in (1, 3):
        out = np.full((len(q), 7, 7), np.nan)
        names["in_threads"](arm.hybrid.joint_stiffness, out, (q, wrench), (K,), threads)
        np.testing.assert_array_equal(out, at_once)
