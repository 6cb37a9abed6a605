# SPDX-License-Identifier: MIT
"""The paper's bowl-wiping experiment in simulation; ``python -m examples.bowl_wiping`` runs it."""
