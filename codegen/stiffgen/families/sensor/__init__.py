# SPDX-License-Identifier: MIT
"""Family sensor: force-torque sensor."""
