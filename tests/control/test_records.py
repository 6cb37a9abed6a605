# SPDX-License-Identifier: MIT
"""The structs of a controller begin with what a user states, and say where each section begins."""

from __future__ import annotations

import ctypes
import re
import tracemalloc
from pathlib import Path
from types import ModuleType

import numpy as np

from support.plant.loop import struct
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


def test_an_output_has_no_gaps():
    """NumPy reads a row of outputs as it is only then: an odd number of whole numbers leaves 4 bytes."""
    name = "iiwa14_impedance_output"
    output = struct(ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h", name, {}, {})
    assert ctypes.sizeof(output) == sum(getattr(output, field).size for field, *_ in output._fields_)


def test_a_description_has_every_field_and_what_follows(robot: ModuleType):
    """Numbers of the tank and the engagement are those of the next output; asking changes nothing."""
    controller = robot.Impedance(heaviest_wrench=[60.0, 10.0], posture_stiffness=2.0, motor_inertia=0.1)
    before = controller._state.copy()
    lines = controller.describe().splitlines()
    np.testing.assert_array_equal(controller._state, before)
    assert lines[0].startswith("Basic") and sum(line.startswith("Expert") for line in lines) == 1
    words = {line[2:].split(maxsplit=1)[0]: line for line in lines if line[:2] in ("  ", "* ")}
    assert list(words) == list(controller.config)
    assert {name for name, line in words.items() if line[0] == "*"} == {
        "heaviest_wrench", "posture_stiffness", "motor_inertia"
    }  # fmt: skip
    assert words["heaviest_wrench"].endswith(" [60, 10] N, N m") and words["posture_stiffness"].endswith(" 2 N m/rad")
    out = controller.missed()
    for name in ("tank_initial", "engagement_limit"):
        assert words[name].endswith(f" 0 J ({out[name]:.4g} follows)") and out[name] > 1.0
    recording = robot.Impedance(record=3000)
    tracemalloc.start()
    recording.describe()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < sum(part.nbytes for part in recording._record) / 4  # the record is not copied
    assert robot.Impedance(tank_initial=12.0).describe().splitlines()[-1].split() == ["*", "tank_initial", "12", "J"]
