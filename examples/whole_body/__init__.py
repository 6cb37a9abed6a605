# SPDX-License-Identifier: MIT
"""A quadruped on four contact springs: how it stands, how it sways, and what its legs must do."""
