# SPDX-License-Identifier: MIT
"""A robot that speaks FRI: the controller's side of KUKA's Fast Robot Interface, a simulated LBR iiwa 14 behind it."""
