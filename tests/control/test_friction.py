# SPDX-License-Identifier: MIT
"""Friction that is fed forward by the reference's velocity, on arms whose joints stick, slip and are elastic."""

from __future__ import annotations

import numpy as np
import pytest

from support.arms.arms import Arm
from support.project import Once

PERIOD = 5000  # [samples] of the line, 0.2 Hz
SPREAD = 1e3  # [mm/m]


@pytest.fixture(scope="module")
def ur5(once: Once) -> Arm:
    folder = once("arms-ur5", lambda folder: Arm("ur5", folder))
    return Arm("ur5", folder)


def rows_of(arm: Arm, share: float, poses: np.ndarray, noisy: bool = True) -> np.ndarray:
    """Return the rows of a motion, with a share of the true sliding friction fed forward."""
    sensors = arm.maker.sensors
    config = arm.config(
        coulomb_friction=share * arm.maker.friction * arm.effort,
        position_quantum=sensors.position_quantum,
        velocity_noise=max(sensors.velocity_noise, sensors.velocity_quantum),
    )
    exact = {} if noisy else {"position_quantum": 0.0, "velocity_quantum": 0.0}
    noise = {} if noisy else {"noise": 0.0}
    rows = arm.run(arm.plant(flexible=True, **exact), len(poses), config, goal=arm.posture, pose=poses, **noise)
    assert not rows["faulted"].any()
    return rows


def line(arm: Arm) -> np.ndarray:
    """Return poses of a tip that goes 10 cm to and fro along y at 0.2 Hz, from rest."""
    time = np.arange(2 * PERIOD) / PERIOD
    poses = np.tile(arm.module.forward_kinematics(arm.posture), (len(time), 1, 1))
    poses[:, 1, 3] += 0.1 * np.minimum(4 * time, 1.0) * np.sin(2 * np.pi * time)
    return poses


def away(rows: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return the tip's distance [mm] from its pose, per sample."""
    return np.asarray(SPREAD * np.linalg.norm(rows["pose"].reshape(-1, 4, 4)[:, :3, 3] - poses[:, :3, 3], axis=1))


@pytest.mark.slow
def test_a_slow_line_has_half_the_error(ur5: Arm) -> None:
    """Move along a line at 0.2 Hz with 90 % of the friction fed forward: at most 0.55 of the error without."""
    poses = line(ur5)
    without, fed = (away(rows_of(ur5, share, poses), poses)[PERIOD:] for share in (0.0, 0.9))
    error, left = (float(np.sqrt(np.mean(each**2))) for each in (without, fed))
    print(f"UR5, 0.2 Hz: {error:.1f} mm without, {left:.1f} mm with 90 %")
    assert left <= 0.55 * error


def creep(arm: Arm, share: float, noisy: bool = True) -> tuple[float, float]:
    """Return how far the tip moves [mm] from 3 to 6 s after a step of 10 cm, and how long its way there is [mm]."""
    poses = np.tile(arm.module.forward_kinematics(arm.posture), (6000, 1, 1))
    poses[:, :3, 3] += [0.0, 0.08, -0.06]
    tips = SPREAD * rows_of(arm, share, poses, noisy)["pose"].reshape(-1, 4, 4)[3000:, :3, 3]
    ways = np.linalg.norm(np.diff(tips[::100], axis=0), axis=1).sum()
    return float(np.linalg.norm(tips - tips[0], axis=1).max()), float(ways)


@pytest.mark.slow
def test_too_much_friction_leaves_the_arm_at_rest(ur5: Arm) -> None:
    """At 150 % of the true friction the tip creeps as it does without, and never turns back: there is no limit cycle.

    The bristles of the simulated friction creep under the springs' force for a minute, whatever is fed forward: the
    noise of dq shakes them, by the damping. Without noise the tip stands still.
    """
    creeps = {share: creep(ur5, share) for share in (0.0, 0.9, 1.5)}
    for share, (moved, way) in creeps.items():
        print(f"UR5, {share:.0%} fed forward: {moved:.2f} mm in 3 s at rest, on a way of {way:.2f} mm")
        assert way <= 1.1 * moved
    assert creeps[1.5][0] <= 1.1 * creeps[0.0][0] + 0.1
    assert creeps[0.9][0] <= 0.6
    assert creep(ur5, 1.5, noisy=False)[0] <= 0.02
