# SPDX-License-Identifier: MIT
"""Python: NumPy generalised ufuncs and the package around them."""
