# SPDX-License-Identifier: MIT
"""The family compliance: records, programs, oracles, draws."""
