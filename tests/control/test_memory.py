# SPDX-License-Identifier: MIT
"""Memory of the controller that holds anything: every torque is within its limits (tests/support/arms/memory.c)."""

from __future__ import annotations

import ctypes
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from stiffgen.control.core.memory import RANGES, RECORDS
from support.arms.memory import MemoryProgram
from support.plant.loop import fill, struct
from support.project import Once


@pytest.fixture(scope="module")
def program(once: Once, robot_folder: Path) -> MemoryProgram:
    folder = once("memory", lambda folder: MemoryProgram("iiwa14", folder, robot_folder))
    return MemoryProgram("iiwa14", folder, robot_folder)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_torque_is_within_its_limits_whatever_the_memory_holds(program: MemoryProgram, seed: int) -> None:
    """Patterns, random numbers and parts of a good state, with a wrong checksum, the checksum 0 or one that fits.

    Before: "effort limit passed" and "gain beyond its limit" in one of the first trials of each seed; 4997 N m from a
    memory full of 5000.0.
    """
    done = program.run(700, seed)
    assert done.returncode == 0, done.stderr
    refused, faults, taken = (int(number) for number in re.findall(r"(\d+) (?:refused|faults|taken)", done.stdout))
    assert refused > 50 and taken > 50 and faults > 0, done.stdout  # the checksum refuses nearly all


@pytest.mark.parametrize("pattern", [np.full(1 << 13, 5000.0).tobytes(), b"\x7d" * (1 << 16), b"\0" * (1 << 16)])
def test_a_state_that_was_never_initialised_is_refused(
    program: MemoryProgram, robot_folder: Path, pattern: bytes
) -> None:
    """Step and reset a state that was never initialised: E_NOT_INITIALISED and a torque of 0, each time."""
    known: dict = {}
    header = robot_folder / "iiwa14_impedance.h"
    Output = struct(header, "iiwa14_impedance_output", known, {})
    library, output = ctypes.CDLL(str(program.library)), fill(Output(), torque=1.0)
    state, sample = ctypes.create_string_buffer(pattern, 1 << 16), ctypes.create_string_buffer(1 << 16)
    library.iiwa14_impedance_error_text.restype = ctypes.c_char_p
    for _ in range(3):
        code = library.iiwa14_impedance_step(state, sample, ctypes.byref(output))
        assert b"not initialised" in library.iiwa14_impedance_error_text(code)
        assert not np.ctypeslib.as_array(output.torque).any()
        assert b"not initialised" in library.iiwa14_impedance_error_text(library.iiwa14_impedance_reset(state))


def test_every_integer_that_the_library_bounds_has_its_range() -> None:
    """Doubles come first, so that the memory has no gaps; every bound is one that an int32_t can leave."""
    for _, _, fields in RECORDS:
        doubles = [field.type == "double" for field in fields]
        assert doubles == sorted(doubles, reverse=True)
    assert all(-(2**31) < least <= most < 2**31 - 1 for _, _, least, most, _ in RANGES)
    assert ("config", "delay_samples", 0, 5, False) in RANGES


@pytest.mark.slow
def test_the_program_finds_a_torque_beyond_its_limit(tmp_path: Path, robot_folder: Path) -> None:
    """Take a controller's last guard away: the program that damages memory must fail."""
    source = (robot_folder / "iiwa14_impedance.c").read_text()
    guarded = "    guard_output(effort, out->torque);\n"
    assert guarded in source
    broken = tmp_path / "iiwa14_impedance.c"
    broken.write_text(source.replace(guarded, ""))
    spoiled = MemoryProgram("iiwa14", tmp_path, robot_folder, controller=broken)
    done = subprocess.run([spoiled.program, "400", "1"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "effort limit passed" in done.stderr
