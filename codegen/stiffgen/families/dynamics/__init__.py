# SPDX-License-Identifier: MIT
"""Family dynamics: mass matrix, bias forces, gravity."""
