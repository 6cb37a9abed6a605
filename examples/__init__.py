# SPDX-License-Identifier: MIT
"""Examples; run them from the repository's root."""
