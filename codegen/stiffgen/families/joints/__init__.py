# SPDX-License-Identifier: MIT
"""The family joints: records, programs, oracles, draws."""
