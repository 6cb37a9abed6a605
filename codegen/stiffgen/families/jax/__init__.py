# SPDX-License-Identifier: MIT
"""JAX: calls for XLA with gradients."""
