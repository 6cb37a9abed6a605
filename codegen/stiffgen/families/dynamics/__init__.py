# SPDX-License-Identifier: MIT
"""The family dynamics: records, programs, oracles, draws."""
