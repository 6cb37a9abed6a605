# SPDX-License-Identifier: MIT
"""Render the arm offscreen by MuJoCo, in a process of its own: overlaid configurations, and a film.

A graphics driver that is missing or broken may end the process, and MuJoCo chooses its renderer when it is imported;
so an experiment asks ``python -m examples.experiments.render`` for the picture and goes on without it if need be.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from examples.experiments.plant import Plant

ROOT = Path(__file__).resolve().parents[2]
RENDERERS = ("egl", "osmesa")
HINT = "no offscreen renderer; on Debian: apt-get install libegl1 libgl1-mesa-dri (or libosmesa6)"
NO_ENCODER = "imageio-ffmpeg is not installed; pip install -e '.[examples]'"
PICTURE_SIZE, FILM_SIZE = (1100, 640), (640, 400)
FRAMES_PER_SECOND = 25
SHADOW = 0.28
"""Opacity of the earlier configurations; the last one is solid."""
BACKGROUND = (250, 250, 247)
"""Colour of the film's background."""


@dataclass(frozen=True)
class Camera:
    """View: the point looked at [m], distance from it [m], azimuth and elevation [deg]."""

    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float


def picture(experiment: str, configurations: NDArray[np.float64], file: Path) -> str | None:
    """Draw arm and surface at configurations (N, 7) [rad] into a PNG file.

    Returns:
        None, or why there is no picture. The environment's MUJOCO_GL is tried alone if it is set.

    """
    return _in_a_process("picture", experiment, configurations, file)


def film(experiment: str, configurations: NDArray[np.float64], file: Path) -> str | None:
    """Film the arm at configurations (N, 7) [rad], FRAMES_PER_SECOND of them a second, into an MP4 file.

    Returns:
        None, or why there is no film.

    """
    file.unlink(missing_ok=True)
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        return NO_ENCODER
    return _in_a_process("film", experiment, configurations, file)


def _in_a_process(what: str, experiment: str, configurations: NDArray[np.float64], file: Path) -> str | None:
    """Draw in a process of its own, since a failing graphics driver ends it; return a hint if all fail."""
    chosen = os.environ.get("MUJOCO_GL")
    file.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        stored = Path(folder) / "configurations.npy"
        np.save(stored, configurations)
        for renderer in (chosen,) if chosen else RENDERERS:
            command = ["-m", "examples.experiments.render", what, experiment, str(stored), str(file.resolve())]
            environment = {**os.environ, "MUJOCO_GL": renderer}
            subprocess.run([sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, check=False)
            if file.exists():
                return None
    return HINT


def scene(experiment: str, size: tuple[int, int]) -> tuple[Any, Any, Plant]:
    """Return a renderer, its camera, and the plant whose model it draws; MUJOCO_GL names the renderer."""
    import mujoco

    chosen = importlib.import_module(f"examples.{experiment}.experiment").EXPERIMENT
    plant: Plant = chosen.plant()
    model = plant.model
    model.vis.global_.offwidth, model.vis.global_.offheight = size
    model.vis.headlight.ambient[:] = 0.4
    model.vis.headlight.diffuse[:] = 0.3
    camera = mujoco.MjvCamera()
    camera.lookat[:] = chosen.camera.lookat
    camera.distance, camera.azimuth, camera.elevation = (
        chosen.camera.distance,
        chosen.camera.azimuth,
        chosen.camera.elevation,
    )
    return mujoco.Renderer(model, size[1], size[0]), camera, plant


def _draw(experiment: str, configurations: NDArray[np.float64], file: Path) -> None:
    """Draw the last configuration of (rows, 7) [rad], and the others as shadows, into a PNG file."""
    import mujoco
    from matplotlib.image import imsave

    renderer, camera, plant = scene(experiment, PICTURE_SIZE)
    options, perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
    plant.place(configurations[-1])
    renderer.update_scene(plant.data, camera, options)
    drawn = renderer.scene
    for configuration in configurations[:-1]:
        plant.place(configuration)
        first = drawn.ngeom
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        mujoco.mjv_addGeoms(plant.model, plant.data, options, perturbation, moving.value, drawn)
        for index in range(first, drawn.ngeom):
            drawn.geoms[index].rgba[3] = SHADOW
    image = renderer.render()
    # The background is black and nothing else is: made transparent, the picture suits light and dark pages.
    alpha = np.where(image.sum(axis=2) > 0, 255, 0).astype(np.uint8)
    imsave(file, np.dstack([image, alpha]))


def _film(experiment: str, configurations: NDArray[np.float64], file: Path) -> None:
    """Draw the configurations (frames, 7) [rad] into a film."""
    import imageio_ffmpeg

    renderer, camera, plant = scene(experiment, FILM_SIZE)
    with tempfile.TemporaryDirectory() as folder:  # a film that ends early is none
        unfinished = Path(folder) / file.name
        writer = imageio_ffmpeg.write_frames(
            str(unfinished), FILM_SIZE, fps=FRAMES_PER_SECOND, codec="libx264", quality=None,
            output_params=["-crf", "30", "-movflags", "+faststart"], ffmpeg_log_level="error",
        )  # fmt: skip
        writer.send(None)
        for configuration in configurations:
            plant.place(configuration)
            renderer.update_scene(plant.data, camera)
            image = renderer.render()
            image[image.sum(axis=2) == 0] = BACKGROUND
            writer.send(np.ascontiguousarray(image))
        writer.close()
        file.write_bytes(unfinished.read_bytes())


if __name__ == "__main__":
    _what, _experiment, _stored, _file = sys.argv[1:]
    (_draw if _what == "picture" else _film)(_experiment, np.load(_stored), Path(_file))
