# SPDX-License-Identifier: MIT
"""Python: NumPy generalised ufuncs and the package around them."""

from pathlib import Path

WRAPPERS = Path(__file__).parent / "wrappers"
"""Folder of the wrappers for CasADi, JAX and PyTorch, which are the same for every robot."""
