# SPDX-License-Identifier: MIT
"""The stiffness that adapts under the tank: its gradient, and that neither learner gets more out than the tank had."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import stiffgen
from examples import adaptive
from stiffgen import open_robot
from support.pictures import difference
from support.project import ROOT, URDF


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of the iiwa 14 with controller, and with what the example calls and its derivatives."""
    return stiffgen.generate(
        URDF,
        name="iiwa14_derivatives",
        output=tmp_path_factory.mktemp("robots"),
        kernels="forward_kinematics,mass_matrix,bias_forces,hybrid.jacobian,hybrid.joint_stiffness",
        derivatives=True,
        batches=False,
    )


@pytest.mark.slow
def test_greed_is_bounded(robot):
    """Run the greedy learner: more than 2 J with a large tank, none beyond a small one."""
    free = adaptive.simulate(robot, adaptive.greedy, adaptive.HUGE, duration=8.0)
    bound = adaptive.simulate(robot, adaptive.greedy, adaptive.TANK, duration=8.0)
    assert free.fault == bound.fault == 0
    assert free.port.max() > adaptive.TANK
    assert bound.port.max() <= adaptive.TANK
    assert bound.tank.min() >= 0
    assert free.port.max() < free.bound
    assert not free.held.any() and bound.held.mean() > 0.05  # it waits for the tank


@pytest.mark.wide(instead="test_greed_is_bounded")
def test_gradient_is_that_of_the_loss(folder):
    """Compare the gradient with respect to log stiffness with central differences (step 1e-5), in 20 states."""
    robot, random = open_robot(folder).module, np.random.default_rng(0)
    for _ in range(20):
        # [rad], [N, N m]
        q, wrench = adaptive.Q0 + random.uniform(-0.3, 0.3, 7), random.normal(size=6) * [20, 20, 20, 2, 2, 2]
        logarithm = np.log(random.uniform(200, 4000, 3))
        _, gradient = adaptive.loss(robot, q, wrench, np.exp(logarithm))
        for i, step in enumerate(1e-5 * np.eye(3)):
            ahead, behind = (adaptive.loss(robot, q, wrench, np.exp(logarithm + s * step))[0] for s in (1, -1))
            assert (ahead - behind) / 2e-5 == pytest.approx(gradient[i], rel=1e-6, abs=1e-6)


@pytest.mark.wide(instead="test_greed_is_bounded")
def test_program(folder, tmp_path):
    """Run the example: figure and table are those of the page, and the tank at least halves the deflection."""
    figure = tmp_path / "figure.svg"
    command = [sys.executable, "-m", "examples.adaptive", "--robot", str(folder), "--figure", str(figure)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = {line[2:24].strip(): line[24:].split() for line in done.stdout.splitlines() if line.startswith("  ")}
    deflection = {name: float(row[0]) for name, row in rows.items()}
    assert deflection["careful, tank 2 J"] < 0.5 * deflection["constant"]
    assert difference(figure.read_text(), (ROOT / "docs" / "adaptive.svg").read_text(), within=1.0) == ""
