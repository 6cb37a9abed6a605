# SPDX-License-Identifier: MIT
"""Derivation of a chain from a URDF file."""
