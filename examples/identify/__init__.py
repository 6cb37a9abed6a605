# SPDX-License-Identifier: MIT
"""Identify an arm's stiffness at the tool, and the tool's position, from a recording."""
