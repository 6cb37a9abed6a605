# SPDX-License-Identifier: MIT
"""The controller's C by itself: the library on a stub robot of seven sliding joints, and what gives it to Python."""

from __future__ import annotations

import ctypes
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stiffgen.control.page import IMPEDANCE, LAW, LIBRARY, LOOPS, MODULE
from support.c_library import check_compiles, check_contained, check_order, check_sizes, check_tool
from support.controller_library import compile_library
from support.plant.loop import fill, struct
from support.project import ROOT

LIBRARIES = {"controller": IMPEDANCE, "loops": LOOPS, "paper": LAW, "Python": MODULE}
HEADER = ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h"
POSITION = 1
# Numbers of the stub's configuration that a test computes with, and its translational stiffness.
SAMPLE_TIME, CALLS, VELOCITY, RATE, POSTURE_STIFFNESS, STIFFNESS = 1e-3, 3, 2.0, 1e4, 10.0, 100.0


class Library:
    """The compiled library with one controller."""

    def __init__(self, path: Path) -> None:
        self.c: Any = ctypes.CDLL(str(path))
        known: dict[str, Any] = {}
        for name in ("config", "input", "output", "memory", "state"):
            known[f"iiwa14_impedance_{name}"] = struct(HEADER, f"iiwa14_impedance_{name}", known, {})
        self.Config, self.Input, self.Output, self.Memory, self.State = known.values()

    def array(self, *values: float) -> Any:
        return (ctypes.c_double * len(values))(*values)

    def config(self, **values: Any) -> Any:
        """Return a valid configuration: 1 ms, generous limits."""
        ones = {
            "delay_samples": 0,
            "missed_limit": CALLS,
            "call_gap_limit": CALLS,
            "stiffness_cap": 1,
        }
        limits = {"lower_limit": -5.0, "upper_limit": 5.0, "position_tolerance": 0.1, "limit_zone": 0.1}
        rates = {"reference_velocity_limit": 1.0, "tip_velocity_limit": 0.5, "ramp_time": 0.2}
        rates["velocity_limit"] = VELOCITY
        torques = {"effort_limit": 100.0, "torque_rate_limit": RATE, "limit_stiffness": 100.0, "damping_ratio": 0.7}
        energies = {"energy_limit": 5.0, "engagement_limit": 20.0, "tank_initial": 10.0}
        energies["heaviest_wrench"] = [100.0, 20.0]
        more = {"translation_stiffness_limit": 5e3, "rotation_stiffness_limit": 500.0, "stiffness_time": 0.05}
        rest = {"sample_time": SAMPLE_TIME, "tip_rotation_limit": 1.5, "frozen_window": 20}
        rest["posture_stiffness"] = POSTURE_STIFFNESS
        return fill(self.Config(), **{**ones, **limits, **rates, **torques, **energies, **more, **rest, **values})


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(compile_library(tmp_path_factory.mktemp("library") / "library.so"))


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("which", LIBRARIES)
def test_every_file_compiles_by_itself(which: str, compiler: str, tmp_path: Path) -> None:
    check_compiles(LIBRARIES[which], compiler, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["clang-tidy", pytest.param("clangd", marks=pytest.mark.wide)])
@pytest.mark.parametrize("which", LIBRARIES)
def test_editors_open_every_file(which: str, tool: str) -> None:
    """No diagnostics with the flags of compile_flags.txt, which both tools read."""
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    check_tool(LIBRARIES[which], tool)


def test_generated_files_contain_the_libraries() -> None:
    check_contained(IMPEDANCE, HEADER.with_suffix(".c").read_text())
    check_contained(LAW, (HEADER.parent / "iiwa14_paper.c").read_text())
    check_contained(MODULE, (HEADER.parent / "python" / "iiwa14_python.c").read_text())


@pytest.mark.parametrize("which", LIBRARIES)
def test_no_file_calls_one_behind_it(which: str) -> None:
    """In the order of the sources; so there is no circle."""
    check_order(LIBRARIES[which], {"controller": 100, "loops": 10, "Python": 3}.get(which, 0))


def test_a_constant_of_the_header_serves_several_files() -> None:
    """One that a single file uses stands there, beside what it bounds."""
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


def test_poses(library: Library) -> None:
    """The twist between two poses moves the first to the second, also near half a turn."""
    random = np.random.default_rng(1)
    for angle in (0.0, 1e-9, 0.3, 2.0, np.pi - 1e-8, np.pi):
        axis = random.normal(size=3)
        first, second = np.eye(4), np.eye(4)
        first[:3, :3] = Rotation.random(random_state=3).as_matrix()
        second[:3, :3] = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ first[:3, :3]
        second[:3, 3] = random.normal(size=3)
        twist, moved = library.array(*[0.0] * 6), library.array(*[0.0] * 16)
        library.c.pose_difference(library.array(*first.ravel()), library.array(*second.ravel()), twist)
        assert np.linalg.norm(twist[3:]) == pytest.approx(angle, abs=1e-7)
        library.c.move_pose(library.array(*first.ravel()), twist, moved)
        np.testing.assert_allclose(np.reshape(moved, (4, 4)), second, atol=1e-7)


def test_limit_avoidance(library: Library) -> None:
    """Its torque is the slope of its energy, and its stiffness the slope of its torque, on both sides of the kink."""
    evaluate = library.c.evaluate_avoidance
    evaluate.restype = ctypes.c_double
    a, pull, stiffness = library.array(-1.0, 1.0, 50.0, 10.0), ctypes.c_double(), ctypes.c_double()

    def at(q: float) -> tuple[float, float, float]:
        energy = evaluate(a, ctypes.c_double(q), ctypes.byref(pull), ctypes.byref(stiffness))
        return energy, pull.value, stiffness.value

    for q in (-1.5, -1.1, 0.0, 1.05, 1.19, 1.21, 2.0):
        above, below = at(q + 1e-6), at(q - 1e-6)
        _, torque, slope = at(q)
        assert torque == pytest.approx((above[0] - below[0]) / 2e-6, abs=1e-6)
        assert slope == pytest.approx((above[1] - below[1]) / 2e-6, abs=1e-4)


def run(library: Library, config: Any, state: Any, steps: int, **values: Any) -> Any:
    """Return the output of the last step; the counter goes on, the arm stands still at 0 unless told otherwise."""
    sample, out = library.Input(), library.Output()
    fill(sample, **{"sample_valid": 1, "command": POSITION, **values})
    fill(sample, translation_stiffness=STIFFNESS * np.eye(3), rotation_stiffness=np.eye(3))
    for _ in range(steps):
        sample.counter = state.memory.counter + state.memory.gap + 1
        assert library.c.step(*(ctypes.byref(each) for each in (config, state, sample, out))) == 0
    return out


def started(library: Library) -> tuple[Any, Any]:
    """Return configuration and state of a controller that is engaged at rest, at q = q0 = 0."""
    config, state = library.config(), library.State()
    assert library.c.initialise(ctypes.byref(config), ctypes.byref(state), None) == 0
    run(library, config, state, 3)
    return config, state


def test_a_step_of_the_stub(library: Library) -> None:
    """An arm that is held at q = 0 is pulled to q0 by its springs, and the tank keeps what this torque may put out.

    Only the first three joints move the tip. The reserve lets every joint move at its velocity limit while the torque
    is held for CALLS calls, and while it falls to zero at the rate limit. A call may last CALLS sample times.
    """
    config, state = started(library)
    q0 = np.array([0.1, -0.2, 0.05, 0.1, 0.0, 0.0, -0.1])
    out = run(library, config, state, 3000, q0=q0)  # until the equilibrium is there
    expected = np.r_[STIFFNESS * q0[:3], np.zeros(4)] + POSTURE_STIFFNESS * q0
    assert out.fault == 0
    np.testing.assert_allclose(out.torque, expected, atol=1e-12)
    assert out.elastic_energy == pytest.approx((STIFFNESS * q0[:3] @ q0[:3] + POSTURE_STIFFNESS * q0 @ q0) / 2)
    longest_call = CALLS * SAMPLE_TIME  # [s]
    held = VELOCITY * (CALLS * longest_call) * np.abs(expected)  # [J]
    # a triangle of the height |torque| [N m] and the base |torque| / RATE [s], which calls of that length stretch
    falling = VELOCITY * (longest_call / SAMPLE_TIME) * expected**2 / (2 * RATE)  # [J]
    assert out.tank_reserve == pytest.approx((held + falling).sum())


def test_the_checksum_sees_a_changed_memory(library: Library) -> None:
    config, state = started(library)
    assert run(library, config, state, 1).reason == 0
    fill(state.memory, tank=5.0)
    assert run(library, config, state, 1).reason != 0


def test_samples_that_are_missing(library: Library) -> None:
    """The torque is held, and missed_limit missing samples are a fault, which lets it go to zero at the rate limit."""
    config, state = started(library)
    held = np.array(run(library, config, state, 2000, q0=0.1).torque)
    for missed in range(1, CALLS + 1):
        out = run(library, config, state, 1, sample_valid=0)
        assert (out.fault != 0) == (missed == CALLS)
        fallen = np.minimum(held, RATE * SAMPLE_TIME) if out.fault else 0.0
        np.testing.assert_allclose(out.torque, held - fallen, atol=1e-12)


def test_postures_fill_all_joints_together(library: Library) -> None:
    """No two joints of the postures that size the tank keep a relation in small whole numbers: a curve would."""
    spread = library.c.spread_joint
    spread.restype = ctypes.c_double
    x = np.array([[spread(k, i) for i in range(40)] for k in range(1, 33)])
    assert x.min() >= 0.0 and x.max() < 1.0
    whole = [(a, b) for a in range(-3, 4) for b in range(1, 4)]
    pairs = [(a * x[:, i] + b * x[:, j]) for a, b in whole for i in range(40) for j in range(i)]
    kept = np.abs(np.exp(2j * np.pi * np.array(pairs)).mean(axis=1))
    print(f"largest mean of a relation {kept.max():.2f}; random points 0.5, points on a line 1")
    assert kept.max() < 0.65
