# SPDX-License-Identifier: MIT
"""Check signs, frames and a calibration with a known weight that hangs at a known point of the tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import RecordingError
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.calibrate.calibration import Calibration
from stiffgen.lab.calibrate.poses import StandingPoses

_SHARE = 0.05
"""Largest error of the force as a share of the weight."""
_ARM = 0.01
"""[m] Largest error of the moment as an arm of the weight."""

Source = Literal["sensor", "external torque", "either"]
"""Source of wrenches: a force-torque sensor, the joints' external torques, or one of the two."""


class _Remedies(NamedTuple):
    """Places to look at if the moment alone, the sign, the direction or the size of the force is wrong."""

    moment: str
    sign: str
    direction: str
    size: str


_REMEDIES: dict[Source, _Remedies] = {
    "sensor": _Remedies(
        "--sensor xyz, the tip's link, and the point of the weight",
        "--sensor sign",
        "--sensor rpy and the joints' order",
        "the payload, the bias and the sensor's scale",
    ),
    "external torque": _Remedies(
        "the tip's link, --tool xyz, and the point of the weight",
        "the FRI client's --external-torque-sign",
        "the joints' order and the signs of single joints",
        "the robot's load data and the external torque's offset",
    ),
}
"""Remedies by the source of the wrenches, in words that follow "look at"."""


@dataclass(frozen=True)
class WeightCheck:
    """Wrenches at the tip under a known weight: measured and expected (P, 6) [N, N m], weight [N], and source."""

    measured: FloatArray
    expected: FloatArray
    weight: float
    source: Source = "sensor"

    @property
    def force_errors(self) -> FloatArray:
        """Largest error of the force at each pose, as a share of the weight."""
        return np.asarray(np.linalg.norm((self.measured - self.expected)[:, :3], axis=1) / self.weight)

    @property
    def moment_errors(self) -> FloatArray:
        """Largest error of the moment at each pose, as an arm of the weight [m]."""
        return np.asarray(np.linalg.norm((self.measured - self.expected)[:, 3:], axis=1) / self.weight)

    @property
    def passed(self) -> bool:
        """Whether the force is within 5 % of the weight, and the moment within 10 mm of arm, at every pose."""
        return bool(self.force_errors.max() <= _SHARE and self.moment_errors.max() <= _ARM)

    def findings(self) -> list[str]:
        """Return what was found in sentences, with the fault that explains it best."""
        lines = [
            f"force: within {100 * self.force_errors.max():.1f} % of the weight (allowed: {100 * _SHARE:g} %)",
            f"moment: within {1000 * self.moment_errors.max():.1f} mm of arm (allowed: {1000 * _ARM:g} mm)",
        ]
        if self.passed:
            return lines
        mean, wanted = self.measured[:, :3].mean(axis=0), self.expected[:, :3].mean(axis=0)
        down = float(mean @ wanted) / self.weight**2  # share of the weight along its direction: 1 if all is right
        if self.force_errors.max() <= _SHARE:
            lines.append("the moment alone is wrong: " + self._remedy("moment"))
        elif down < -0.5:
            lines.append("the force points up: " + self._remedy("sign"))
        elif float(np.linalg.norm(mean)) < 0.5 * self.weight or down < 0.8:
            lines.append("the force does not point down at all poses: " + self._remedy("direction"))
        else:
            lines.append("the force has the wrong size: " + self._remedy("size"))
        return lines

    def _remedy(self, wrong: str) -> str:
        """Return where to look, for each source that the wrenches may have."""
        if self.source != "either":
            return f"look at {getattr(_REMEDIES[self.source], wrong)}"
        return "; ".join(f"wrenches of the {name}: look at {getattr(each, wrong)}" for name, each in _REMEDIES.items())


def check_weight(
    sensor: Any,
    pose: Any,
    poses: StandingPoses,
    calibration: Calibration,
    mass: float,
    at: ArrayLike,
    gravity: ArrayLike,
) -> WeightCheck:
    """Compare the wrenches at the tip from a sensor's readings with a known weight.

    Args:
        sensor: functions of the sensor.
        pose: forward kinematics of the tip.
        poses: poses at rest with the weight.
        calibration: of the sensor without the weight.
        mass: of the weight [kg].
        at: point of the tip at which the weight hangs (3) [m].
        gravity: acceleration of free fall in base axes (3) [m/s^2].

    Raises:
        RecordingError: there is no pose, or no weight.

    """
    bias, payload = np.array(calibration.bias), np.array(calibration.payload)
    wrenches = sensor.tip_wrench(poses.q, poses.reading, bias, payload)
    return check_wrenches(pose, StandingPoses(poses.q, wrenches, poses.time), mass, at, gravity, source="sensor")


def check_wrenches(
    pose: Any, poses: StandingPoses, mass: float, at: ArrayLike, gravity: ArrayLike, *, source: Source
) -> WeightCheck:
    """Compare hybrid wrenches at the tip, in place of the poses' readings, with a known weight.

    ``source`` is where the wrenches come from: it decides which remedies the findings name. The other arguments and the
    errors are those of :func:`check_weight`.
    """
    if not len(poses):
        raise RecordingError("the robot stands still at no pose; hold each for a second or more")
    force = mass * np.asarray(gravity, dtype=float)
    weight = float(np.linalg.norm(force))
    if not weight > 0:
        raise RecordingError("--check: the weight must have a positive mass")
    arm = pose(poses.q)[:, :3, :3] @ np.asarray(at, dtype=float)
    expected = np.concatenate([np.broadcast_to(force, arm.shape), np.cross(arm, force)], axis=1)
    return WeightCheck(poses.reading, expected, weight, source)
