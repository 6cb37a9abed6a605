# SPDX-License-Identifier: MIT
"""Family record: force-torque sensor."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.families.sensor.kernels import sensor_kernels

FAMILY = Family(
    kernels={"tip": lambda of: sensor_kernels(of.configuration, of.sensor, of.reference) if of.sensor else ()},
    oracles="sensor.oracles",
)
