# SPDX-License-Identifier: MIT
"""Estimate the joints' sliding friction from a slow motion there and back, for the controller's coulomb_friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stiffgen.core.errors import RecordingError
from stiffgen.lab.quantiles import student_quantile

_PARTS = 20
"""Parts of a joint's way; the outer ones, where the joint turns back, are left out."""
_LEAST_WAY = 0.1
"""[rad or m] way of a joint below which elastic joints hide its friction."""
_FASTEST = 0.3
"""[rad/s or m/s] beyond which viscous friction and inertia are no longer small."""
_APART = 0.1
"""[rad or m] between the postures on both ways: what remains of gravity must be the same."""
_SHARE = 0.9
"""Share of the friction that is fed forward: more makes the arm run ahead of its reference."""
_BLOCKS = 4
"""Blocks of the way whose means the interval is of: long ones, so that errors that last count once in each."""
_TAIL = 0.05
"""Probability that a mean lies outside its interval."""


@dataclass(frozen=True)
class JointFriction:
    """Sliding friction of each joint [N m or N]: the mean along its way, and the smallest and largest of its parts.

    ``half_width`` is that of the mean's 95 % interval, by Student's t from the means of four blocks of the way. Noise,
    errors that last for less than a block, and friction that varies along the way widen it. A bias that both directions
    share cancels; one that follows the direction, such as viscous friction, is part of the mean.
    ``fields`` and ``text`` are the configuration: 90 % of the mean.
    """

    mean: NDArray[np.float64]
    smallest: NDArray[np.float64]
    largest: NDArray[np.float64]
    half_width: NDArray[np.float64]

    @property
    def fields(self) -> dict[str, NDArray[np.float64]]:
        """Configuration fields by name; a joint whose friction does not show has 0."""
        return {"coulomb_friction": _SHARE * np.maximum(self.mean, 0.0)}

    @property
    def text(self) -> str:
        """Configuration in Python, with units."""
        values = [float(f"{value:.3g}") for value in self.fields["coulomb_friction"]]
        return f"coulomb_friction={values!r},  # [N m or N]"


def estimate_friction(q: ArrayLike, dq: ArrayLike, torque: ArrayLike) -> JointFriction:
    """Estimate the sliding friction of joints that move slowly there and back on one path, at most 0.3 rad/s.

    At the same posture the torque of the way there has friction with one sign, that of the way back with the other, and
    the same gravity: half of their difference is the friction, with the viscous one at this speed.

    Args:
        q: measured joint positions (samples, joints) [rad or m]; several joints, or all, may move at once.
        dq: measured joint velocities (samples, joints) [rad/s or m/s].
        torque: torque of the motors (samples, joints) [N m or N], commanded or from their current. A torque sensor
            behind the gear does not see the gear's friction. Subtract the model's ``gravity_torque``: joints lag,
            so that postures on both ways differ a little, and gravity with them.

    Returns:
        The friction.

    Raises:
        RecordingError: shapes differ or entries are not finite; a joint moves less than 0.1 rad, faster than 0.3 rad/s,
            or not there and back on one path.

    """
    position, velocity, effort = (np.array(each, dtype=float, ndmin=2) for each in (q, dq, torque))
    if not position.shape == velocity.shape == effort.shape or not np.isfinite([position, velocity, effort]).all():
        raise RecordingError(
            f"q {position.shape}, dq {velocity.shape} and torque {effort.shape} must be finite, of one shape"
        )
    # half differences along the path (joints, places) [N m]; the scatter of means of blocks gives the interval
    parts = np.array([_halves(position, velocity, effort, joint) for joint in range(position.shape[1])])
    blocks = parts.reshape(len(parts), _BLOCKS, -1).mean(axis=2)
    wide = student_quantile(_BLOCKS - 1, _TAIL) / np.sqrt(_BLOCKS)
    return JointFriction(parts.mean(axis=1), parts.min(axis=1), parts.max(axis=1), wide * blocks.std(axis=1, ddof=1))


def _halves(
    q: NDArray[np.float64], dq: NDArray[np.float64], torque: NDArray[np.float64], joint: int
) -> NDArray[np.float64]:
    """Return half of the difference of a joint's torque between both ways, for each part of its way."""
    own, speed = q[:, joint], dq[:, joint]
    low, way = float(own.min()), float(np.ptp(own))
    typical = float(np.quantile(np.abs(speed), 0.9))
    if way < _LEAST_WAY or typical > _FASTEST:
        raise RecordingError(
            f"joint {joint} moves by {way:.2g} rad or m at {typical:.2g} per s: "
            f"at least {_LEAST_WAY}, at most {_FASTEST}"
        )
    part = np.minimum(((own - low) / way * _PARTS).astype(int), _PARTS - 1)
    halves = []
    for index in range(2, _PARTS - 2):  # without both ends of the way, where the joint turns round
        there, back = ((part == index) & (side * speed > 0.3 * typical) for side in (1.0, -1.0))
        if not there.any() or not back.any():
            raise RecordingError(
                f"joint {joint} does not go there and back: some of its way was taken in one direction"
            )
        apart = float(np.abs(q[there].mean(axis=0) - q[back].mean(axis=0)).max())
        if apart > _APART:
            raise RecordingError(
                f"joint {joint}: postures there and back are {apart:.2g} rad or m apart; use one path, held stiffly"
            )
        halves.append(_half(own, torque[:, joint], there, back))
    return np.array(halves)


def _half(
    own: NDArray[np.float64], torque: NDArray[np.float64], there: NDArray[np.bool_], back: NDArray[np.bool_]
) -> float:
    """Return half of the difference of the mean torques, at one position: samples of both ways differ a little."""
    x = [own[rows] - own[rows].mean() for rows in (there, back)]
    size = float(sum((each**2).sum() for each in x))
    work = float(sum((each * torque[rows]).sum() for each, rows in zip(x, (there, back), strict=True)))
    slope = work / size if size > 0 else 0.0
    apart = float(own[there].mean() - own[back].mean())
    return 0.5 * (float(torque[there].mean() - torque[back].mean()) - slope * apart)
