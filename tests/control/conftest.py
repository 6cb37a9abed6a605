# SPDX-License-Identifier: MIT
"""The controller in the loop with a simulated arm."""

from support.plant.fixture import loop

__all__ = ["loop"]
