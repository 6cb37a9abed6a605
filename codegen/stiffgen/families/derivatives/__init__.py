# SPDX-License-Identifier: MIT
"""The family derivatives: records, programs, oracles, draws."""
