# SPDX-License-Identifier: MIT
"""Family record: potentials of the tip."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.springs.kernels import spring_kernels

FAMILY = Family(
    kernels={"tip": lambda of: (each for spring in of.springs for each in spring_kernels(spring, of.configuration))},
    oracles="springs.oracles",
)
