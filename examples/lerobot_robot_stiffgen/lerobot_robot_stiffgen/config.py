# SPDX-License-Identifier: MIT
"""Configuration of the robot; the command line of LeRobot sets each field as ``--robot.FIELD=VALUE``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from lerobot.robots.config import RobotConfig


@RobotConfig.register_subclass("stiffgen")
@dataclass(kw_only=True)
class StiffgenConfig(RobotConfig):  # type: ignore[misc]
    """Settings of the arm, its springs and its policy port. SI units, radians."""

    robot: Path
    """Folder that ``stiffgen generate`` wrote, or a URDF or MJCF file, which is generated on first use."""
    model: Path | None = None
    """URDF or MJCF that MuJoCo simulates. Default: the file of ``robot``; a folder needs it."""
    tip: str | None = None
    """Link at the end of the chain, if ``robot`` is a file. Default: its only leaf."""
    base: str | None = None
    """Link at the start of the chain, if ``robot`` is a file. Default: its root."""
    start: list[float] = field(default_factory=lambda: [0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
    """Joint positions at the start, also the preferred posture [rad]. Default: a posture of an iiwa 14."""
    translation_stiffness: float = 800.0
    """Stiffness of the tip in every direction [N/m], where the action has none."""
    rotation_stiffness: float = 40.0
    """Stiffness of the tip about every axis [N m/rad], where the action has none."""
    variable_stiffness: bool = False
    """Whether actions have ``stiffness.translation`` and ``stiffness.rotation``."""
    motor_inertia: float = 0.1
    """Inertia of each rotor, seen at its joint, of simulation and controller [kg m^2]."""
    heaviest_force: float = 80.0
    """Heaviest force that the springs are to exert at the tip [N]; the reference stops there."""
    heaviest_moment: float = 15.0
    """Heaviest moment of the springs at the tip [N m]."""
    command_rate: float = 20.0
    """Actions per second [Hz]. Without real time, each action advances the simulation by its inverse."""
    validity: float = 0.3
    """Age up to which an action is held [s]; an older one is stale, and the springs fade."""
    fade_time: float = 0.5
    """Time in which the springs of a stale action fade to a tenth [s]."""
    real_time: bool = True
    """Whether the simulation follows the clock. If not, it advances with each action, as fast as it can."""

    def __post_init__(self) -> None:
        """Refuse rates [Hz], stiffnesses and times [s] out of range."""
        super().__post_init__()
        for name, most in (
            ("command_rate", 1000.0),
            ("translation_stiffness", math.inf),
            ("rotation_stiffness", math.inf),
        ):
            value = getattr(self, name)
            if not 0.0 < value <= most or math.isinf(value):
                raise ValueError(f"{name}: {value!r} must be positive, finite and at most {most:g}")
        for name in ("validity", "fade_time"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise ValueError(f"{name}: {getattr(self, name)!r} s does not lie between 0 and 10 s")
