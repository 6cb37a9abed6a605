# SPDX-License-Identifier: MIT
"""A spring at the tip that MuJoCo steps implicitly: the callback against NumPy, and how stiff the spring may be."""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

import stiffgen
from examples import implicit
from support.project import ROOT, Once

PAGE = (ROOT / "docs" / "flutter.md").read_text()
FAR = implicit.Cell(0.15, 1.2, 0.01, wall=True)


@pytest.fixture(scope="module")
def iiwa(once: Once) -> ModuleType:
    made = once("stepped", lambda output: stiffgen.generate(implicit.URDF, output=output, **implicit.OPTIONS))
    return stiffgen.open_robot(Path(made) / "iiwa14").module


def stable(iiwa: ModuleType, name: str, cell: implicit.Cell, stiffness: float) -> bool:
    model, tangent = implicit.arm(cell.step, cell.wall), implicit.TANGENTS[name]
    tasks = implicit.tasks(iiwa, cell.away, cell.turn, stiffness)
    return all(implicit.is_stable(model, task, tangent, seconds=0.5) for task in tasks)


@pytest.mark.parametrize("name", implicit.TANGENTS)
def test_the_callback_solves_the_implicit_step(name: str, iiwa: ModuleType) -> None:
    """(M + h^2 P) a = torque - h P dq - damping - bias, M of a model without the callback."""
    model, h = implicit.arm(0.01, wall=False), 0.01
    (task,) = implicit.tasks(iiwa, 0.05, 0.5, 1000.0, count=1)
    data, alone = mujoco.MjData(model), mujoco.MjData(model)
    for each in (data, alone):
        each.qpos[:], each.qvel[:] = implicit.START, 0.1
    with implicit.implicit_spring(task, implicit.TANGENTS[name]):
        mujoco.mj_forward(model, data)
    mujoco.mj_forward(model, alone)
    M = np.zeros((7, 7))
    mujoco.mj_fullM(model, alone, M)
    P = implicit.TANGENTS[name](task, implicit.START)
    torque = iiwa.spring.torque(implicit.START, *task.arguments) - h * P @ alone.qvel
    expected = np.linalg.solve(M + h * h * P, torque - implicit.DAMPING * alone.qvel - alone.qfrc_bias)
    assert data.qacc == pytest.approx(expected, rel=1e-9)


def test_the_positive_tangent_stands_stiffness_that_others_do_not(iiwa: ModuleType) -> None:
    """Search the limits in contact at 10 ms: beyond 10 times those of explicit steps and of J^T K J."""
    near = implicit.Cell(0.05, 0.5, 0.01, wall=True)
    for cell in (near, FAR):
        assert stable(iiwa, "explicit", cell, 1e3)
        assert not stable(iiwa, "explicit", cell, 1e4)
        assert stable(iiwa, "P", cell, 1e7)
    assert not stable(iiwa, "J^T K J", FAR, 3e5)
    assert not stable(iiwa, "abs(Kq)", FAR, 3e5)


def test_the_wall_stops_the_tip(iiwa: ModuleType) -> None:
    """Press the tip against a wall for 1 s: one contact, with more than 20 N."""
    model = implicit.arm(0.01, wall=True)
    (task,) = implicit.tasks(iiwa, 0.05, 0.5, 1e4, count=1)
    data = mujoco.MjData(model)
    data.qpos[:] = implicit.START
    with implicit.implicit_spring(task, implicit.positive):
        for _ in range(100):
            mujoco.mj_step(model, data)
    assert data.ncon == 1
    assert data.efc_force.max() > 20


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, pytest.param(None, marks=pytest.mark.wide)])
def test_the_tables_are_those_of_the_page(iiwa: ModuleType, count: int | None) -> None:
    """Within one step of the search: at its limit a spring is stable on one processor and not on the next."""
    for row in islice(chain(implicit.rows(iiwa), implicit.deviation_rows(iiwa)), count):
        (line,) = (line for line in PAGE.split("\n") if line.startswith(f"| {row[0]} |"))
        for ours, theirs in zip(row[1:], line.strip("| ").split(" | ")[1:], strict=True):
            number = ours.split(" ")[0]
            if number[:1].isdigit():
                assert float(number) == pytest.approx(float(theirs.split(" ")[0]), rel=0.8), row
            else:
                assert ours == theirs
