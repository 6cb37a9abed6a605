# SPDX-License-Identifier: MIT
"""The family contacts: records, programs, oracles, draws."""
