# SPDX-License-Identifier: MIT
"""Simulated recordings of an ATI Gamma with a tool: noise, quantum, bias, and a bias that drifts."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.calibrate.poses import StandingPoses

RATE = 200.0
"""[Hz]"""
NOISE = np.array([0.04, 0.04, 0.08, 0.002, 0.002, 0.002])
"""Standard deviations of one sample [N, N m]."""
QUANTUM = np.array([1 / 80, 1 / 80, 1 / 40, 1 / 2000, 1 / 2000, 1 / 2000])
"""Resolution of an ATI Gamma, SI-65-5 [N, N m]."""
PAYLOAD = np.array([1.3, 1.3 * 0.01, -1.3 * 0.02, 1.3 * 0.09])
"""Tool of 1.3 kg."""


@dataclass
class SimulatedSensor:
    """Sensor of a robot whose functions are ``sensor``; its bias moves by ``drift`` per second and walks at random."""

    sensor: Any
    random: np.random.Generator
    drift: FloatArray = field(default_factory=lambda: np.zeros(6))
    walk: float = 0.2
    """Standard deviation of the random walk after a minute, in units of NOISE."""

    def __post_init__(self) -> None:
        self.bias = self.random.normal(size=6) * [10, 10, 20, 0.5, 0.5, 0.5]
        self.drift = self.random.normal(size=6) * NOISE * 2 / 60  # two sigma of noise per minute

    def record(self, q: FloatArray, time: FloatArray, payload: FloatArray = PAYLOAD) -> FloatArray:
        """Return the readings of a slow motion without contact."""
        steps = np.diff(time, prepend=time[:1])
        walk = np.cumsum(
            self.random.normal(size=(len(time), 6)) * (NOISE * self.walk * np.sqrt(steps / 60)[:, None]), 0
        )
        self.moved = self.bias + self.drift * time[:, None] + walk
        clean = self.sensor.reading(q, np.zeros(6), np.zeros(6), payload) + self.moved
        return np.asarray(np.round((clean + self.random.normal(size=clean.shape) * NOISE) / QUANTUM) * QUANTUM)

    def poses(self, q: FloatArray, seconds: float = 2.0) -> StandingPoses:
        """Return the poses of a recording that holds each posture for some seconds, with two between them."""
        samples = int(seconds * RATE)
        time = (np.arange(len(q))[:, None] * (seconds + 2) + np.arange(samples) / RATE).ravel()
        readings = self.record(np.repeat(q, samples, axis=0), time).reshape(len(q), samples, 6)
        self.end = self.moved.reshape(len(q), samples, 6)[-1].mean(axis=0)
        return StandingPoses(q, readings.mean(axis=1), time.reshape(len(q), -1).mean(axis=1))


def held(q: FloatArray, seconds: float = 1.2, between: float = 0.8) -> tuple[FloatArray, FloatArray]:
    """Return joint positions and time of a motion that holds each posture."""
    path = [q[:1].repeat(int(seconds * RATE), axis=0)]
    for before, after in itertools.pairwise(q):
        s = np.linspace(0, 1, int(between * RATE))[:, None]
        path += [before + (after - before) * s * s * (3 - 2 * s), after[None].repeat(int(seconds * RATE), axis=0)]
    found = np.concatenate(path)
    return found, np.arange(len(found)) / RATE
