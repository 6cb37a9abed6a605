# SPDX-License-Identifier: MIT
"""Families of kernels: records and programs side by side; the table takes them in order."""
