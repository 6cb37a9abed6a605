# SPDX-License-Identifier: MIT
"""Recordings of a sensor on a spring about a pose: exact wrench of a trace spring, written without the package."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PERIODS = np.array([10, 12, 15, 21, 28, 29])


@dataclass(frozen=True)
class Spring:
    """Principal stiffness [N/m], [N m/rad], and amplitudes of the motion [m], [rad]."""

    translation: tuple[float, float, float]
    rotation: tuple[float, float, float]
    amplitude: tuple[float, float]


SOFT = Spring((800.0, 700.0, 500.0), (60.0, 40.0, 30.0), (2e-3, 20e-3))
STIFF = Spring((30e3, 25e3, 20e3), (600.0, 500.0, 400.0), (0.3e-3, 5e-3))
ISOTROPIC = Spring((700.0, 700.0, 700.0), (40.0, 40.0, 40.0), (2e-3, 20e-3))


def cross(a: Array) -> Array:
    """Return the matrices (..., 3, 3) of a x."""
    zero = np.zeros(a.shape[:-1])
    x, y, z = np.moveaxis(a, -1, 0)
    return np.stack([np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], -2)


def rotations(w: Array) -> Array:
    """Return the rotations (..., 3, 3) of rotation vectors."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    N = cross(w / np.maximum(np.linalg.norm(w, axis=-1, keepdims=True), 1e-300))
    return np.asarray(np.eye(3) + np.sin(angle) * N + (1 - np.cos(angle)) * N @ N)


def wrench(p: Array, R: Array, Kt: Array, Ko: Array) -> Array:
    """Return dU (..., 6) in body axes of U = p^T Kt p / 2 + tr(G (I - R)), G = tr(Ko) I / 2 - Ko."""
    G = np.trace(Ko) / 2 * np.eye(3) - Ko
    force = np.einsum("...ji,jk,...k->...i", R, Kt, p)
    M = G @ R
    return np.concatenate([force, np.stack([M[..., 2, 1] - M[..., 1, 2], M[..., 0, 2] - M[..., 2, 0],
                                            M[..., 1, 0] - M[..., 0, 1]], -1)], -1)  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """Sensor's error: turn [rad], lever [m], bias [N, N m]; ``delay`` [s] of the readings."""

    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    lever: tuple[float, ...] = (0.0, 0.0, 0.0)
    bias: tuple[float, ...] = (0.0,) * 6
    delay: float = 0.0


NO_FAULT = Fault()


def recorded(
    seed: int, spring: Spring = SOFT, fault: Fault = NO_FAULT, *, circle: bool = False, count: int = 1000,
    size: float = 1.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return time, poses (N, 4, 4) and readings (N, 6) of a loaded spring in random axes; ATI Gamma's noise."""
    random = np.random.default_rng(seed)
    Q, P = rotations(random.normal(size=(2, 3)))
    Kt, Ko = Q @ np.diag(spring.translation) @ Q.T, P @ np.diag(spring.rotation) @ P.T
    time = np.asarray(np.arange(count) * 0.02, dtype=np.float64)
    phase = random.uniform(0, 2 * np.pi, 6)
    rates = 2 * np.pi * random.permutation(PERIODS) / (0.02 * count)
    if circle:
        rates, phase = np.full(6, np.pi), np.array([0.0, 0.5, 1.0, 0.25, 0.75, 1.3]) * np.pi
    scale = size * np.repeat(spring.amplitude, 3)

    def pose(at: Array) -> tuple[Array, Array]:
        twist = scale * np.sin(rates * at[:, None] + phase)
        if circle:  # a small part that is no circle, so that all columns are there
            twist = twist + 0.3 * scale * np.sin(2 * np.pi * PERIODS / (0.02 * count) * at[:, None])
        start = np.linalg.solve(Kt, [20.0, 10.0, 5.0]), np.linalg.solve(Ko, [2.0, 1.0, 0.5])
        return start[0] + twist[:, :3], rotations(start[1]) @ rotations(twist[:, 3:])

    p, R = pose(time)
    F = wrench(*pose(np.asarray(time - fault.delay, dtype=np.float64)), Kt, Ko)
    F[:, 3:] -= np.cross(fault.lever, F[:, :3])
    axes = rotations(np.array(fault.turn)).T
    F = np.concatenate([F[:, :3] @ axes.T, F[:, 3:] @ axes.T], axis=1) + fault.bias
    F += random.normal(size=F.shape) * np.repeat([0.05, 0.002], 3)
    p = p + random.normal(size=p.shape) * 2e-5
    R = R @ rotations(random.normal(size=(count, 3)) * 2e-5)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = R, p
    return time, poses, F
