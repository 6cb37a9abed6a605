# SPDX-License-Identifier: MIT
"""PyTorch: differentiable functions of tensors."""
