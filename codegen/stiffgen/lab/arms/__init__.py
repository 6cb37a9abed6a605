# SPDX-License-Identifier: MIT
"""NumPy functions about loaded arms."""
