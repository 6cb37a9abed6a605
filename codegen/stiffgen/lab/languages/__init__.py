# SPDX-License-Identifier: MIT
"""A folder's other languages (C++, NAME_sensor.h, CasADi, PyTorch, JAX), run beside the C functions."""
