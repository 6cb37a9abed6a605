# SPDX-License-Identifier: MIT
"""Certified bounds of rounding errors: they hold, they are near, and what is broken goes beyond them."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import stiffgen
from core.sine_cosine_proof import NotProvedError, proved_units
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.families.rounding.bounds import ErrorBounds, NoBound, rounded_up
from support.chains import chain_urdf
from support.generated_c import kernel_text
from support.project import ROOT, require_compiler
from support.quad import WIDTHS, Measured, can_run, climbed, kernels_with_bounds, with_eighty_digits

RANGES = Ranges()
SINES = (ROOT / "generated" / "iiwa14" / "iiwa14_lanes.h").read_text().partition("#define FAR")
SINES = "".join(SINES[1:])


CORE = ["forward_kinematics", "body_jacobian", "hybrid_joint_stiffness", "spring_torque"]


def measured_folder(folder, chain, work, kernels=None, flags=("-O1",), source=None, batches=False):
    require_compiler("gcc")
    asked = [kernel for kernel in chain_kernels(chain) if kernels is None or kernel.qualified_name in kernels]
    bounds = kernels_with_bounds(chain, RANGES, asked)
    chosen = [kernel for kernel in asked if kernel.qualified_name in bounds]
    return bounds, chosen, Measured(folder, folder.name, chain, chosen, work, flags, source=source, batches=batches)


@pytest.mark.slow
@pytest.mark.parametrize(
    "width", [pytest.param(width, marks=() if width == "AVX2" else pytest.mark.wide) for width in WIDTHS]
)
def test_no_error_is_beyond_its_bound(width, robot_folder, chain, tmp_path):
    """Random states and some beside the worst of them; and no bound is more than a thousand times what is seen."""
    if not can_run(WIDTHS[width]):
        pytest.skip(f"this machine has no {width}")
    bounds, kernels, measured = measured_folder(robot_folder, chain, tmp_path, flags=WIDTHS[width], batches=True)
    assert len(kernels) == 31
    for number, kernel in enumerate(kernels):
        errors, *_ = climbed(measured, kernel, RANGES, 2000, np.random.default_rng(number), pool=500)
        bound = bounds[kernel.qualified_name]
        assert (errors <= bound).all(), kernel.qualified_name
        assert bound.max() <= 1000 * errors.max() or not errors.any(), kernel.qualified_name


def test_some_errors_are_within_their_bounds(robot_folder, chain, tmp_path):
    bounds, kernels, measured = measured_folder(robot_folder, chain, tmp_path, CORE)
    for number, kernel in enumerate(kernels):
        errors, *_ = climbed(measured, kernel, RANGES, 2000, np.random.default_rng(number), pool=500)
        bound = bounds[kernel.qualified_name]
        assert (errors <= bound).all(), kernel.qualified_name
        assert bound.max() <= 1000 * errors.max(), kernel.qualified_name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("types", "options"),
    [
        pytest.param("rprmr", {}, marks=pytest.mark.wide),
        pytest.param("rrrr", {"floating_base": True}, marks=pytest.mark.wide),
        ("rr", {"runtime_tool": True}),
    ],
    ids=["sliding and coupled joints", "floating base", "tool at run time"],
)
def test_other_chains(types, options, tmp_path):
    """Climb to the largest rounding errors of other chains: all stay within the bounds."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    folder = stiffgen.generate(urdf, output=tmp_path, name="other", build=False, controller=False, **options)
    chain = stiffgen.load_chain(urdf, **options)
    work = tmp_path / "work"
    work.mkdir()
    bounds, kernels, measured = measured_folder(folder, chain, work)
    assert {"forward_kinematics", "hybrid_joint_stiffness", "spring_torque", "body_jacobian"} <= set(bounds)
    for number, kernel in enumerate(kernels):
        errors, *_ = climbed(measured, kernel, RANGES, 2000, np.random.default_rng(number), pool=500)
        assert (errors <= bounds[kernel.qualified_name]).all(), kernel.qualified_name


@pytest.mark.parametrize(
    ("statement", "broken"),
    [
        ("0.42 * ", "0.42000000000001 * "),
        pytest.param("(low + (z * r) * P)", "(low + (z * r) * P * 0.9999999999999)", marks=pytest.mark.wide),
        pytest.param("0.008333333333322118", "0.008333333333", marks=pytest.mark.wide),
    ],
    ids=["a length", "a product", "a coefficient of the sine"],
)
def test_what_is_broken_is_beyond_the_bounds(statement, broken, robot_folder, chain, tmp_path):
    """Faults far below the digits that other tests look at."""
    own = kernel_text(robot_folder, "iiwa14")
    assert statement in own
    bounds, (kernel,), measured = measured_folder(
        robot_folder, chain, tmp_path, ["forward_kinematics"], source=own.replace(statement, broken)
    )
    errors, *_ = climbed(measured, kernel, RANGES, 1000, np.random.default_rng(0), pool=500)
    assert (errors > bounds["forward_kinematics"]).any()


@pytest.mark.slow
def test_the_reference_has_thirty_digits(robot_folder, chain, tmp_path):
    """Compare the quad reference with mpmath where errors are largest."""
    names = ["hybrid_joint_stiffness", "spring_joint_stiffness", "mass_matrix"]
    _, kernels, measured = measured_folder(robot_folder, chain, tmp_path, names)
    for kernel in kernels:
        found = climbed(measured, kernel, RANGES, 100, np.random.default_rng(0), pool=100)
        largest, off = with_eighty_digits(measured, kernel, found.worst)
        assert abs(largest - found.errors.max()) < 1e-12 * largest
        assert off < 1e-12


@pytest.mark.slow
def test_sine_and_cosine_are_proved():
    assert all(units <= 2 for units in proved_units(SINES))


COEFFICIENTS = ("0.008333333333322118", "0.008333333333300000"), ("2.7557313621376058e-06", "2.75573136e-06")
"""Two of four that the proof takes longest for."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statement", "broken"),
    [
        *(pytest.param(*each, marks=pytest.mark.wide) for each in COEFFICIENTS),
        ("0.0013888888888873056", "0.00138888888880"),
        ("5.1266883031811465e-12", "5.1266883031e-12"),
        ("3.1415926535846666", "3.141592653589793"),
        ("(low + (z * r) * P)", "((z * r) * P)"),
        ("#define FAR 1e4", "#define FAR 1e5"),
        ("whole(r2 - w3)", "(r2 - w3 - 0.0)"),
    ],
)
def test_the_proof_fails_where_the_code_is_wrong(statement, broken):
    """Change a coefficient or a statement of the sine: the proof must fail or exceed 2 units."""
    assert statement in SINES
    try:
        units = proved_units(SINES.replace(statement, broken))
    except NotProvedError:
        return
    assert not all(unit <= 2 for unit in units)


def test_bounds_are_stated_in_header_and_manifest(robot_folder, chain):
    """Compare the bounds in header and manifest with those computed anew."""
    stated = json.loads((robot_folder / "manifest.json").read_text())["rounding"]
    header = (robot_folder / "iiwa14.h").read_text()
    found = ErrorBounds(chain)
    for kernel in chain_kernels(chain):
        name = kernel.qualified_name
        try:
            bounds = found.of(kernel)
        except NoBound:
            assert name not in stated["bounds"]
            continue
        largest = max(each["bound"] for each in stated["bounds"][name])
        assert largest == max(rounded_up(max(entries)) for entries in bounds.values())
        comment = header[: header.index(f"void iiwa14_{name}(")].rsplit("/*", 1)[1]
        assert all(f"{each['bound']:.1e}" in comment for each in stated["bounds"][name] if each["bound"])


def test_wider_ranges_give_larger_bounds(chain):
    (kernel,) = (kernel for kernel in chain_kernels(chain) if kernel.qualified_name == "hybrid_kinematic_stiffness")
    narrow, wide = (ErrorBounds(chain, Ranges(force=force)).of(kernel) for force in (1.0, 1000.0))
    assert max(wide["kinematic_stiffness"]) > 10 * max(narrow["kinematic_stiffness"])


def test_rounding_goes_up_to_two_digits():
    assert rounded_up(1.5e-12) == 1.5e-12 or rounded_up(1.5e-12) == 1.6e-12  # 1.5e-12 is no double
    assert rounded_up(1.5100001e-12) == 1.6e-12
    assert rounded_up(9.91e-3) == 1e-2
    assert rounded_up(5e-324) == 0.0


def test_what_overflows_has_no_bound(tmp_path):
    """State a huge number as a joint's rate: no bound, instead of a wrong one."""
    text = (ROOT / "urdf" / "iiwa14.urdf").read_text()
    urdf = tmp_path / "fast.urdf"
    urdf.write_text(re.sub(r'velocity="[^"]*"', 'velocity="1e300"', text))
    folder = stiffgen.generate(urdf, output=tmp_path, build=False, controller=False, kernels="bias_forces")
    stated = json.loads((folder / "manifest.json").read_text())["rounding"]
    assert "forward_kinematics" in json.dumps(stated)
    assert "bias_forces" not in json.dumps(stated)
