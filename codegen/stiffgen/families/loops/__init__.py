# SPDX-License-Identifier: MIT
"""The family loops: records, programs, oracles, draws."""
