# SPDX-License-Identifier: MIT
"""Stiffness passport of a robot: what its tip can render at a rate, a delay and an encoder, posture by posture."""
