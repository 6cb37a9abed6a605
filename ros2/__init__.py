# SPDX-License-Identifier: MIT
"""The ros2_control package, stubs of its interfaces, and its tests."""
