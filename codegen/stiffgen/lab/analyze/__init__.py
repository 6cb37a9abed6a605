# SPDX-License-Identifier: MIT
"""A recording becomes a report."""
