# SPDX-License-Identifier: MIT
"""The example that learns a stiffness and a tool from a recording."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import stiffgen
from examples.identify import __main__ as program
from examples.identify.recording import UPPER, certainty, pose_of, record, residuals
from stiffgen import open_robot
from support.pictures import difference
from support.project import ROOT, URDF

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return stiffgen.generate(
        URDF, name="iiwa14_tool", runtime_tool=True, masses=False, output=tmp_path_factory.mktemp("robots"),
        derivatives=True,
    )  # fmt: skip


def test_finds_what_can_be_found(folder, tmp_path):
    """All 21 entries within 2 % where the pushes turn the tool; without turning, all but those of rotation alone."""
    figure = tmp_path / "figure.svg"
    command = [sys.executable, "-m", "examples.identify", "jax", "--robot", str(folder), "--figure", str(figure)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "entries of K identifiable: 21 of 21" in done.stdout
    assert "entries of K identifiable: 15 of 21" in done.stdout
    assert difference(figure.read_text(), (ROOT / "docs" / "identify.svg").read_text(), within=1.0) == ""


def test_noise_is_what_the_loss_takes_it_for(folder):
    """At the truth the torque left over has the stated covariance, and no systematic part."""
    robot = open_robot(folder).module
    for turning in program.KINDS:
        recording = record(robot, 2000, 0.01, turning=turning, seed=4)
        left, covariance = residuals(robot, recording, recording.task_stiffness[UPPER], recording.tool)
        white = np.linalg.solve(np.linalg.cholesky(covariance), left[:, :, None])[:, :, 0]
        assert np.mean(white**2) == pytest.approx(1, abs=0.04)
        assert np.abs(white.mean(axis=0)).max() < 5 / np.sqrt(2000)


def test_rotation_alone_is_what_pushes_without_turning_leave_open(folder):
    robot = open_robot(folder).module
    recording = record(robot, 500, 0.01, turning=False)
    sure = certainty(robot, recording, recording.task_stiffness, recording.tool)
    part = sure.stiffness / np.abs(recording.task_stiffness)
    open_block = np.zeros((6, 6), dtype=bool)
    open_block[3:, 3:] = True
    assert part[open_block].min() > 5 * part[~open_block].max()
    exact = record(robot, 5, 0.0, turning=False)
    motion = robot.hybrid.jacobian(exact.q, pose_of(exact.tool)) @ exact.deflection[:, :, None]
    assert np.abs(motion[:, 3:]).max() < 1e-12
