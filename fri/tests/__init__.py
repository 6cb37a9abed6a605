# SPDX-License-Identifier: MIT
"""Tests of the FRI client and of the robot's side."""
