# SPDX-License-Identifier: MIT
"""C++: a header over the C functions."""
