# SPDX-License-Identifier: MIT
"""Family record: compliance of a loaded tip."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.compliance.kernels import compliance_kernels, compliance_of_tip

FAMILY = Family(
    kernels={"request": compliance_kernels, "request, of one tip": lambda of: compliance_of_tip(of.configuration)},
    oracles="compliance.oracles",
)
