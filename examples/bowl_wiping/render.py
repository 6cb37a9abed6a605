# SPDX-License-Identifier: MIT
"""Draw the arm as overlaid configurations, rendered offscreen by MuJoCo in a process of its own.

A graphics driver that is missing or broken may end the process, and MuJoCo chooses its renderer when it is imported;
so the experiment asks ``python -m examples.bowl_wiping.render`` for the picture and goes on without it if need be.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
RENDERERS = ("egl", "osmesa")
HINT = "no offscreen renderer; on Debian: apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)"
WIDTH, HEIGHT = 1100, 640
SHADOW = 0.28
"""Opacity of the earlier postures; the last one is solid."""


def render(postures: NDArray[np.float64], picture: Path) -> str | None:
    """Draw arm and bowl at postures (N, 7) [rad] into a PNG file.

    Returns:
        None, or why there is no picture. The environment's MUJOCO_GL is tried alone if it is set.

    """
    chosen = os.environ.get("MUJOCO_GL")
    picture.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "postures.npy"
        np.save(file, postures)
        for renderer in (chosen,) if chosen else RENDERERS:
            subprocess.run(
                [sys.executable, "-m", "examples.bowl_wiping.render", str(file), str(picture.resolve())],
                cwd=ROOT,
                env={**os.environ, "MUJOCO_GL": renderer},
                capture_output=True,
                check=False,
            )
            if picture.exists():
                return None
    return HINT


def _draw(postures: NDArray[np.float64], picture: Path) -> None:
    import mujoco
    from matplotlib.image import imsave

    from examples.bowl_wiping.plant import Plant

    plants = [Plant(q=q) for q in postures]
    model = plants[0].model
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.55
    camera = mujoco.MjvCamera()
    camera.lookat[:] = [0.27, 0.2, 0.22]
    camera.distance, camera.azimuth, camera.elevation = 1.65, 150, -24
    options, perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
    renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    renderer.update_scene(plants[-1].data, camera, options)
    scene = renderer.scene
    for plant in plants[:-1]:
        first = scene.ngeom
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        mujoco.mjv_addGeoms(model, plant.data, options, perturbation, moving.value, scene)
        for index in range(first, scene.ngeom):
            scene.geoms[index].rgba[3] = SHADOW
    image = renderer.render()
    # The background is black and nothing else is: made transparent, the picture suits light and dark pages.
    alpha = np.where(image.sum(axis=2) > 0, 255, 0).astype(np.uint8)
    imsave(picture, np.dstack([image, alpha]))


if __name__ == "__main__":
    _draw(np.load(sys.argv[1]), Path(sys.argv[2]))
