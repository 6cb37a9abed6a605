# SPDX-License-Identifier: MIT
"""Provide cases for the tests of the JAX and PyTorch wrappers: functions, arguments, results and gradients."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import stiffgen
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import as_results
from support.chains import chain_urdf
from support.exact_tree import tree_urdf

Array = npt.NDArray[np.float64]


def small_robot(output: Path, types: str = "rpm", kernels: str = "all") -> GeneratedRobot:
    """Generate a robot "arm" with derivatives: three joints, one sliding and one that mimics (or others)."""
    urdf = output / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")  # compiles in a third of the time
        options: dict[str, Any] = {"derivatives": True, "controller": False, "kernels": kernels}
        return open_robot(stiffgen.generate(urdf, output=output, name="arm", **options))


def floating_robot(output: Path) -> GeneratedRobot:
    """Generate a robot with four joints and two tips on a floating base, with derivatives."""
    urdf = output / "tree.urdf"
    urdf.write_text(tree_urdf(3, joints=4))
    options: dict[str, Any] = {"tip": ["left", "right"], "floating_base": True, "derivatives": True}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        return open_robot(stiffgen.generate(urdf, output=output, name="walker", **options))


def wrapper(robot: GeneratedRobot, framework: str) -> ModuleType:
    """Import NAME.jax or NAME.torch."""
    return importlib.import_module(f"{robot.module.__name__}.{framework}")


@dataclass(frozen=True)
class Case:
    """Function of the wrapper, with the results of NumPy's function and its product for a stack of arguments."""

    function: Any
    path: str
    arguments: list[Array]
    cotangents: list[Array]
    results: list[Array]
    gradients: list[Array]

    def of_wrapper(self) -> list[Array]:
        """Return the gradients of a wrapper: also of the entries of the base's pose."""
        made = list(self.gradients)
        if made[0].shape[1:] != self.arguments[0].shape[1:]:
            force, moment = made[0][:, :3], made[0][:, 3:]
            motion = np.zeros((len(force), 4, 4))
            motion[:, :3, 3] = force
            motion[:, :3, :3] = np.cross(np.eye(3), moment[:, None, :]) / 2  # [m] / 2
            made[0] = self.arguments[0] @ motion
        return made


def cases(robot: GeneratedRobot, module: ModuleType, count: int) -> Iterator[Case]:
    """Yield every function that has a gradient, at random states."""
    pool = argument_samples(robot.chain, count, 11, robot.springs)
    table = {kernel.qualified_name: kernel for kernel in robot.table}
    compiled = importlib.import_module(f"{robot.module.__name__}.{robot.name}_python")
    for name, kernel in table.items():
        if f"{name}_vjp" not in table:
            continue
        product = table[f"{name}_vjp"]
        given = [pool[argument] for argument in kernel.arguments]
        cotangents = [pool[argument] for argument in product.arguments[len(given) :]]
        path = ".".join((*kernel.path, kernel.name))
        function: Any = module
        for part in path.split("."):
            function = getattr(function, part)
        yield Case(
            function,
            path,
            given,
            cotangents,
            list(as_results(getattr(compiled, name)(*given))),
            list(as_results(getattr(compiled, f"{name}_vjp")(*given, *cotangents))),
        )
