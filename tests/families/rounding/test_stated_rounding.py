# SPDX-License-Identifier: MIT
"""The running error analysis that tells rounding from faults."""

from __future__ import annotations

from dataclasses import asdict

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE
from stiffgen.core.symbolic.choices import KernelOptions, Potential
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.formulas import compare
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.rounding import rounding_errors, with_more_digits
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import Check, as_results
from stiffgen.families.derivatives.check import check_derivatives
from stiffgen.families.rounding.bounds import ErrorBounds
from stiffgen.families.rounding.certified import check_certified_bounds, within
from support.chains import chain_urdf
from support.exact_tree import mp
from support.graphs import exactly

NAMES = (
    "hybrid.joint_stiffness", "hybrid.jacobian", "body.kinematic_stiffness", "spring.torque", "mass_matrix",
    "gravity.joint_stiffness",
)  # fmt: skip
OPTIONS = KernelOptions(derivatives=True, kernels=NAMES)


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Two joints along one axis: its kinematic stiffness and what is made of it are zero, but for rounding."""
    urdf = tmp_path_factory.mktemp("rounding") / "chain.urdf"
    urdf.write_text(chain_urdf("rp"))
    return stiffgen.load_chain(urdf)


def kernel_of(chain, name):
    return next(kernel for kernel in chain_kernels(chain, OPTIONS) if kernel.qualified_name == name)


@pytest.mark.parametrize("name", ["hybrid_joint_stiffness", "body_kinematic_stiffness_vjp", "hybrid_jacobian_vjp"])
def test_errors_are_those_that_doubles_have(name, chain):
    """Compare stated errors with sixty digits: none five times too small, and not ten times too large on the whole."""
    kernel, count = kernel_of(chain, name), 40
    pool = argument_samples(chain, count, 3, OPTIONS)
    stacks = [pool[argument] for argument in kernel.arguments]
    sizes, function = rounding_errors(chain, kernel, stacks), casadi_function(chain, kernel)
    ratios = []
    for state in range(count):
        one = [s[state].reshape(folded(s.shape[1:])) for s in stacks]
        found = as_results(function(*one))
        for value, right, size in zip(found, exactly(function, *one), (each[state] for each in sizes), strict=True):
            error = np.abs(np.array(np.asarray(value).astype(object) - right, float))
            assert (error[size == 0] == 0).all()
            ratios.append(error[size > 0] / size[size > 0])
    every = np.concatenate(ratios)
    assert every.max() < 5
    assert np.sqrt(np.mean(every**2)) > 0.1


def functions_of(chain, name, change):
    """CasADi's own functions as ``verify`` takes them, the first result of one of them changed."""
    functions = {}
    for kernel in chain_kernels(chain, OPTIONS):

        def call(*stacks, kernel=kernel):
            """Evaluate the CasADi function of a kernel over samples; the result of `name` is changed."""
            function = casadi_function(chain, kernel)
            rows = [
                [np.asarray(x) for x in as_results(function(*(a.reshape(folded(a.shape)) for a in one)))]
                for one in zip(*stacks, strict=True)
            ]
            stacked = [
                np.stack(each).reshape(len(rows), *result.array(chain).shape)
                for each, result in zip(zip(*rows, strict=True), kernel.results, strict=True)
            ]
            if kernel.qualified_name == name:
                stacked[0] = change(stacked[0])
            return tuple(stacked) if len(stacked) > 1 else stacked[0]

        functions[kernel.qualified_name] = call
    return functions


def checks(chain, name, change):
    """What ``verify`` says of a function that is CasADi's own, its first result changed, at states it would take."""
    pool = argument_samples(chain, 20, 0, OPTIONS)
    found: list[Check] = compare(functions_of(chain, name, change), chain, pool, OPTIONS)
    return [check for check in found if not check.passed]


@pytest.mark.slow
def test_what_cancels_may_differ_by_rounding_and_by_no_more(chain):
    name = "body_kinematic_stiffness_vjp"
    assert checks(chain, name, lambda q_bar: -q_bar) == []
    assert [check.kernel for check in checks(chain, name, lambda q_bar: q_bar + 1e-13)] == [f"{name}, q_bar"]


def certified(chain, name, change=lambda x: x, stated=lambda x: x):
    """Return what ``verify`` says of a function and its stated bounds, one or the other changed."""
    kernel, ranges = kernel_of(chain, name), Ranges()
    printed = [asdict(each) for each in ErrorBounds(chain, ranges).stated(kernel)]
    bounds = [each | {"bound": stated(each["bound"])} for each in printed]
    entries = [{"ranges": asdict(ranges), "bounds": {name: each}} for each in (bounds, printed)]
    pool = argument_samples(chain, 20, 0, OPTIONS)
    (check,) = check_certified_bounds([functions_of(chain, name, change)], [kernel], chain, DOUBLE, *entries, pool)
    return check, bounds


@pytest.mark.parametrize("name", ["forward_kinematics", "hybrid_joint_stiffness", "spring_torque", "mass_matrix"])
def test_functions_are_held_to_their_stated_bounds(name, chain):
    """Change a function by more than its bound: seen, though far below 1e-12 of the result."""
    check, bounds = certified(chain, name)
    assert check.passed and 0 < check.error < 0.5
    too_far = 1.5 * max(each["bound"] for each in bounds)
    assert not certified(chain, name, change=lambda value: value + too_far)[0].passed
    assert not certified(chain, name, change=lambda value: np.where(value == value[-1], np.nan, value))[0].passed
    assert not certified(chain, name, stated=lambda bound: 2 * bound)[0].passed


def test_the_reference_of_stated_bounds_has_more_digits_than_doubles(chain):
    """Compare the reference with sixty digits, arguments brought into the ranges (gravity up to 20 m/s^2)."""
    kernel, ranges = kernel_of(chain, "gravity_joint_stiffness"), Ranges(gravity=5.0)
    pool = argument_samples(chain, 10, 0, OPTIONS)
    given = within(chain, kernel, ranges, DOUBLE, [pool[argument] for argument in kernel.arguments])
    assert max(np.abs(pool[argument]).max() for argument in kernel.arguments) > 6.0
    assert np.abs(given[-1]).max() == 5.0
    found, function = with_more_digits(chain, kernel, given), casadi_function(chain, kernel)
    for state in range(10):
        (right,) = exactly(function, *(each[state] for each in given))
        off = np.abs(np.array([float(mp.mpf(str(x)) - y) for x, y in zip(found[state], right.ravel(), strict=True)]))
        assert off.max() < 1e-18 * np.abs(found[state]).max()


def kinks(p, R, parameters):
    return ca.fmax(0, p[2] - 0.1) ** 3 + ca.fabs(p[0]) ** 3


def test_a_kink_of_a_potential_is_no_false_alarm(chain):
    """Cross the kink of a potential's third derivative: no alarm of the differences of eighth order."""
    options = KernelOptions(potentials=(Potential(kinks),), derivatives=True, kernels=("kinks.energy",))
    table = chain_kernels(chain, options)
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    pool = argument_samples(chain, 60, 2, options)
    assert [check for check in check_derivatives(functions, table, chain, pool) if not check.passed] == []
    right = functions["kinks_energy_vjp"]
    functions["kinks_energy_vjp"] = lambda *stacks: (1.0 + 1e-9) * np.asarray(right(*stacks))
    assert not all(check.passed for check in check_derivatives(functions, table, chain, pool))
