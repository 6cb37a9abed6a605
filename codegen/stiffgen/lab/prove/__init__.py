# SPDX-License-Identifier: MIT
"""Prove properties of a generated folder's C for all inputs: ``stiffgen prove DIR``. docs/proofs.md lists them."""
