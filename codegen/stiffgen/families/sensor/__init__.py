# SPDX-License-Identifier: MIT
"""The family sensor: records, programs, oracles, draws."""
