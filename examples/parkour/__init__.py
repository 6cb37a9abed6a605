# SPDX-License-Identifier: MIT
"""The paper's parkour experiment in simulation; ``python -m examples.parkour`` runs it."""
