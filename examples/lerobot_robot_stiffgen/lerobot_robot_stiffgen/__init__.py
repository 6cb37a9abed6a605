# SPDX-License-Identifier: MIT
"""Plug-in for LeRobot: the robot ``stiffgen``, a simulated arm under stiffgen's impedance controller."""

from .arm import Stiffgen
from .config import StiffgenConfig

__all__ = ["Stiffgen", "StiffgenConfig"]
