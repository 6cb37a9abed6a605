# SPDX-License-Identifier: MIT
"""Motors' numbers with their sources: the file's armature, else presets of the makers, else estimates."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from stiffgen.core.robot.chain import Chain

INERTIA_TIME = 0.005
"""Time [s] in which the estimated rotor reaches its velocity limit at the effort limit.

The known rotors of Franka need 0.012 to 0.09 s. An inertia that is too small only damps too little.
"""
RATE_TIME = 0.1
"""Time [s] in which the torque goes from zero to the effort limit, where the maker states no rate."""


@dataclass(frozen=True)
class Preset:
    """Motors' numbers of a robot: the pattern of its name, one number per joint each (none: unknown), and sources.

    Motor inertias in kg m^2 or kg, torque rates in N m/s or N/s.
    """

    pattern: str
    title: str
    motor_inertia: tuple[float, ...] = ()
    torque_rate: tuple[float, ...] = ()
    inertia_source: str = ""
    rate_source: str = ""


PRESETS = (
    Preset(
        r"(panda|fer|fr3)(_|v\d|$)",
        "Franka Panda, FER and FR3",
        (0.605721456, 0.605721456, 0.462474144, 0.462474144, 0.205544064, 0.205544064, 0.205544064),
        (1000.0,) * 7,
        "reflected inertias of the FR3, stated by Franka in the README of Drake's franka_description",
        "franka::kMaxTorqueRate, libfranka rate_limiting.h",
    ),
    Preset(r"(iiwa|lbr|med)_?(7|14|iiwa|med|$)", "KUKA LBR iiwa and med"),
    Preset(r"ur(3|5|7|8|10|12|15|16|20|30)(e|_|$)", "Universal Robots"),
    Preset(r"(j2|gen3|jaco|mico)", "Kinova Gen2 and Gen3"),
)


def find_preset(name: str) -> Preset | None:
    """Return the preset of a robot's name; None for an unknown robot."""
    return next((each for each in PRESETS if re.match(each.pattern, name.lower())), None)


def motor_tables(chain: Chain) -> Preset:
    """Return the preset of a chain, complete: with the file's numbers, the maker's, or estimates from the limits.

    The file comes first, since its armature is that of the user's simulation. An armature of 0 counts as unknown.
    """
    preset = find_preset(chain.robot) or Preset("", chain.robot)
    limits = [(c.effort, c.velocity) for c in chain.motor_coordinates]
    inertia, rate = preset.motor_inertia, preset.torque_rate
    inertia_source, rate_source = preset.inertia_source, preset.rate_source
    if len(inertia) != len(limits):
        inertia = tuple(_estimate(effort, velocity) for effort, velocity in limits)
        inertia_source = f"estimate: {INERTIA_TIME:g} s effort / velocity, the maker's is unknown"
    stated = [c.motor_inertia for c in chain.motor_coordinates]
    if any(stated):
        inertia = tuple(own or other for own, other in zip(stated, inertia, strict=True))
        inertia_source = "armature of the file" + ("" if all(stated) else f"; where it is 0, {inertia_source}")
    if len(rate) != len(limits):
        rate = tuple(effort / RATE_TIME for effort, _ in limits)
        rate_source = f"estimate: effort / {RATE_TIME:g} s, the maker's is unknown"
    return Preset(preset.pattern, preset.title, inertia, rate, inertia_source, rate_source)


def _estimate(effort: float, velocity: float) -> float:
    """Estimate a motor's inertia, to four digits; 0 without limits."""
    known = math.isfinite(effort) and math.isfinite(velocity)
    return float(f"{INERTIA_TIME * effort / velocity:.4g}") if known else 0.0
