# SPDX-License-Identifier: MIT
"""Family record: bounds on the tangents of springs, for implicit steps."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.springs.tangents import tangent_kernels

FAMILY = Family(kernels={"request": lambda of: tangent_kernels(of.chain, of.springs)})
