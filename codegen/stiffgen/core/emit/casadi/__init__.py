# SPDX-License-Identifier: MIT
"""CasADi: external functions with derivatives."""
