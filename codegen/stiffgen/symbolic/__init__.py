# SPDX-License-Identifier: MIT
"""A chain becomes the kernel table."""
