# SPDX-License-Identifier: MIT
"""Family record: closed loops in motor coordinates."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.loops.kernels import motor_kernels

FAMILY = Family(kernels={"motors": motor_kernels}, oracles="loops.oracles")
