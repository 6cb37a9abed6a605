# SPDX-License-Identifier: MIT
"""The version, in a module of its own: generated files carry it."""

__version__ = "0.3.0"
