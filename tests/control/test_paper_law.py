# SPDX-License-Identifier: MIT
"""The paper's law by itself: torque and damping by SciPy's eigenvectors, limits, refusals, and hostile memory."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from stiffgen.core.emit.build import build_library
from support.controller_inputs import TASK_STIFFNESS, Arm, Q
from support.plant.loop import fill, struct
from support.project import ROOT, Once

FREE = {"effort_limit": 1e6, "torque_rate_limit": 1e9, "motor_inertia": 0.1}
KERNELS = {"corrected": "joint_stiffness", "conventional": "joint_stiffness_uncorrected"}
ZERO = np.zeros(7)
HEADER = ROOT / "generated" / "iiwa14" / "iiwa14_paper.h"


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
        M = robot.mass_matrix(q) + 0.1 * np.eye(7)  # with the rotors
        values, vectors = scipy.linalg.eigh((K + K.T) / 2, M)
        # 0.8 is twice the damping ratio, 0.2 N m s/rad the joint damping.
        B = M @ vectors @ np.diag(0.8 * np.sqrt(np.abs(values))) @ vectors.T @ M + 0.2 * np.eye(7)
        np.testing.assert_allclose(out.joint_stiffness, K, rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(out.damping, B, atol=1e-10)
        np.testing.assert_allclose(out.torque, K @ e - B @ dq, atol=1e-9)
        assert not (out.saturated or out.rate_limited)
        least = min(least, values[0])
    assert least < -1  # [1/s^2] some mode falls, and is damped as if it stood


def test_limits(robot: ModuleType) -> None:
    """Command a jump: the torque approaches it at the rate limit and stops at the effort limit."""
    law = robot.PaperLaw(torque=2.0, effort_limit=5.0, torque_rate_limit=1e3, sample_time=5e-4, motor_inertia=0.1)
    last = np.full(7, 2.0)
    for _ in range(40):  # at 0.5 N m a step, more than enough from 2 to 5 N m
        out = law.step(**sample(q0=Q + 0.5))
        # [N m]; 1000 N m/s in 0.5 ms are 0.5 N m
        assert np.abs(out.torque).max() <= 5.0 and np.abs(out.torque - last).max() <= 0.5 + 1e-12
        assert out.saturated
        last = out.torque
    wanted = np.clip(out.joint_stiffness @ np.full(7, 0.5), -5, 5)  # the spring's torque of the jump of 0.5 rad
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
    """Pass a bad sample: refused by an exception, and the torque goes to zero at its rate limit."""
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
    """Give impossible or unknown settings: each is refused when the law is made."""
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


class InC:
    """The law in C: its structs with a configuration of defaults and a sample at rest in Q, and its functions."""

    def __init__(self, robot_folder: Path, once: Once) -> None:
        """Compile the law, build the ctypes records of its header, and set defaults, posture and stiffness."""
        sources = [robot_folder / "iiwa14_paper.c"]
        made = once("paper-law", lambda folder: build_library(robot_folder, "iiwa14", folder, more=sources))
        self.library, known = ctypes.CDLL(str(next(made.glob("iiwa14_kernels*")))), dict[str, Any]()
        names = ("config", "state", "input", "output")
        self.records: list[Any] = [struct(HEADER, f"iiwa14_paper_{name}", known, {})() for name in names]
        self.config, self.state, self.given, self.out = self.records
        self.library.iiwa14_paper_default_config(ctypes.byref(self.config))
        self.given.q[:], self.given.q0[:], self.given.task_stiffness[:] = Q, Q, TASK_STIFFNESS.ravel()

    def step(self) -> int:
        return int(self.library.iiwa14_paper_step(*map(ctypes.byref, self.records)))

    def validate(self) -> int:
        return int(self.library.iiwa14_paper_validate(ctypes.byref(self.config)))


@pytest.fixture
def in_c(robot_folder: Path, once: Once) -> InC:
    return InC(robot_folder, once)


def spoil_sample_time(law: InC) -> None:
    law.config.sample_time = np.nan


def spoil_formula(law: InC) -> None:
    law.config.conventional = 7


def lower_effort(law: InC) -> None:
    law.config.effort_limit[:] = np.full(7, 3.2)


def take_effort(law: InC) -> None:
    law.config.effort_limit[:] = ZERO


def spoil_sample(law: InC) -> None:
    law.given.q[3] = np.nan


@pytest.mark.slow
@pytest.mark.parametrize("change", [lower_effort, take_effort, spoil_sample_time, spoil_formula, spoil_sample])
def test_no_change_jumps(in_c: InC, change: Any) -> None:
    """Change the configuration: the torque does not jump. Before: 142 N m became 3.2, or 0, in one call."""
    in_c.given.q0[:] = Q + 0.3
    for _ in range(400):
        assert in_c.step() == 0
    last, rate = np.array(in_c.out.torque), 1e-3 * np.array(in_c.config.torque_rate_limit)
    assert np.abs(last).max() > 100.0  # [N m]
    change(in_c)
    for _ in range(400):
        in_c.step()
        torque = np.array(in_c.out.torque)
        assert (np.abs(torque - last) <= rate * (1 + 1e-9)).all()
        assert (np.abs(torque) <= np.abs(last)).all()
        last = torque
    assert np.abs(last).max() <= (3.2 if change is lower_effort else 0.0)


def test_a_torque_in_force_beyond_the_limit_is_refused(robot: ModuleType) -> None:
    """C has no such call: there the torque counts as 0, as the header says."""
    with pytest.raises(ValueError, match="within effort_limit"):
        robot.PaperLaw(torque=50.0, effort_limit=40.0)
    with pytest.raises(ValueError, match="within effort_limit"):
        robot.PaperLaw(torque=np.nan)


@pytest.mark.slow
def test_the_header_states_the_bounds(in_c: InC) -> None:
    """Set each bound of the header and the next number beyond: accepted, and refused. Before: "nan and nan"."""
    for header in HEADER.parent.glob("*.h*"):
        assert not re.search(r"\bnan\b", header.read_text()), header.name
    text = re.sub(r"\s+(\* )?", " ", HEADER.read_text())
    body = text[text.index("/* Configuration of the paper's law") : text.index("} iiwa14_paper_config;")]
    rule = r"[Ll]ie between (\S+) and (\S+)\. Default: [^;]*\*/ (\w+) (\w+)"
    rules = [re.search(rule, field).groups() for field in body.split(";")[2:-1]]  # type: ignore[union-attr]
    assert [name for *_, name in rules] == [name for name, _ in in_c.config._fields_]
    for least, most, kind, name in rules:
        default = getattr(in_c.config, name)
        for bound, beyond in ((float(least), -np.inf), (float(most), np.inf)):
            past = bound + np.sign(beyond) if kind == "int" else np.nextafter(bound, beyond)
            for value, code in ((bound, 0), (past, -2)):
                fill(in_c.config, **{name: int(value) if kind == "int" else value})
                assert in_c.validate() == code, (name, value)
        fill(in_c.config, **{name: default if np.ndim(default) == 0 else 1.0})


def test_hostile_memory(in_c: InC) -> None:
    """Whatever bytes configuration, state and sample hold: the torque is finite, and within the effort limit."""
    c, records = in_c.library, in_c.records
    config, state, given, out = records
    random, results = np.random.default_rng(2), set()
    for k in range(3000):
        c.iiwa14_paper_default_config(ctypes.byref(config))
        given.q[:], given.q0[:], given.task_stiffness[:] = Q, Q + 0.1, TASK_STIFFNESS.ravel()
        given.dq[:], given.wrench[:], state.torque[:], state.opposite[:] = ZERO, np.zeros(6), ZERO, ZERO
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
