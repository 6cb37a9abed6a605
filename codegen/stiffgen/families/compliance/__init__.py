# SPDX-License-Identifier: MIT
"""Family compliance: compliance of a loaded tip."""
