# SPDX-License-Identifier: MIT
"""Register the impedance controller at robosuite's extension point, and lift a cube with it."""
