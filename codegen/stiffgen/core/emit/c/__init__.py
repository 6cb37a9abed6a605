# SPDX-License-Identifier: MIT
"""Print kernels as C functions."""

from stiffgen.core.emit.c.functions import CFunction, VariantCode, print_kernels
from stiffgen.core.emit.c.printer import kernel_suffix as suffix_of
from stiffgen.core.lower.form import Scope

__all__ = ["CFunction", "Scope", "VariantCode", "print_kernels", "suffix_of"]
