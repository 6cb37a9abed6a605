# SPDX-License-Identifier: MIT
"""The family springs: records, programs, oracles, draws."""
