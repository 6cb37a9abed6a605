# SPDX-License-Identifier: MIT
"""Family record: manipulability and its gradient."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.manipulability.kernels import manipulability_kernels

FAMILY = Family(
    kernels={"tip, first": lambda of: manipulability_kernels(of.seen_from_tip)},
    oracles="manipulability.oracles",
)
