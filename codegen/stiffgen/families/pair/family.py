# SPDX-License-Identifier: MIT
"""Family record: springs between two tips."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.pair.kernels import pair_kernels

FAMILY = Family(kernels={"pairs": pair_kernels}, oracles="pair.oracles")
