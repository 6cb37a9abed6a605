# SPDX-License-Identifier: MIT
"""Random values of closed configurations."""

from __future__ import annotations

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.quantities import NEAR, Sampling


def near_start(to: Sampling) -> FloatArray:
    """Draw positions of the motors near the closed configuration where the robot starts."""
    return np.array(to.chain.start)[list(to.chain.actuated)] + to.random.uniform(-NEAR, NEAR, to.size)


def at_start(to: Sampling) -> FloatArray:
    """Return the closed configuration where the robot starts."""
    return np.tile(to.chain.start, (to.count, 1))
