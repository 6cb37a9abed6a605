# SPDX-License-Identifier: MIT
"""The structs of a controller begin with what a user states, and say where each section begins."""

from __future__ import annotations

import re
from pathlib import Path

from support.project import ROOT

HEADER = ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h"


def sections(header: Path, struct: str) -> dict[str, list[str]]:
    """Return the members of a struct of the header by the first word of their section's heading."""
    body = next(
        part.rpartition("typedef struct {\n")[2]
        for part in header.read_text().split(f"}} iiwa14_impedance_{struct};")[:1]
    )
    found: dict[str, list[str]] = {}
    for heading, member in re.findall(
        r"/\* ---- (\w+): .* ---- \*/|^ +(?:double|int|uint32_t) (\w+)", body, re.MULTILINE
    ):
        if heading:
            found[heading] = []
        else:
            found[next(reversed(found))].append(member)
    return found


def test_at_most_fourteen_basic_fields_come_first():
    found = sections(HEADER, "config")
    assert list(found) == ["Basic", "Expert"]
    assert len(found["Basic"]) <= 14
    stated = {"sample_time", "delay_samples", "heaviest_wrench", "motor_inertia", "position_quantum", "velocity_noise"}
    assert stated <= set(found["Basic"]) and len(found["Expert"]) > 30


def test_an_output_has_four_sections():
    found = sections(HEADER, "output")
    assert list(found) == ["Torque", "Status", "Energies", "Diagnostics"]
    assert "torque" in found["Torque"] and "reason" in found["Status"] and "energy_supplied" in found["Energies"]
