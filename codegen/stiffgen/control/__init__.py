# SPDX-License-Identifier: MIT
"""The impedance controller: a C library, the tables of its fields, its templates, and the sessions that verify it."""
