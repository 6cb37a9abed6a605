# SPDX-License-Identifier: MIT
"""The FRI client in C++, the robot's side of FRI in Python, and their tests."""
