# SPDX-License-Identifier: MIT
"""Make the board: a height field that the recorded ball slid on.

Along the recorded path the height is the lowest point of the ball. The recording says nothing about the board beside
the path: obstacles are taken to be ``width`` wide across the path, then they fall to the board.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from examples.experiments.motion import SAMPLE_TIME
from examples.experiments.plant import Plant, Surface
from examples.parkour.tool import BALL, BALL_RADIUS
from examples.parkour.trajectory import LIFT_OFF, START, recorded

Array = NDArray[np.float64]

WIDTH = 0.06
"""[m] of the obstacles across the path."""
FALL = 0.03
"""[m] over which an obstacle falls to the board at its sides."""
CELL, MARGIN = 0.004, 0.08
"""[m] of the grid, and around the path."""
NEIGHBOURS = 8
"""Samples of the path that make up the height at a point, weighted by their distance."""
FRICTION, SOFTNESS = 0.2, 0.04
"""Coefficient of a greased ball, and time constant of the contact [s], of rubber."""


@cache
def ball_path() -> tuple[tuple[float, float, float], ...]:
    """Return the ball's centre along the recording until it leaves the board (N, 3) [m], by MuJoCo's kinematics."""
    plant = Plant(tool=BALL)
    centres = []
    for q in recorded()[: round(LIFT_OFF / SAMPLE_TIME) : 4]:
        plant.data.qpos[:] = q
        mujoco.mj_kinematics(plant.model, plant.data)
        x, y, z = plant.data.site("tip").xpos.tolist()
        centres.append((x, y, z))
    return tuple(centres)


def board(width: float = WIDTH) -> Surface:
    """Return the board, whose height follows the recorded ball, with obstacles of `width` [m] across the path."""
    path = np.array(ball_path())
    low, high = path[:, :2].min(axis=0) - MARGIN, path[:, :2].max(axis=0) + MARGIN
    columns, rows = np.ceil((high - low) / CELL).astype(int) + 1
    x, y = np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    distance, nearest = cKDTree(path[:, :2]).query(points, k=NEIGHBOURS)
    weight = 1 / (distance**2 + CELL**2)  # by inverse square distance to the path's points
    under = path[:, 2] - BALL_RADIUS
    along = (weight * under[nearest]).sum(axis=1) / weight.sum(axis=1)
    level = float(np.median(under))
    # Full height within half the width of the path, then down to the level over FALL [m], as half a cosine.
    beyond = np.clip((distance[:, 0] - width / 2) / FALL, 0, 1)
    share = (1 + np.cos(np.pi * beyond)) / 2
    height = gaussian_filter((level + share * (along - level)).reshape(rows, columns), 1.0)
    (left, near), (right, far) = low.tolist(), high.tolist()
    centre, half = ((left + right) / 2, (near + far) / 2), ((right - left) / 2, (far - near) / 2)
    return Surface("board", centre, half, height, FRICTION, SOFTNESS)


def parkour_plant(
    timestep: float = 0.001, *, surface: bool = True, width: float = WIDTH, q: ArrayLike = START
) -> Plant:
    """Return the arm with the ball, over the board or in free space."""
    return Plant(timestep, surface=board(width) if surface else None, tool=BALL, q=q)
