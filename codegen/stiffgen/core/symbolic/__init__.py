# SPDX-License-Identifier: MIT
"""Derivation of the kernel table from a chain."""
