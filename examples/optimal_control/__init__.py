# SPDX-License-Identifier: MIT
"""Optimise configurations and task stiffnesses along the bowl trajectory: ``make optimal-control``."""
