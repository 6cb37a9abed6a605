# SPDX-License-Identifier: MIT
"""What takes a finished folder: measure, calibrate, prove, play."""
