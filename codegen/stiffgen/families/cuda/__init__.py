# SPDX-License-Identifier: MIT
"""CUDA: batches of kernels, one configuration per thread."""
