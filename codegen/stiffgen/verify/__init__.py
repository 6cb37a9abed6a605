# SPDX-License-Identifier: MIT
"""A robot's folder is held against what did not make it."""
