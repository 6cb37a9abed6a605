# SPDX-License-Identifier: MIT
"""Analyse a quadruped on four contact springs: stability, modes, and torques of the legs."""
