# SPDX-License-Identifier: MIT
"""The family manipulability: records, programs, oracles, draws."""
