# SPDX-License-Identifier: MIT
"""What a generated folder's C does for all inputs: ``stiffgen prove DIR``. docs/proofs.md says what is proved."""
