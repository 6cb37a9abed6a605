# SPDX-License-Identifier: MIT
"""Potentials of the joint positions against derivatives by hand in long numbers, at their edges, and with NaN."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen
from stiffgen.families.joints.reference import by_hand
from support.project import URDF, kernels_of

BOUND = 1e-13


def cases(count=200):
    """Yield (group, arguments): joints away from their limits, in both zones, within 1e-9 of an edge, and beyond."""
    random = np.random.default_rng(12)
    for turn in range(count):
        q = random.uniform(-3, 3, 7)
        yield "posture", (q, random.uniform(-3, 3, 7), random.uniform(0, 40, 7))
        zone, near = random.uniform(0.05, 0.4), 10.0 ** random.uniform(-9, -3, 7)
        upper = q + random.choice([zone - near, zone + near, 0.5 * zone + near, -0.3 * near, np.full(7, 1.0)], axis=0)
        lower = upper - random.uniform(0.5 * zone, 3.0) if turn % 2 else q - zone + random.choice([-1, 1], 7) * near
        yield "limits", (q, lower, upper, zone, random.uniform(0, 500, 7))


@pytest.fixture(scope="module")
def model():
    return stiffgen.StiffnessModel(stiffgen.load_chain(URDF))


def test_values_at_the_edges(model):
    """Compare with values in long double around limits and ramps, where branches meet."""
    deep = 0
    for group, arguments in cases():
        expected = by_hand(group, *(np.asarray(each, np.longdouble)[None] for each in arguments))
        # What rounding q - limit costs: a depth is known to the rounding of q.
        k = np.max(arguments[-1])
        for name, scale in (
            ("energy", k),
            ("torque", k),
            ("joint_stiffness", k / arguments[3] if group == "limits" else k),
        ):
            value = expected[name][0]
            found = np.array(getattr(getattr(model, group), name)(*arguments)).reshape(value.shape)
            assert np.abs(found - value).max() <= BOUND * (scale + np.abs(value).max()), name
        deep += group == "limits" and expected["energy"][0] > 0
    assert deep > 100


def test_the_limits_two_derivatives_are_continuous(model):
    """Cross a zone's edge: nothing jumps; at the limit the stiffness is the one asked for."""
    lower, upper, zone, k = np.full(7, -1.0), np.full(7, 1.0), 0.25, np.linspace(10, 70, 7)
    # angle [rad]; share of k that the tangent has reached: 0 at the zone's edge (0.75), 1 at the limit (1.0)
    for q, share in ((0.75, 0.0), (0.75 + 1e-9, 4e-9), (0.875, 0.5), (1.0, 1.0), (1.25, 2.0), (-1.0, 1.0), (0.0, 0.0)):
        at = np.full(7, q)
        torque = np.array(model.limits.torque(at, lower, upper, zone, k)).ravel()
        tangent = np.array(model.limits.joint_stiffness(at, lower, upper, zone, k))
        assert np.allclose(tangent, np.diag(share * k), rtol=1e-6, atol=1e-12)
        assert np.allclose(torque, -np.sign(q) * share**2 * zone / 2 * k, rtol=1e-6, atol=1e-12)


def test_sums_are_those_of_one_potential(model):
    """Add spring, posture and limits: -d torque/dq is the sum of the joint stiffnesses, and symmetric."""
    random = np.random.default_rng(3)
    q = random.uniform(-1, 1, 7)
    H = np.array(model.forward_kinematics(random.uniform(-1, 1, 7)))
    of_spring = (H, 500 * np.eye(3), np.diag([30.0, 20, 10]))
    of_posture = (random.uniform(-1, 1, 7), random.uniform(1, 20, 7))
    of_limits = (q - 0.1, q + 0.15, 0.2, random.uniform(50, 500, 7))  # q is in both zones of 0.2 rad

    def total(name, at):
        groups = ((model.spring, of_spring), (model.posture, of_posture), (model.limits, of_limits))
        return sum(np.array(getattr(group, name)(at, *given)) for group, given in groups)

    step = 1e-5
    shifts = step * np.eye(7)
    slope = np.hstack([(total("torque", q + s) - total("torque", q - s)) / (2 * step) for s in shifts])
    assert np.allclose(-slope, total("joint_stiffness", q), atol=1e-5)
    fall = [(total("energy", q + s) - total("energy", q - s)).item() / (2 * step) for s in shifts]
    assert np.allclose(-np.array(fall), total("torque", q).ravel(), atol=1e-6)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_not_finite_in_the_generated_code(robot, chain):
    """Spoil entries of the compiled functions: NaN what depends on them, and nothing infinite."""
    kernels = kernels_of(robot, chain)
    q, k = np.linspace(-0.4, 0.4, 7), np.full(7, 30.0)
    given = {"posture": [q, np.zeros(7), k], "limits": [q, np.full(7, -0.5), np.full(7, 0.5), np.array(0.3), k]}
    for group, arguments in given.items():
        for which in range(len(arguments)):
            for bad in (np.nan, np.inf, -np.inf):
                spoiled = [np.array(each) for each in arguments]
                spoiled[which][() if spoiled[which].ndim == 0 else 6] = bad
                for name, entry in (("energy", ()), ("torque", 6), ("joint_stiffness", (6, 6))):
                    stack = [np.stack([clean, wrong]) for clean, wrong in zip(arguments, spoiled, strict=True)]
                    kernel = kernels[f"{group}_{name}"]
                    one, both = np.asarray(kernel(*spoiled)), np.asarray(kernel(*stack))
                    # Joint 6 is in its upper zone: its lower limit does not count. The posture's stiffness is k alone.
                    counts = which != 1 if group == "limits" else which == 2 or name != "joint_stiffness"
                    if counts:
                        assert np.isnan(one[entry]), (group, name, which, bad)
                    assert not np.isinf(one).any()
                    assert not np.isinf(both).any()
                    # The configuration beside it is what it was, to the last bit.
                    assert np.array_equal(
                        both[0], np.asarray(kernel(*(np.stack([each, each]) for each in arguments)))[0]
                    )
