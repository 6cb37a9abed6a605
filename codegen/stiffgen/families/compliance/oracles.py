# SPDX-License-Identifier: MIT
"""Oracles of the compliance."""

from stiffgen.families.compliance.reference import COMPLIANCE_ORACLES as ORACLES  # noqa: F401
