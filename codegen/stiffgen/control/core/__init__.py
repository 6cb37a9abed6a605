# SPDX-License-Identifier: MIT
"""Core of the impedance controller: tables of its fields, C of its phases, and the page of its templates."""
