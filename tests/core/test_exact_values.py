# SPDX-License-Identifier: MIT
"""Eleven kernels against 60 digits that neither stiffgen's reader nor CasADi has touched (support/exact_kernels.py).

The oracles of ``stiffgen verify`` see all else, but share the chain with the kernels: a wrong axis of a joint is in
both. Such faults of the reader, and faults of differentiation, are put in here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.robot.chain import Chain, Joint
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from support.exact_kernels import exact_values
from support.exact_tree import tree_urdf
from support.small_robots import TREES

BOUND = 1e-11
SMALL = "one coordinate of two joints", "two tips on one way", "one joint on a floating base"
ROBOTS = {name: (TREES[name].urdf, TREES[name].options) for name in SMALL}
ROBOTS["tree"] = tree_urdf(7, 6), {"tip": ["left", "right"]}
ROBOTS["floating tree"] = tree_urdf(7, 6), {"tip": ["left", "right"], "floating_base": True}


def load(folder: Path, robot: str) -> tuple[str, Chain]:
    text, options = ROBOTS[robot]
    (folder / "robot.urdf").write_text(text)
    return text, stiffgen.load_chain(folder / "robot.urdf", **options)


def compared(text: str, chain: Chain) -> tuple[list[Kernel], dict[str, float]]:
    """Return the kernels that have an exact value, at the last tip, and their relative errors."""
    tip, pool = chain.tips[-1], argument_samples(chain, 1, 5)
    given = {argument.name: values[0] for argument, values in pool.items()}
    exact, kernels, errors = exact_values(text, chain, tip.link, given), [], {}
    for kernel in chain_kernels(chain):
        name = f"{kernel.group}_{kernel.name}" if kernel.group else kernel.name
        if name in exact and (kernel.tip is None or kernel.tip == tip):
            value = function_of_stacks(chain, kernel)(*(given[each.name][None] for each in kernel.arguments))[0]
            errors[name] = float(np.abs(value - exact[name]).max() / (np.abs(exact[name]).max() or 1.0))
            kernels.append(kernel)
    assert errors.keys() == exact.keys()
    return kernels, errors


@pytest.mark.parametrize("robot", [
    *SMALL, pytest.param("tree", marks=pytest.mark.slow), pytest.param("floating tree", marks=pytest.mark.wide)
])  # fmt: skip
def test_kernels_have_the_values_of_the_file(robot: str, tmp_path: Path) -> None:
    _, errors = compared(*load(tmp_path, robot))
    assert {name: error for name, error in errors.items() if not error <= BOUND} == {}
    assert len(errors) == 11


def moved(joint: Joint) -> Joint:
    x, y, z = joint.translation
    return replace(joint, translation=(x, y + 1e-3, z))


def turned(joint: Joint) -> Joint:
    x, y, z = joint.rotation
    return replace(joint, rotation=(tuple(-v for v in x), tuple(-v for v in y), z))


def heavier(joint: Joint) -> Joint:
    return replace(joint, body=replace(joint.body, mass=1.001 * joint.body.mass))


def swapped(joint: Joint) -> Joint:
    xx, xy, xz, yy, yz, zz = joint.body.tensor
    return replace(joint, body=replace(joint.body, tensor=(xx, -xy, xz, yy, yz, zz)))


def elsewhere(joint: Joint) -> Joint:
    x, y, z = joint.body.moment
    return replace(joint, body=replace(joint.body, moment=(x, y + 1e-3, z)))


READER_FAULTS: dict[str, Callable[[Joint], Joint]] = {
    "axis": lambda joint: replace(joint, axis=tuple(-v for v in joint.axis)),
    "origin, 1 mm": moved,
    "origin, half a turn": turned,
    "multiplier of a mimic joint": lambda joint: replace(joint, multiplier=1.0),
    "offset of a mimic joint": lambda joint: replace(joint, offset=0.0),
    "mass": heavier,
    "centre of mass": elsewhere,
    "product of inertia": swapped,
}


@pytest.mark.parametrize("fault", READER_FAULTS)
def test_a_fault_of_the_reader_is_seen_here_alone(fault: str, tmp_path: Path) -> None:
    """Let the reader change the last joint: kernels and oracles agree with each other, exact values do not."""
    text, chain = load(tmp_path, SMALL[0])
    wrong = replace(chain, joints=(*chain.joints[:-1], READER_FAULTS[fault](chain.joints[-1])))
    kernels, errors = compared(text, wrong)
    assert max(errors.values()) > 1e-6
    functions = {kernel.qualified_name: function_of_stacks(wrong, kernel) for kernel in kernels}
    assert [check for check in check_robot(functions, wrong, 2, 0, None, kernels) if not check.passed] == []


@pytest.mark.parametrize("name", ["jacobian", "gradient", "hessian", "jtimes"])
def test_a_fault_of_differentiation_is_seen(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Derivatives of CasADi that are 1e-6 too large: in a kernel or in an oracle, but not in both alike."""
    text, chain = load(tmp_path, SMALL[1])
    right = getattr(ca, name)

    def wrong(*given, **options):
        found = right(*given, **options)
        return tuple(each * (1 + 1e-6) for each in found) if isinstance(found, tuple) else found * (1 + 1e-6)

    monkeypatch.setattr(ca, name, wrong)
    table, errors = compared(text, chain)
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    failed = [check for check in check_robot(functions, chain, 2, 0, None, table) if not check.passed]
    assert failed or max(errors.values()) > BOUND
