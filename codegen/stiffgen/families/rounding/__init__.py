# SPDX-License-Identifier: MIT
"""Certified bounds on rounding errors: found from the printed statements, stated in the header, verified."""
