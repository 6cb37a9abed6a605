# SPDX-License-Identifier: MIT
"""The implicit step in MJX: against MuJoCo with its callback, and the stiffness that stays stable in contact."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

import stiffgen
from examples import implicit
from support.project import ROOT, Once

mjx = pytest.importorskip("mujoco.mjx")
jax = pytest.importorskip("jax")
stepped = import_module("examples.implicit_mjx")

PAGE = (ROOT / "docs" / "flutter.md").read_text()


@pytest.fixture(scope="module")
def iiwa(once: Once) -> ModuleType:
    made = once("stepped in JAX", lambda output: stiffgen.generate(implicit.URDF, output=output, **stepped.OPTIONS))
    return stiffgen.open_robot(Path(made) / "iiwa14").module


@pytest.mark.slow
def test_a_motion_into_a_wall_is_that_of_mujoco(iiwa: ModuleType) -> None:
    """Move into a wall in 30 steps of 10 ms: MJX and MuJoCo agree."""
    model = implicit.arm(0.01, wall=True)
    (task,) = implicit.tasks(iiwa, 0.05, 0.5, 1e4, count=1)
    arm, other = stepped.functions(iiwa), mjx.put_model(model, impl="jax")
    spring, weights = tuple(map(np.asarray, task.arguments)), np.array([0.0, 1.0])
    step = jax.jit(partial(stepped.step, arm, other, spring=spring, weights=weights), compiler_options=stepped.COMPILER)
    data, alone = mujoco.MjData(model), stepped.starting(other)
    data.qpos[:] = implicit.START
    with implicit.implicit_spring(task, implicit.positive):
        for _ in range(30):
            mujoco.mj_step(model, data)
            alone, energy = step(alone)
            assert np.abs(data.qpos - alone.qpos).max() < 1e-9
    assert data.ncon == 1
    assert np.abs(data.qpos - implicit.START).max() > 0.1
    assert 0 < energy < task.robot.spring.energy(implicit.START, *task.arguments)


@pytest.mark.slow
def test_the_tangent_stands_in_mjx_what_it_stands_in_mujoco(iiwa: ModuleType) -> None:
    """Search the largest stable stiffness in contact at 10 ms: the page's, within one step."""
    search = stepped.searching(iiwa, wall=True)
    for away, turn in ((0.05, 0.5), (0.15, 1.2)):
        cell = implicit.Cell(away, turn, 0.01, wall=True)
        (line,) = (line for line in PAGE.split("\n") if line.startswith(f"| {implicit.named(cell)} |"))
        columns = dict(zip(implicit.TANGENTS, line.strip("| ").split(" | ")[1:], strict=True))
        for name, stiffness in search(cell).items():
            ours = implicit.stiffness_words(stiffness)
            if "end" in (ours, columns[name]):
                assert ours == columns[name], name
            else:
                assert float(ours) == pytest.approx(float(columns[name]), rel=0.8), name
