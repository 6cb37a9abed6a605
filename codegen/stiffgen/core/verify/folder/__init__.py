# SPDX-License-Identifier: MIT
"""A folder as a whole: its files, its chain, its builds of every vector width, the memory that it touches."""
