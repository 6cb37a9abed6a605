# SPDX-License-Identifier: MIT
"""Family record: gradients in reverse mode."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.derivatives.direction import direction_gradient_kernel
from stiffgen.families.derivatives.products import products

FAMILY = Family(
    kernels={
        "tip": lambda of: (direction_gradient_kernel(of.configuration),),
        "products": lambda of: products(of.kernels),
    },
    oracles="derivatives.oracles",
    lowering="derivatives.lowering",
)
