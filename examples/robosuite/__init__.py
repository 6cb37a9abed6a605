# SPDX-License-Identifier: MIT
"""Register the impedance controller at robosuite's extension point, and compare it with robosuite's own."""
