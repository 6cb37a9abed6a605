# SPDX-License-Identifier: MIT
"""Verify a robot's folder against independent references."""
