# SPDX-License-Identifier: MIT
"""Values of the kernels against independent sources: oracles by name, samples from the arguments, rounding."""
