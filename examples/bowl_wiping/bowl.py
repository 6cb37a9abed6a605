# SPDX-License-Identifier: MIT
"""Describe the bowl: shape, place and friction are our choice, such that the zero-force trajectory presses on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from examples.bowl_wiping.tool import PLATE
from examples.experiments.plant import START_POSTURE, Array, Plant, Surface


@dataclass(frozen=True)
class Bowl:
    """A spherical bowl in a square block, open upwards; metres in the base frame.

    Args:
        centre: x and y of its axis.
        bottom: height of its lowest point.
        radius: of the sphere.
        opening: radius of its upper edge.
        friction: coefficient of sliding friction with the plate.

    """

    centre: tuple[float, float] = (0.508, 0.398)
    bottom: float = -0.055
    radius: float = 0.41
    opening: float = 0.24
    friction: float = 0.5

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height of the surface over the points (x, y) of the base frame [m]."""
        square = (np.asarray(x) - self.centre[0]) ** 2 + (np.asarray(y) - self.centre[1]) ** 2
        return self.bottom + self.radius - np.sqrt(self.radius**2 - np.minimum(square, self.opening**2))

    def surface(self, cells: int = 60) -> Surface:
        """Return the bowl as a height field, whose cells are convex prisms: the contact search sees the hollow.

        Where a sphere touches several cells at once, the normals of the shallower ones lean by up to some 15 degrees;
        the deepest one's, and the sum of the forces, are the sphere's to 3 degrees.
        """
        half = self.opening + 0.02
        x, y = (np.linspace(centre - half, centre + half, cells + 1) for centre in self.centre)
        return Surface("bowl", self.centre, (half, half), self.height(*np.meshgrid(x, y)), self.friction)


def bowl_plant(timestep: float = 0.001, *, surface: bool = True, q: ArrayLike = START_POSTURE) -> Plant:
    """Return the arm with the plate, over the bowl or in free space."""
    return Plant(timestep, surface=Bowl().surface() if surface else None, tool=PLATE, q=q)
