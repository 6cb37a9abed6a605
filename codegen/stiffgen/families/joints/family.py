# SPDX-License-Identifier: MIT
"""Family record: potentials of the joints."""

from __future__ import annotations

from dataclasses import replace

from stiffgen.core.family import Family
from stiffgen.families.joints.kernels import JOINT_POTENTIAL_KERNELS

FAMILY = Family(
    kernels={"joints": lambda of: (replace(each, of_coordinates=True) for each in JOINT_POTENTIAL_KERNELS)},
    oracles="joints.oracles",
)
