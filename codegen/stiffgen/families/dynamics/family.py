# SPDX-License-Identifier: MIT
"""Family record: mass matrix, bias forces, gravity."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.dynamics.kernels import dynamics_kernels

FAMILY = Family(
    kernels={"tree": lambda of: dynamics_kernels(of.tips, runtime_tool=of.runtime_tool, floating=of.floating)},
    oracles="dynamics.oracles",
)
