# SPDX-License-Identifier: MIT
"""A file becomes a chain."""
