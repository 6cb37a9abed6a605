# SPDX-License-Identifier: MIT
"""``stiffgen.estimate_friction``: friction from a slow motion there and back, on a model and on a simulated arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.core.errors import RecordingError
from support.arms.arms import Arm
from support.project import Once

FRICTION = np.array([2.0, 0.5, 0.0])


def recording(**changes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, dq and torque of three joints that go there and back twice, under gravity and noise."""
    settings = {"way": 0.4, "speed": 0.1, "back": 1.0} | changes
    random, samples = np.random.default_rng(2), 16000
    phase = np.arange(samples) / samples * 4
    wave = np.abs((phase % 2.0) - 1.0) - 0.5  # triangles
    q = settings["way"] * wave[:, None] * np.array([1.0, -0.8, 0.5]) + np.array([0.2, 0.5, -0.3])
    side = np.where(phase % 2.0 < 1.0, -1.0, settings["back"])
    dq = settings["speed"] * side[:, None] * np.array([1.0, -0.8, 0.5])
    torque = 30.0 * np.sin(q.sum(axis=1))[:, None] * np.array([1.0, 0.5, 0.1]) + FRICTION * np.sign(dq)
    return q, dq + 1e-3 * random.normal(size=q.shape), torque + 0.1 * random.normal(size=q.shape)


def test_gravity_is_no_friction() -> None:
    """30 N m of gravity, 0.1 N m of noise: friction within 0.05 N m, and a configuration of 90 %."""
    found = stiffgen.estimate_friction(*recording())
    np.testing.assert_allclose(found.mean, FRICTION, atol=0.05)
    assert (found.smallest <= found.mean).all() and (found.mean <= found.largest).all()
    np.testing.assert_allclose(found.fields["coulomb_friction"], 0.9 * FRICTION, atol=0.05)
    assert found.text.startswith("coulomb_friction=[1.") and found.text.endswith("# [N m or N]")


@pytest.mark.parametrize(
    ("changes", "match"),
    [({"way": 0.05}, "joint 0 moves by 0.05"), ({"speed": 0.6}, "at most 0.3"), ({"back": -1.0}, "there and back")],
)
def test_what_is_refused(changes: dict[str, float], match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        stiffgen.estimate_friction(*recording(**changes))


def test_two_paths_are_refused() -> None:
    q, dq, torque = recording()
    q[:, 2] += 0.2 * (dq[:, 0] > 0)
    with pytest.raises(RecordingError, match="one path"):
        stiffgen.estimate_friction(q, dq, torque)
    with pytest.raises(RecordingError, match="of one shape"):
        stiffgen.estimate_friction(q, dq[:-1], torque)


@pytest.mark.slow
def test_a_simulated_arm(once: Once) -> None:
    """A UR5 with rotors, sticking friction and sensors, under the controller: within 15 % for each joint."""
    arm = Arm("ur5", once("arms-ur5", lambda folder: Arm("ur5", folder)))
    samples = 20000
    wave = 0.5 - np.abs((np.arange(samples) / samples * 4) % 2.0 - 1.0) + 0.5
    goal = arm.posture + 0.5 * (wave - wave[0])[:, None] * np.array([1.0, -0.6, 0.8, 0.7, 0.7, 1.0])
    rows = arm.run(arm.plant(), samples, arm.config(velocity_noise=5e-3), goal=goal, translation=4000.0, rotation=400.0)
    assert not rows["faulted"].any()
    found = stiffgen.estimate_friction(rows["q"], rows["v"], rows["torque"])
    true = arm.maker.friction * arm.effort
    print("share found:", np.round(found.mean / true, 2))
    np.testing.assert_allclose(found.mean, true, rtol=0.15)
