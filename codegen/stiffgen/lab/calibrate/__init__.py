# SPDX-License-Identifier: MIT
"""Calibration of a force-torque sensor from a recording: bias, payload, intervals, and a check with a known weight."""
