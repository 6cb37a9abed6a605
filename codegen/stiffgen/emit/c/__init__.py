# SPDX-License-Identifier: MIT
"""Print kernels as C functions."""

from stiffgen.emit.c.functions import CFunction, Scope, VariantCode, print_kernels, suffix_of

__all__ = ["CFunction", "Scope", "VariantCode", "print_kernels", "suffix_of"]
