# SPDX-License-Identifier: MIT
"""Draw README's picture: the iiwa over the bowl, with where a push moves its tip when every joint is a spring.

    python -m examples.wiping_picture FILE.png    (MUJOCO_GL=egl or osmesa; needs the extra examples)

The ellipsoid is to scale. Its axes are those of the tip's compliance C = J K^-1 J^T [m/N] of the translation, with
MuJoCo's Jacobian and ``JOINT_STIFFNESS`` in every joint; a push of ``PUSH`` moves the tip to its surface.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from examples.bowl_wiping.trajectory import recorded
from examples.experiments.plant import Plant
from examples.experiments.render import scene

SIZE = (1400, 800)
JOINT_STIFFNESS = 300.0
"""[N m/rad]"""
PUSH = 60.0
"""[N]"""
SHOWN = 0.36
"""Share of the motion at which the arm is drawn."""
COLOUR = (0.10, 0.42, 0.75, 0.8)


def compliance(plant: Plant) -> NDArray[np.float64]:
    """Return the translational compliance of the tip (3, 3) [m/N]."""
    import mujoco

    jacobian = np.zeros((3, plant.model.nv))
    mujoco.mj_jacSite(plant.model, plant.data, jacobian, None, plant.model.site("tip").id)
    result: NDArray[np.float64] = jacobian @ jacobian.T / JOINT_STIFFNESS
    return result


def add_ellipsoid(drawn: Any, plant: Plant) -> None:
    """Add the displacements by a push of any direction to what is drawn."""
    import mujoco

    sizes, axes = np.linalg.eigh(compliance(plant))
    axes *= np.sign(np.linalg.det(axes))
    kind, colour = mujoco.mjtGeom.mjGEOM_ELLIPSOID, np.array(COLOUR, dtype=np.float32)
    geometry = drawn.geoms[drawn.ngeom]
    mujoco.mjv_initGeom(geometry, kind, PUSH * sizes, plant.pose[:3, 3], axes.ravel(), colour)
    drawn.ngeom += 1


def draw(file: Path) -> None:
    """Draw the picture; its background is transparent."""
    from matplotlib.image import imsave

    renderer, camera, plant = scene("bowl_wiping", SIZE)
    path = recorded()
    plant.place(path[int(SHOWN * (len(path) - 1))])
    renderer.update_scene(plant.data, camera)
    add_ellipsoid(renderer.scene, plant)
    image = renderer.render()
    alpha = np.where(image.sum(axis=2) > 0, 255, 0).astype(np.uint8)
    used = [np.nonzero(alpha.max(axis=axis))[0] for axis in (1, 0)]
    rows, columns = (slice(max(each[0] - 12, 0), each[-1] + 12) for each in used)
    imsave(file, np.dstack([image, alpha])[rows, columns])


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
