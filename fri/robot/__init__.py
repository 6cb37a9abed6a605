# SPDX-License-Identifier: MIT
"""Simulate a robot that speaks KUKA's Fast Robot Interface (FRI): an LBR iiwa 14 with its controller."""
