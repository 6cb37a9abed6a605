# SPDX-License-Identifier: MIT
"""The paper's law by itself: torque and damping by SciPy's eigenvectors, limits, refusals, and hostile memory."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from stiffgen.core.emit.build import build_library
from support.controller_inputs import TASK_STIFFNESS, Arm, Q
from support.plant.loop import struct
from support.project import ROOT, Once

FREE = {"effort_limit": 1e6, "torque_rate_limit": 1e9, "motor_inertia": 0.1}
KERNELS = {"corrected": "joint_stiffness", "conventional": "joint_stiffness_uncorrected"}
ZERO = np.zeros(7)


def sample(**changed: Any) -> dict[str, Any]:
    """Return a valid sample at rest in Q, with some arguments changed."""
    return {"q": Q, "dq": ZERO, "q0": Q, "wrench": np.zeros(6), "task_stiffness": TASK_STIFFNESS} | changed


@pytest.mark.parametrize("formula", KERNELS)
def test_torque_and_damping(robot: ModuleType, formula: str) -> None:
    """B solves the generalised eigenproblem of the stiffness's symmetric part; modes below zero are damped alike."""
    random, least = np.random.default_rng(1), 0.0
    law = robot.PaperLaw(formula, **FREE, damping_ratio=0.4, joint_damping=0.2, posture_stiffness=3.0)
    for _ in range(20):
        q, dq, e = random.uniform(-1.5, 1.5, 7), random.normal(size=7), 0.2 * random.normal(size=7)
        wrench = random.normal(size=6) * [40, 40, 40, 8, 8, 8]
        out = law.step(q=q, dq=dq, q0=q + e, wrench=wrench, task_stiffness=TASK_STIFFNESS)
        K = getattr(robot.hybrid, KERNELS[formula])(q, wrench, TASK_STIFFNESS) + 3.0 * np.eye(7)
        M = robot.mass_matrix(q) + 0.1 * np.eye(7)
        values, vectors = scipy.linalg.eigh((K + K.T) / 2, M)
        B = M @ vectors @ np.diag(0.8 * np.sqrt(np.abs(values))) @ vectors.T @ M + 0.2 * np.eye(7)
        np.testing.assert_allclose(out.joint_stiffness, K, rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(out.damping, B, atol=1e-10)
        np.testing.assert_allclose(out.torque, K @ e - B @ dq, atol=1e-9)
        assert not (out.saturated or out.rate_limited)
        least = min(least, values[0])
    assert least < -1


def test_limits(robot: ModuleType) -> None:
    """The torque approaches what the law wants at the rate limit, and stops at the effort limit."""
    law = robot.PaperLaw(torque=2.0, effort_limit=5.0, torque_rate_limit=1e3, sample_time=5e-4, motor_inertia=0.1)
    last = np.full(7, 2.0)
    for _ in range(40):
        out = law.step(**sample(q0=Q + 0.5))
        assert np.abs(out.torque).max() <= 5.0 and np.abs(out.torque - last).max() <= 0.5 + 1e-12
        assert out.saturated
        last = out.torque
    wanted = np.clip(out.joint_stiffness @ np.full(7, 0.5), -5, 5)
    np.testing.assert_allclose(out.torque, wanted, atol=1e-12)
    assert not out.rate_limited


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"q": Q * np.nan}, "not finite"),
        ({"wrench": np.full(6, np.inf)}, "not finite"),
        ({"q0": np.full(7, 1e7)}, "absurdly large"),
        ({"task_stiffness": -np.eye(6)}, "positive semidefinite"),
        ({"task_stiffness": TASK_STIFFNESS + np.triu(np.ones((6, 6)), 1)}, "symmetric"),
        ({"task_stiffness": np.full((6, 6), np.nan)}, "symmetric"),
        ({"q": Q[:6]}, "q: shape"),
    ],
)
def test_a_sample_is_refused_aloud(robot: ModuleType, changed: dict[str, Any], message: str) -> None:
    """The torque then goes to zero at its rate limit."""
    law = robot.PaperLaw(motor_inertia=0.1, torque=1.0, torque_rate_limit=100.0)
    with pytest.raises(ValueError, match=message):
        law.step(**sample(**changed))
    np.testing.assert_allclose(law.torque, 1.0 if "shape" in message else 0.9)
    law.step(**sample())


@pytest.mark.parametrize(
    "fields",
    [
        {"sample_time": 0},
        {"sample_time": np.inf},  # accepted before
        {"damping_ratio": -1},
        {"effort_limit": np.nan},
        {"motor_inertia": np.inf},
    ],
)
def test_a_configuration_is_refused(robot: ModuleType, fields: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        robot.PaperLaw(**fields)
    with pytest.raises(TypeError, match="stiffness_cap"):
        robot.PaperLaw(stiffness_cap="accept")
    with pytest.raises(ValueError, match="corrected, conventional"):
        robot.PaperLaw("exact")


def test_a_load_carries_the_arm_away_from_a_secant(robot: ModuleType) -> None:
    """As the header says: a hanging load, correctly measured, is no spring's; the controller holds it."""
    load, law, arm = np.array([0, 0, -40.0, 0, 0, 0]), robot.PaperLaw(motor_inertia=0.1), Arm(robot, Q)
    for _ in range(4000):
        arm.step(law.step(q=arm.q, dq=arm.dq, q0=Q, wrench=load, task_stiffness=TASK_STIFFNESS).torque, load)
    assert np.abs(arm.q - Q).max() > 0.4


def test_hostile_memory(robot_folder: Path, once: Once) -> None:
    """Whatever bytes configuration, state and sample hold: the torque is finite, and within the effort limit."""
    sources = [robot_folder / "iiwa14_paper.c"]
    made = once("paper-law", lambda folder: build_library(robot_folder, "iiwa14", folder, more=sources))
    c, known = ctypes.CDLL(str(next(made.glob("iiwa14_kernels*")))), dict[str, Any]()
    header = ROOT / "generated" / "iiwa14" / "iiwa14_paper.h"
    names = ("config", "state", "input", "output")
    records: list[Any] = [struct(header, f"iiwa14_paper_{name}", known, {})() for name in names]
    config, state, given, out = records
    random, results = np.random.default_rng(2), set()
    for k in range(3000):
        c.iiwa14_paper_default_config(ctypes.byref(config))
        given.q[:], given.q0[:], given.task_stiffness[:] = Q, Q + 0.1, TASK_STIFFNESS.ravel()
        given.dq[:], given.wrench[:], state.torque[:] = ZERO, np.zeros(6), ZERO
        for record in (config, state, given):
            row = np.frombuffer(record, np.uint8)
            for at in random.integers(len(row), size=int(random.integers(0, 9)) if k % 3 else 0):
                row[at] = random.choice([0, 127, 128, 240, 255, int(random.integers(256))])
        results.add(c.iiwa14_paper_step(*map(ctypes.byref, records)))
        effort = np.array(config.effort_limit)
        torque = np.array(out.torque)
        assert np.isfinite(torque).all() and (np.abs(torque) <= np.where(effort >= 0, effort, 0)).all()
        assert np.array_equal(torque, state.torque)
    assert results == {0, -2, -3, -4}
    assert c.iiwa14_paper_step(None, *map(ctypes.byref, records[1:])) == -1 and not np.any(out.torque)


def test_the_law_is_short() -> None:
    """A reader of the paper sees the law in one file: at most 200 lines."""
    lines = (ROOT / "generated" / "iiwa14" / "iiwa14_paper.c").read_text().splitlines()
    assert len(lines) <= 200
