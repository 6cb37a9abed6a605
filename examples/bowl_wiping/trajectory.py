# SPDX-License-Identifier: MIT
"""Provide the zero-force trajectory: as recorded for the paper, and reconstructed by inverse kinematics.

The tip moves on a half circle in a horizontal plane and back, the tool's x axis along the direction of travel, its z
axis towards the centre and then turned about x, so that the plate leans into the wall of the bowl.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from examples.bowl_wiping.tool import TOOL_POINT
from examples.experiments.motion import (
    SAMPLE_TIME,
    SMOOTHING,
    Motion,
    approach_and_follow,
    damped_inverse,
    minimum_jerk,
)
from examples.experiments.plant import START_POSTURE

Array = NDArray[np.float64]

RECORDED = Path(__file__).resolve().parent / "zero_force_trajectory.csv"
CENTRE_POSTURE: Array = np.array([1.3184, 0.9462, -0.4382, -1.9943, -0.0564, -0.0986, -3.7078])
"""[rad] at which the tip is the circle's centre, as the paper's code has it."""
IK_DAMPING = 0.01
"""k of the damped pseudo-inverse W J^T (J W J^T + k I)^-1, W the inverse mass matrix."""


@dataclass(frozen=True)
class Geometry:
    """A half circle there and back.

    Args:
        radius: of the tip's circle [m].
        turn: of the tool about its x axis, the direction of travel [rad].
        lean: further turns of the tool, about its new y and z axes [rad].
        centre: shift of the circle's centre from the tip at CENTRE_POSTURE [m].
        tip: where the tip is taken along the flange's z axis [m].
        duration: of one way, a minimum-jerk motion of the angle [s].
        lead: how long before the first sample the motion starts [s].

    """

    radius: float
    turn: float
    lean: tuple[float, float] = (0.0, 0.0)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip: float = TOOL_POINT
    duration: float = 7.0
    lead: float = 0.0


STATED = Geometry(radius=0.09, turn=np.radians(-115.0))
"""Geometry of the paper's description, with the duration of the recording."""
MEASURED = Geometry(
    radius=0.1,
    turn=np.radians(-126.49),
    lean=(np.radians(-1.85), np.radians(1.00)),
    centre=(0.1, 0.0, 0.0),
    tip=0.2636 - 0.035,
    lead=0.0424,
)
"""Geometry of the recording, found by fitting a circle through the recorded tip for every place of the tip along the
tool's axis. At 0.2636 m from joint 7 the radius is 0.1000 m, and the tip at CENTRE_POSTURE is not the circle's centre
but its far end, to 0.1 mm in each coordinate."""


def recorded() -> Array:
    """Return the recorded zero-force trajectory (2793, 7) [rad], SAMPLE_TIME apart."""
    return np.loadtxt(RECORDED, delimiter=",").T


def motion(sample_time: float) -> Motion:
    """Return the whole trial: the approach, then the recorded trajectory, at any sample time [s]."""
    return approach_and_follow(recorded(), START_POSTURE, sample_time)


def poses(robot: ModuleType, geometry: Geometry, count: int) -> Array:
    """Return tip poses (count, 4, 4) in the base frame [m], SAMPLE_TIME apart."""
    time = SAMPLE_TIME * np.arange(count) + geometry.lead
    # share [0, 1] of the way over the bowl, and of the way back
    there, back = (minimum_jerk(time / geometry.duration - start) for start in (0, 1))
    angle = np.pi * (there - back)  # [rad], half a circle from rim to rim
    cosine, sine, zero = np.cos(angle), np.sin(angle), np.zeros(count)
    inward = np.stack([-cosine, -sine, zero], axis=1)
    travel = np.stack([-sine, cosine, zero], axis=1)
    # axes as columns: x along the travel, z into the bowl's wall
    frame = np.stack([travel, np.cross(inward, travel), inward], axis=2)
    turn = Rotation.from_euler("xyz", [geometry.turn, *geometry.lean]).as_matrix()
    centre = tip_pose(robot, CENTRE_POSTURE, geometry.tip)[:3, 3] + geometry.centre
    result = np.zeros((count, 4, 4))
    result[:, :3, :3] = frame @ turn
    result[:, :3, 3] = centre - geometry.radius * inward
    result[:, 3, 3] = 1
    return result


def inverse_kinematics(robot: ModuleType, target: Array, q: Array, tip: float, settle: int = 0) -> Array:
    """(N, n) joint trajectory through tip poses (N, 4, 4), one step of the damped pseudo-inverse each, smoothed [rad].

    Args:
        robot: generated module of the arm with its tool.
        target: poses in the base frame.
        q: posture before the first [rad].
        tip: where the tip is taken along the flange's z axis [m].
        settle: steps at the first pose before the trajectory starts.

    """
    result = []
    for pose in np.concatenate([np.repeat(target[:1], settle, axis=0), target]):
        present = tip_pose(robot, q, tip)
        turn = Rotation.from_matrix(pose[:3, :3] @ present[:3, :3].T).as_rotvec()
        error = np.concatenate([pose[:3, 3] - present[:3, 3], turn])
        J = tip_jacobian(robot, q, tip)
        q = q + damped_inverse(J, robot.mass_matrix(q), IK_DAMPING) @ error
        result.append(q)
    return np.asarray(savgol_filter(np.array(result)[settle:], **SMOOTHING))


def tip_pose(robot: ModuleType, q: Array, tip: float) -> Array:
    """Return the pose (4, 4) of the point on the tool's axis that is ``tip`` [m] from the flange."""
    pose = np.array(robot.forward_kinematics(q))
    pose[:3, 3] += (tip - TOOL_POINT) * pose[:3, 2]
    return pose


def tip_jacobian(robot: ModuleType, q: Array, tip: float) -> Array:
    """Return the hybrid Jacobian (6, n) of that point."""
    J = np.array(robot.hybrid.jacobian(q))
    J[:3] += np.cross(J[3:], (tip - TOOL_POINT) * robot.forward_kinematics(q)[:3, 2], axisa=0, axisc=0)
    return J


@dataclass(frozen=True)
class Comparison:
    """A regenerated trajectory q (N, 7) [rad], and its largest deviations from the recorded one.

    ``joints`` (7,) [rad]; ``position`` [m] and ``orientation`` [rad] of the tool point; ``worst`` the sample of the
    largest joint deviation.
    """

    q: Array
    joints: Array
    position: float
    orientation: float
    worst: int


def compare(robot: ModuleType, geometry: Geometry) -> Comparison:
    """Reconstruct the trajectory from a geometry, starting at the recorded first configuration, and compare."""
    record = recorded()
    made = inverse_kinematics(robot, poses(robot, geometry, len(record)), record[0], geometry.tip, settle=2000)
    deviation = np.abs(made - record)
    here, there = robot.forward_kinematics(made), robot.forward_kinematics(record)
    turns = Rotation.from_matrix(here[:, :3, :3] @ there[:, :3, :3].transpose(0, 2, 1)).magnitude()
    return Comparison(
        made,
        deviation.max(axis=0),
        float(np.linalg.norm(here[:, :3, 3] - there[:, :3, 3], axis=1).max()),
        float(turns.max()),
        int(deviation.max(axis=1).argmax()),
    )
