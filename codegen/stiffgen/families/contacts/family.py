# SPDX-License-Identifier: MIT
"""Family record: totals over several tips."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.contacts.kernels import total_kernels

FAMILY = Family(kernels={"totals": lambda of: total_kernels(of.chain, of.kernels, of.springs)})
