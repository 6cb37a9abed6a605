# SPDX-License-Identifier: MIT
"""Measure a task stiffness from recorded motions about a pose, and check the sensor by the paper's formula."""
