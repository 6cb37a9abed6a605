# SPDX-License-Identifier: MIT
"""URDF to kernels: chain, connection, programs, lowering, printing, verification."""
