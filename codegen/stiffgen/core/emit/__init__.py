# SPDX-License-Identifier: MIT
"""Kernel table -> files: C source and header, NumPy ufunc module, CMake package, Python package, manifest."""
