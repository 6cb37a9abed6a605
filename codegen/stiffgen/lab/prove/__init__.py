# SPDX-License-Identifier: MIT
"""Prove properties of a generated folder's C for all inputs: ``stiffgen prove DIR``. docs/guarantees.md lists them."""
