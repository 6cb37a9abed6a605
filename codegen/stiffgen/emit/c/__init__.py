# SPDX-License-Identifier: MIT
"""Print kernels as C functions."""

from stiffgen.emit.c.functions import CFunction, VariantCode, print_kernels
from stiffgen.emit.c.printer import kernel_suffix as suffix_of
from stiffgen.lower.form import Scope

__all__ = ["CFunction", "Scope", "VariantCode", "print_kernels", "suffix_of"]
