# SPDX-License-Identifier: MIT
"""Settle: no error at rest, by an integral that moves the commanded pose."""
