# SPDX-License-Identifier: MIT
"""Family contacts: totals over several tips."""
