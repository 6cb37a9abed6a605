# SPDX-License-Identifier: MIT
"""Press: a force along an axis, held with a sensor's wrench."""
