# SPDX-License-Identifier: MIT
"""The controller's C by itself: the core on a stub robot of seven sliding joints, and what gives it to Python."""

from __future__ import annotations

import ctypes
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stiffgen.control.companions import CARRY, COMPANIONS, SHARED
from stiffgen.control.page import IMPEDANCE, LIBRARY, LOOPS, MODULE
from support.c_library import check_compiles, check_contained, check_order, check_sizes, check_tool
from support.controller_library import compile_library
from support.plant.loop import fill, struct
from support.project import ROOT

LIBRARIES = {
    "shared": SHARED,
    "controller": IMPEDANCE,
    "loops": LOOPS,
    "Python": MODULE,
    "carry": CARRY,
    **{name: companion.library for name, companion in COMPANIONS.items()},
}
HEADER = ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h"
SAMPLE_TIME, CALLS, VELOCITY, RATE, POSTURE, STIFFNESS = 1e-3, 3, 2.0, 1e4, 10.0, 100.0
"""Numbers of the stub's configuration and command."""


class Library:
    """The compiled library with one controller."""

    def __init__(self, path: Path) -> None:
        """Load the library and build the ctypes records of its header."""
        self.c: Any = ctypes.CDLL(str(path))
        known: dict[str, Any] = {}
        records = ("arm", "watch", "fault", "reference", "stiffness", "caller", "account")
        for name in ("config", "input", "output", *records, "memory", "state"):
            known[f"iiwa14_impedance_{name}"] = struct(HEADER, f"iiwa14_impedance_{name}", known, {})
        self.Config, self.Input, self.Output = list(known.values())[:3]
        self.State = known["iiwa14_impedance_state"]

    def config(self) -> Any:
        """Return a valid configuration: 1 ms, generous limits."""
        return fill(
            self.Config(), sample_time=SAMPLE_TIME, delay_samples=0, missed_limit=CALLS, call_gap_limit=CALLS,
            lower_limit=-5.0, upper_limit=5.0, velocity_limit=VELOCITY, effort_limit=100.0, torque_rate_limit=RATE,
            tip_velocity_limit=(0.5, 1.5), ramp_time=0.2, damping_ratio=0.7, tank_initial=10.0, coriolis=1,
            heaviest_wrench=(100.0, 20.0), communication_reaction=1, position_quantum=2e-6,
        )  # fmt: skip


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(compile_library(tmp_path_factory.mktemp("library") / "library.so"))


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("which", LIBRARIES)
def test_every_file_compiles_by_itself(which: str, compiler: str, tmp_path: Path) -> None:
    check_compiles(LIBRARIES[which], compiler, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["clang-tidy", pytest.param("clangd", marks=pytest.mark.wide)])
@pytest.mark.parametrize(
    "which", [pytest.param(name, marks=pytest.mark.wide if name in COMPANIONS else ()) for name in LIBRARIES]
)
def test_editors_open_every_file(which: str, tool: str) -> None:
    """Open each file with clang-tidy and clangd: no diagnostics with the flags of compile_flags.txt."""
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    check_tool(LIBRARIES[which], tool)


def test_generated_files_contain_the_libraries() -> None:
    check_contained(IMPEDANCE, HEADER.with_suffix(".c").read_text())
    for name, companion in COMPANIONS.items():
        check_contained(companion.library, (HEADER.parent / f"iiwa14_{name}.c").read_text())
    check_contained(MODULE, (HEADER.parent / "python" / "iiwa14_python.c").read_text())


@pytest.mark.parametrize("which", LIBRARIES)
def test_no_file_calls_one_behind_it(which: str) -> None:
    """In the order of the sources; so there is no circle."""
    check_order(LIBRARIES[which], {"controller": 55, "shared": 10, "loops": 10, "Python": 3}.get(which, 0))


def test_a_constant_of_the_header_serves_several_files() -> None:
    """Look up each constant of the header: one that a single file uses belongs into that file."""
    texts = [path.read_text() for path in LIBRARY.glob("*.c")]
    header = (LIBRARY / "impedance.h").read_text()
    names = re.findall(r"\b([A-Z][A-Z_]+) = [^;,]*[;,]", "".join(re.findall(r"^static const .*", header, re.MULTILINE)))
    assert "ROUNDED" in names
    used = {name: sum(re.search(rf"\b{name}\b", text) is not None for text in texts) for name in names}
    assert {name for name, count in used.items() if count < 2} == set()


@pytest.mark.parametrize("which", LIBRARIES)
def test_functions_fit_on_a_page(which: str) -> None:
    """No function is longer than 60 lines, no file than 500, and no conditional is nested in another."""
    check_sizes(LIBRARIES[which])


def run(library: Library, state: Any, steps: int, **values: Any) -> Any:
    """Return the output of the last step; the counter goes on, the arm stands still at 0 unless told otherwise."""
    sample, out = library.Input(), library.Output()
    fill(sample, **{"sample_valid": 1, "clock": 1, "posture_stiffness": POSTURE, **values})
    fill(sample, translation_stiffness=STIFFNESS * np.eye(3), rotation_stiffness=np.eye(3))
    for _ in range(steps):
        sample.counter = state.memory.watch.counter + 1
        assert library.c.step(ctypes.byref(state), ctypes.byref(sample), ctypes.byref(out)) == 0
    return out


def started(library: Library) -> Any:
    """Return the state of a controller whose springs are in force at rest, at q = q0 = 0."""
    state = library.State()
    assert library.c.initialise(ctypes.byref(library.config()), ctypes.byref(state), None) == 0
    run(library, state, 3)
    return state


@pytest.mark.slow
def test_a_step_of_the_stub(library: Library) -> None:
    """An arm that is held at q = 0 is pulled to q0 by its springs, and the tank keeps what this torque may put out.

    Only the first three joints move the tip. The reserve lets every joint move at its velocity limit while the torque
    is held for CALLS calls, and while it falls to zero at the rate limit. A call may last CALLS sample times.
    """
    state = started(library)
    q0 = np.array([0.1, -0.2, 0.05, 0.1, 0.0, 0.0, -0.1])
    out = run(library, state, 3000, q0=q0)  # until the reference is there
    expected = np.r_[STIFFNESS * q0[:3], np.zeros(4)] + POSTURE * q0
    assert out.reason == 0 and out.scale == 1.0
    np.testing.assert_allclose(out.torque, expected, atol=1e-12)
    assert out.stored == pytest.approx((STIFFNESS * q0[:3] @ q0[:3] + POSTURE * q0 @ q0) / 2)
    held = VELOCITY * (CALLS * CALLS * SAMPLE_TIME) * np.abs(expected)  # [J]
    # a triangle of the height |torque| [N m] and the base |torque| / RATE [s], which calls of that length stretch
    falling = VELOCITY * CALLS * expected**2 / (2 * RATE)  # [J]
    assert out.reserve == pytest.approx((held + falling).sum())


def test_the_checksum_sees_a_changed_memory(library: Library) -> None:
    """Change any double of any record by 1: the step is refused."""
    state, out, sample = started(library), library.Output(), library.Input()
    fill(sample, sample_valid=0, clock=1)
    good = bytes(state)
    doubles = [(record, field) for record, kind in type(state.memory)._fields_[1:-2] for field, *_ in kind._fields_]
    for record, field in doubles:
        state = library.State.from_buffer_copy(good)
        value = getattr(getattr(state.memory, record), field)
        changed = np.array(np.ctypeslib.as_array(value) if hasattr(value, "_length_") else value) + 1
        fill(getattr(state.memory, record), **{field: changed})
        assert library.c.step(ctypes.byref(state), ctypes.byref(sample), ctypes.byref(out)) != 0, (record, field)
    assert len(doubles) > 50


def test_samples_that_are_missing(library: Library) -> None:
    """Miss samples: the torque is held for missed_limit calls, then falls at the rate limit."""
    state = started(library)
    held = np.array(run(library, state, 2000, q0=0.1).torque)
    for missed in range(1, CALLS + 3):
        out = run(library, state, 1, sample_valid=0)
        fallen = np.minimum(held, RATE * SAMPLE_TIME * max(missed - CALLS + 1, 0))
        np.testing.assert_allclose(out.torque, held - fallen, atol=1e-12)


def test_postures_fill_all_joints_together(library: Library) -> None:
    """Check the postures that size the tank: no two joints keep a relation in small whole numbers, as on a curve."""
    spread = library.c.spread_joint
    spread.restype = ctypes.c_double
    x = np.array([[spread(k, i) for i in range(40)] for k in range(1, 33)])
    assert x.min() >= 0.0 and x.max() < 1.0
    whole = [(a, b) for a in range(-3, 4) for b in range(1, 4)]
    pairs = [(a * x[:, i] + b * x[:, j]) for a, b in whole for i in range(40) for j in range(i)]
    kept = np.abs(np.exp(2j * np.pi * np.array(pairs)).mean(axis=1))
    print(f"largest mean of a relation {kept.max():.2f}; random points 0.5, points on a line 1")
    assert kept.max() < 0.65
