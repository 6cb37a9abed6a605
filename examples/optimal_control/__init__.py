# SPDX-License-Identifier: MIT
"""Postures and task stiffnesses for wanted joint stiffnesses, along the bowl trajectory: ``make optimal-control``."""
