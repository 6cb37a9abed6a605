# SPDX-License-Identifier: MIT
"""Estimate a robot's sensor properties from a recording at a standstill, for the controller's configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stiffgen.core.errors import RecordingError

_FEWEST = 200
_LARGEST_MOTION = 0.01
"""[rad or m] motion of a joint beyond which the recording is none at a standstill."""


@dataclass(frozen=True)
class SensorProperties:
    """Configuration fields of the controller that describe the sensors; ``text`` is the configuration to paste."""

    position_quantum: float
    velocity_noise: float

    @property
    def fields(self) -> dict[str, float]:
        """Configuration fields by name."""
        return {"position_quantum": self.position_quantum, "velocity_noise": self.velocity_noise}

    @property
    def text(self) -> str:
        """Configuration in Python, with units."""
        q, dq = (float(f"{value:.3g}") for value in self.fields.values())
        return f"position_quantum={q!r},  # [rad or m]\nvelocity_noise={dq!r},  # [rad/s or m/s]"


def estimate_sensors(q: ArrayLike, dq: ArrayLike) -> SensorProperties:
    """Estimate quantum and noise of the measured states of an arm that stands still.

    Args:
        q: measured joint positions (samples, joints) [rad or m].
        dq: measured joint velocities (samples, joints) [rad/s or m/s].

    Returns:
        The properties. ``velocity_noise`` is the standard deviation or the resolution of dq, the larger one, of the
        worst joint. A quantum that does not show, because q does not change, is 0.

    Raises:
        RecordingError: shapes differ, samples are too few or not finite, or the arm moves.

    """
    position, velocity = np.array(q, dtype=float, ndmin=2), np.array(dq, dtype=float, ndmin=2)
    if position.shape != velocity.shape or len(position) < _FEWEST or not np.isfinite([position, velocity]).all():
        raise RecordingError(
            f"q {position.shape} and dq {velocity.shape} must be finite, of the same shape and have at least {_FEWEST} "
            "samples"
        )
    motion = np.ptp(position, axis=0)
    if motion.max() > _LARGEST_MOTION:
        raise RecordingError(
            f"joint {int(motion.argmax())} moves by {motion.max():.2g} rad or m: record the arm at a standstill"
        )
    noise = max(_mean_deviation(velocity), _resolution(velocity))
    return SensorProperties(_resolution(position), noise)


def _mean_deviation(velocity: NDArray[np.float64]) -> float:
    """Return the largest root mean square of a joint's velocity; a bias counts as noise."""
    return float(np.sqrt(np.mean(velocity**2, axis=0)).max())


def _resolution(values: NDArray[np.float64]) -> float:
    """Return the smallest step between values of a joint, if most steps are whole multiples of it; 0 without steps."""
    found = 0.0
    for column in values.T:
        steps = np.diff(np.unique(column))
        steps = steps[steps > 1e-9 * max(1.0, np.abs(column).max())]
        if not len(steps) or len(steps) > len(column) / 4:  # no change, or no grid
            continue
        step = steps.min()
        multiples = steps / step
        if np.mean(np.abs(multiples - np.round(multiples)) < 0.1) > 0.9:
            found = max(found, float(step))
    return found
