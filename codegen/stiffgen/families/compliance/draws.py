# SPDX-License-Identifier: MIT
"""Random stiffnesses of springs in the joints."""

from __future__ import annotations

import math

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.quantities import Sampling, symmetric


def stiff_springs(to: Sampling) -> FloatArray:
    """Draw symmetric stiffnesses of springs in the joints that hold the robot under the wrenches drawn for its tips."""
    # Wrenches of 30 N and 10 N m (arguments.wrench) at this reach [m] have less stiffness than these springs.
    reach = sum(float(np.linalg.norm(joint.translation)) for joint in to.chain.joints)
    scale = (300.0 + 300.0 * reach) * max(len(to.chain.tips), 1)
    coupling = symmetric(to) * (0.5 / math.sqrt(to.shape[0]))
    return np.asarray(scale * (coupling + np.eye(to.shape[0]) * to.random.uniform(1.0, 4.0, to.size)))
