# SPDX-License-Identifier: MIT
"""The plant of the closed-loop tests: by its energy, and its statics by differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.plant.loop import FREE, KERNELS, Q0, Loop

RANDOM = np.random.default_rng(3)


@pytest.fixture(scope="module")
def loop(robot_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Loop:
    return Loop(tmp_path_factory.mktemp("free"), robot_folder, FREE, KERNELS)


@pytest.mark.slow
def test_energy_of_a_free_motion(loop: Loop) -> None:
    """A throw at 1 to 2 rad/s for two seconds without motor inertia: energy kept to 1e-8 J.

    The rest is the differences of the mass matrix in the Coriolis forces; the integrator alone would do better.
    """
    episode = loop.episode(motor=0.0, v=[1.2, -1.0, 1.5, 1.1, -2, 1.5, 2])
    summary = loop.run(2000, [loop.segment()], episode)
    assert summary.wander > 0.5
    assert abs(summary.energy_error) < 1e-8 < 0.1 * summary.kinetic


@pytest.mark.slow
def test_work_of_load_clamp_hand_and_stops(loop: Loop) -> None:
    """Load, push, clamp and stop the simulated arm: the energy balance holds to 1e-3, as a stop is a kink."""
    episode = loop.episode(stop_stiffness=2e4, stop_damping=50.0, substeps=10)
    parts = loop.segments(
        {"load": [5, -8, 10, 1, -1, 2], "push": [0, 5, 0, -5, 0, 1, 1]},
        {"start": 400, "hand_stiffness": 200.0, "hand_damping": 20.0, "hand_target": Q0 + 0.3},
        {"start": 900, "hand_stiffness": 0.0, "push": [0, 0, 0, 0, 0, 30, 30]},
        {"start": 1500, "clamp": 1, "load": 0.0, "push": 0.0},
    )
    summary, rows = loop.run(2500, parts, episode, rows=True)
    assert rows["q"][:, 5].max() > 2.0943951023931953, "the stop was not touched"  # 120 deg
    assert rows["kinetic"].max() > 3  # [J]
    assert abs(summary.energy_error) < 1e-3 * rows["kinetic"].max()
    assert summary.port == 0.0


def test_statics(loop: Loop) -> None:
    """Compare the spring's gradient with differences of its energy; at rest it balances the load."""
    A, B = RANDOM.normal(size=(3, 3)), RANDOM.normal(size=(3, 3))
    springs = loop.springs(Q0, 300 * np.eye(3) + 50 * A @ A.T, 20 * np.eye(3) + 5 * B @ B.T, 2.0)
    q = Q0 + RANDOM.uniform(-0.6, 0.6, 7)
    differences = [(springs.energy(q + d) - springs.energy(q - d)) / 2e-6 for d in 1e-6 * np.eye(7)]
    assert np.abs(springs.gradient(q) - differences).max() < 1e-6
    load = np.array([10.0, -5, -20, 1, 2, -1])  # [N], [N m]
    found = springs.rest(load, np.zeros(7))
    assert found is not None
    assert np.abs(springs.gradient(found[0]) - loop.jacobian(found[0]).T @ load).max() < 1e-9
    assert np.abs(found[0] - Q0).max() > 0.01  # [rad] it gives way
