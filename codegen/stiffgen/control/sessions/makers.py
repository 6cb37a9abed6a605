# SPDX-License-Identifier: MIT
"""Compare two builds of Settle and Press: streams of poses, sensors and outputs of the controller, some of them bad."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from stiffgen.control.core.config import STATED
from stiffgen.control.core.signals import OUTPUT
from stiffgen.control.sessions.library import fill, struct_of
from stiffgen.core.robot.chain import Chain

STREAMS, STEPS = 12, 60
_CONFIG_SIZE = 1 << 14
"""Bytes of memory for the controller's configuration: more than the largest robot needs."""
_BAD = (math.nan, math.inf, -1.0, 1e300)


class _Maker:
    """Maker of commands before a controller that says anything; one draw is given to all builds."""

    def __init__(self, name: str, random: np.random.Generator, chain: Chain) -> None:
        self.name, self.random, self.n = name, random, len(chain.motor_coordinates)
        self.stated, self.Output = struct_of(chain, "Stated", STATED), struct_of(chain, "Output", OUTPUT)
        self.lies = float(random.choice([0.0, 0.1]))
        self.q, self.pose = random.normal(size=self.n), np.eye(4)

    def start(self, both: Sequence[Any]) -> bool:
        """Begin with random settings, sometimes a bad one; return whether the builds are the same."""
        random, name = self.random, self.name
        delay = int(random.integers(0, 6))  # [samples]
        inertia, force = random.uniform(0.01, 1.0, self.n), random.uniform(0.0, 60.0, 2)
        inertia[0] = float(random.choice(_BAD)) if random.random() < self.lies else inertia[0]
        results: list[object] = []
        for each in both:
            controller = (ctypes.c_char * _CONFIG_SIZE)()
            each.call("impedance_default_config", controller)
            stated = self.stated.from_buffer(controller)  # the stated fields are the first ones of the configuration
            stated.sample_time, stated.delay_samples = 1e-3, delay
            fill(stated.motor_inertia, inertia)
            fill(stated.heaviest_wrench, (100.0, 20.0))
            each.call(f"{name}_default_config", f"{name}_config")
            if name == "settle":
                fill(each.structs["settle_config"].settle_force, force)
            code = each.call(f"{name}_init", f"{name}_config", controller, f"{name}_state")
            results.append((code, each.bits(f"{name}_state")))
        return results[0] == results[1]

    def step(self, both: Sequence[Any]) -> bool:
        """Do a step with drawn inputs, some of them lies (NaN, infinite, huge); return whether the builds have the
        same bits.
        """
        random, name = self.random, self.name
        axis = np.array([0.0, 0.6, -0.8])  # of pressing, a unit vector
        pose = self.pose.copy()
        pose[0, 3] += 1e-3 * random.integers(0, 2)  # [m] along x
        drawn = {
            "pose": pose,
            "translation_stiffness": random.uniform(0.0, 900.0) * np.eye(3),
            "rotation_stiffness": random.uniform(0.0, 40.0) * np.eye(3),
            "wrench": np.r_[-axis * random.choice([0.0, 6.0, 12.0]), np.zeros(3)],
        }
        place = str(random.choice(list(drawn)))
        if random.random() < self.lies:
            np.ravel(drawn[place])[0] = float(random.choice(_BAD))
        if name == "press":
            drawn["axis"] = axis * random.choice([1.0, 1.1], p=[0.95, 0.05])  # the longer one is refused
        flag, force = int(random.random() < 0.1), float(random.choice([0.0, 15.0], p=[0.05, 0.95]))
        last = self._last() if random.random() < 0.95 else None
        results: list[object] = []
        for each in both:
            given = each.structs[f"{name}_input"]
            for field, value in drawn.items():
                fill(getattr(given, field), value)
            if name == "press":
                given.search, given.force = flag, force
            else:
                given.hold = flag
            code = each.call(f"{name}_step", f"{name}_state", f"{name}_input", last, f"{name}_output")
            results.append((code, each.bits(f"{name}_output", f"{name}_state")))
        return results[0] == results[1]

    def _last(self) -> Any:
        """Return what the controller says: near a posture, with a status at times."""
        last = self.Output()
        fill(last.position, self.q + 1e-3 * self.random.normal(size=self.n))
        fill(last.reference, self.q)
        last.scale = 1.0
        last.status = int(self.random.random() < 0.1) << int(self.random.integers(0, 18))
        return last


def _is_same(name: str, both: Sequence[Any], random: np.random.Generator, chain: Chain) -> bool:
    for _ in range(STREAMS):
        maker = _Maker(name, random, chain)
        if not maker.start(both) or not all(maker.step(both) for _ in range(STEPS)):
            return False
    return True


SAME_MAKERS = {name: partial(_is_same, name) for name in ("settle", "press")}
"""Comparisons of two builds, of random numbers and a chain, by maker."""
