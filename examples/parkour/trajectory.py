# SPDX-License-Identifier: MIT
"""Provide the parkour's trajectories: as recorded, as replayed 20 mm lower, and the shift made anew."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from examples.experiments.motion import SAMPLE_TIME, SMOOTHING, Motion, approach_and_follow, damped_inverse

Array = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
RECORDED = FOLDER / "recorded_trajectory.csv"
ZERO_FORCE = FOLDER / "zero_force_trajectory.csv"
DEPTH = 0.020
"""[m] by which the replayed trajectory lies below the recorded one. The paper's script says 0.040 m."""
IK_DAMPING = 1e-4
"""k of the damped pseudo-inverse."""
LIFT_OFF = 20.0
"""[s] after which the recorded arm leaves the board."""
LEVEL = ((0.0, 1.5), (4.2, 6.3), (8.0, 15.0), (17.6, 20.0))
"""[s] from when to when the tool slides on the board between the obstacles."""


def recorded() -> Array:
    """Return the trajectory of the guided arm (4120, 7) [rad], SAMPLE_TIME apart."""
    return np.loadtxt(RECORDED, delimiter=",").T


def zero_force() -> Array:
    """Return the replayed trajectory (4120, 7) [rad], SAMPLE_TIME apart."""
    return np.loadtxt(ZERO_FORCE, delimiter=",").T


START: Array = np.array([0.3281, 1.2877, 0.2606, -1.5779, 0.1252, 0.1477, 0.3181])
"""Start configuration [rad]: 4 cm above the first recorded sample, with its orientation."""


def motion(sample_time: float) -> Motion:
    """Return the whole trial: the approach, then the replayed trajectory, at any sample time [s]."""
    return approach_and_follow(zero_force(), START, sample_time)


def shifted(robot: ModuleType, q: Array, depth: float) -> Array:
    """Move configurations down at the same orientation: one step of the damped pseudo-inverse each, then smooth.

    Args:
        robot: generated module.
        q: configurations (N, 7) [rad].
        depth: [m].

    """
    down = np.array([0.0, 0.0, -depth, 0.0, 0.0, 0.0])
    steps = damped_inverse(np.asarray(robot.hybrid.jacobian(q)), robot.mass_matrix(q), IK_DAMPING) @ down
    return np.asarray(savgol_filter(q + steps, **SMOOTHING))


@dataclass(frozen=True)
class Shift:
    """Comparison of the replayed trajectory with the recorded one, and with one that :func:`shifted` makes.

    Attributes:
        mean, deviation: of the replayed tool point less the recorded one (3,), standard deviation (3,) [m].
        position, orientation: largest distance of the tool points [m] and angle between the tools [rad], remade to
            replayed.
        joints: largest differences of the joints (7,) [rad], remade to replayed.

    """

    mean: Array
    deviation: Array
    position: float
    orientation: float
    joints: Array


def compare(robot: ModuleType) -> Shift:
    """Measure the shift of the replayed trajectory and make it anew from the recording."""
    before, after = recorded(), zero_force()
    made = shifted(robot, before, DEPTH)
    recorded_poses, replayed, remade = (robot.forward_kinematics(each) for each in (before, after, made))
    moved = replayed[:, :3, 3] - recorded_poses[:, :3, 3]
    turns = Rotation.from_matrix(remade[:, :3, :3] @ replayed[:, :3, :3].transpose(0, 2, 1)).magnitude()
    return Shift(
        mean=moved.mean(axis=0),
        deviation=moved.std(axis=0),
        position=float(np.linalg.norm(remade[:, :3, 3] - replayed[:, :3, 3], axis=1).max()),
        orientation=float(turns.max()),
        joints=np.abs(made - after).max(axis=0),
    )


def flatness(poses: Array, distance: float) -> float:
    """Return the standard deviation [m] of the height of a point on the tool's axis while it slides between obstacles.

    Args:
        poses: recorded poses of the flange (N, 4, 4) [m].
        distance: of the point from the flange [m].

    """
    time = SAMPLE_TIME * np.arange(len(poses))
    level = np.any([(time >= start) & (time <= end) for start, end in LEVEL], axis=0)
    return float((poses[level, 2, 3] + distance * poses[level, 2, 2]).std())
