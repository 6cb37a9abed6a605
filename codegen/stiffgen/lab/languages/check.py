# SPDX-License-Identifier: MIT
"""Compare all languages of a folder with its C and NumPy functions."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.verify.result import Check, Kernels, attempted
from stiffgen.lab.languages.cpp import check_cpp
from stiffgen.lab.languages.material import Material
from stiffgen.lab.languages.sensor_header import check_sensor_header
from stiffgen.lab.languages.wrappers import check_wrappers


def check_languages(
    robot: GeneratedRobot,
    single: Kernels,
    pool: Mapping[Argument, FloatArray],
    build: Path,
    other_version: bool,
    libraries: Mapping[str, ctypes.CDLL],
    texts: Mapping[str, str],
) -> list[Check]:
    """Return the rows of C++, NAME_sensor.h, CasADi, PyTorch and JAX, where the folder has them.

    ``libraries`` are builds of the kernels, of which one is called; :class:`Material` has the other arguments.
    """
    build.mkdir()
    library = Path(next(iter(libraries.values()))._name)
    material = Material(robot, single, pool, library, build, texts, other_version)
    checks = {f"{robot.name}.hpp": check_cpp, f"{robot.name}_sensor.h": check_sensor_header, "wrappers": check_wrappers}
    return [row for file, check in checks.items() for row in attempted(file, partial(check, material))]
