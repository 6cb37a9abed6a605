# SPDX-License-Identifier: MIT
"""Wrenches at a tip from a force-torque sensor's reading with 60 digits: forces on the payload's particles.

Six particles carry a payload's mass, first moment and inertia. Each has an acceleration from second differences of its
position, and needs a force. The sensor's place comes from the text of its options.
"""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

from stiffgen.core.robot.chain import Chain, Sensor
from support.exact_kernels import ExactRobot, Given, cross, matrix
from support.exact_tree import STEP, Pose, as_array, exact_pose, mp, turn

Particles = list[tuple[mpmath.mpf, mpmath.matrix]]


def _rotation(rpy: Any) -> mpmath.matrix:
    roll, pitch, yaw = (mp.mpf(float(angle)) for angle in rpy)
    return turn((0, 0, 1), yaw) * turn((0, 1, 0), pitch) * turn((1, 0, 0), roll)


def particles(payload: Any) -> Particles:
    """Return masses (of either sign) and places whose sums are the parameters: mass, first moment, inertia."""
    values = [*(mp.mpf(float(x)) for x in payload), *(10 - len(payload)) * [mp.mpf(0)]]
    mass, moment, (xx, xy, xz, yy, yz, zz) = values[0], values[1:4], values[4:]
    total = (xx + yy + zz) / 2
    second = mp.matrix([[total - xx, -xy, -xz], [-xy, total - yy, -yz], [-xz, -yz, total - zz]])
    found, unit = [(mass, mp.zeros(3, 1))], [mp.matrix([int(i == k) for i in range(3)]) for k in range(3)]
    for k in range(3):  # a pair at +-e_k has no mass but the first moment, or no first moment but a second one
        found += [(moment[k] / 2, unit[k]), (-moment[k] / 2, -unit[k])]
        for j in range(k, 3):
            weight = second[k, j] / 2
            arms = [unit[k], -unit[k]] if j == k else [unit[k] + unit[j], -unit[k] - unit[j]]
            found += [(weight, arm) for arm in arms] + [(-2 * weight, mp.zeros(3, 1))]
            if j > k:  # the pairs along the diagonal have added to the squares as well
                for axis in (k, j):
                    found += [(-weight, s * unit[axis]) for s in (1, -1)] + [(2 * weight, mp.zeros(3, 1))]
    return found


class ExactSensor:
    """Sensor of a tree at one sample of the arguments."""

    def __init__(self, text: str, chain: Chain, sensor: Sensor, tip: str, given: Given) -> None:
        self.robot, self.sensor, self.tip, self.given = ExactRobot.of(text, chain, given), sensor, tip, given
        self.sign = {"environment": 1, "robot": -1}[sensor.sign]
        self.gravity = matrix(sensor.gravity)

    def _pose(self, robot: ExactRobot) -> Pose:
        R, p = robot.pose(self.sensor.link)
        return R * _rotation(self.sensor.rpy), p + R * matrix(self.sensor.xyz)

    def _tip(self) -> mpmath.matrix:
        R, p = self.robot.pose(self.tip)
        tool = self.given.get("tool_pose")
        return p if tool is None else p + R * exact_pose(tool)[1]

    def _moved(self, time: mpmath.mpf) -> ExactRobot:
        rates, second = ([mp.mpf(float(x)) for x in self.given.get(name, ())] for name in ("velocity", "acceleration"))
        if not rates:
            return self.robot
        x = [rate * time + a * time**2 / 2 for rate, a in zip(rates, second, strict=True)]
        if self.robot.size > self.robot.tree.size:  # a twist (v, w) that is constant bends the path: dv/dt = w x v
            bend = cross(mp.matrix(rates[3:6])) * mp.matrix(rates[:3]) * time**2 / 2
            x[:3] = [a + b for a, b in zip(x[:3], bend, strict=True)]
        return self.robot.moved(x)

    def _payload(self) -> tuple[mpmath.matrix, mpmath.matrix]:
        """Return force and moment about the base's origin of weight less inertia of the payload."""
        poses = [self._pose(self._moved(s * STEP)) for s in (-1, 0, 1)]
        force, moment = mp.zeros(3, 1), mp.zeros(3, 1)
        for mass, place in particles(self.given["payload"]):
            before, now, after = (R * place + p for R, p in poses)
            load = mass * (self.gravity - (after - 2 * now + before) / STEP**2)
            force, moment = force + load, moment + cross(now) * load
        return force, moment

    def tip_wrench(self) -> np.ndarray:
        """Return the wrench of the environment at the tip."""
        (R, p), (weight, about_origin) = self._pose(self.robot), self._payload()
        net = self.sign * (matrix(self.given["reading"]) - matrix(self.given["bias"]))
        force = R * net[:3]
        moment = R * net[3:] + cross(p) * force - about_origin
        force = force - weight
        moment = moment - cross(self._tip()) * force
        return as_array(mp.matrix([*force, *moment])).ravel()

    def reading(self) -> np.ndarray:
        """Return the reading under a wrench at the tip."""
        (R, p), (weight, about_origin) = self._pose(self.robot), self._payload()
        force = matrix(self.given["wrench"][:3])
        moment = matrix(self.given["wrench"][3:]) + cross(self._tip()) * force + about_origin
        force = force + weight
        net = mp.matrix([*(R.T * force), *(R.T * (moment - cross(p) * force))])
        return as_array(matrix(self.given["bias"]) + self.sign * net).ravel()
