# SPDX-License-Identifier: MIT
"""Properties of sensors from a recording at a standstill."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from support.controller_inputs import Q
from support.project import ROOT


def test_sensors_are_estimated_at_a_standstill(tmp_path: Path) -> None:
    """Record a standstill: quantum, noise and resolution come back; motion is refused; the example prints them."""
    random = np.random.default_rng(4)
    q = 1e-4 * np.round((Q + 1e-4 * random.random((3000, 7))) / 1e-4)  # [rad] in steps of 1e-4
    dq = 0.02 * random.normal(size=q.shape)  # [rad/s]
    found = stiffgen.estimate_sensors(q, dq)
    assert found.position_quantum == pytest.approx(1e-4)
    assert found.velocity_noise == pytest.approx(0.02, rel=0.1)
    coarse = stiffgen.estimate_sensors(q, 0.01 * np.round(0.004 * random.normal(size=q.shape) / 0.01))
    assert coarse.velocity_noise == pytest.approx(0.01)
    with pytest.raises(stiffgen.RecordingError, match=r"joint 3 moves by 0\.3 rad"):
        stiffgen.estimate_sensors(q + np.linspace(0, 0.3, 3000)[:, None] * np.eye(7)[3], dq)
    log = tmp_path / "log.csv"
    names = ",".join([*(f"q_{i}" for i in range(7)), *(f"dq_{i}" for i in range(7))])
    np.savetxt(log, np.hstack([q, dq]), delimiter=",", header=names, comments="")
    command = [sys.executable, str(ROOT / "examples" / "sensors.py"), str(log)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "position_quantum=0.0001," in said
    assert "velocity_noise=0.02" in said
