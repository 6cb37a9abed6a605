# SPDX-License-Identifier: MIT
"""Rules of the rounding bounds: each holds, each is needed, and none depends on a printed name."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.lower import statements
from stiffgen.core.lower.form import Statements
from stiffgen.core.lower.graph import Graph, build_graph
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE, FLOAT
from stiffgen.core.lower.steps import lowered
from stiffgen.core.lower.variant import SINGLE
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.kinematics import Kind
from stiffgen.core.symbolic.program import Array
from stiffgen.core.symbolic.steps import SumJoints
from stiffgen.families.rounding.analysis import Bound, BoundAnalysis, added
from stiffgen.families.rounding.bounds import ErrorBounds, NoBound, argument_sizes, chain_reach
from support.chains import chain_urdf

OPERATIONS: dict[str, Callable] = {
    "neg": np.negative, "mul": np.multiply, "add": np.add, "sub": np.subtract, "sin": np.sin, "cos": np.cos,
}  # fmt: skip


def values(graph: Graph, inputs: list, number: type) -> list:
    """Return the value of every operation, computed with numbers of a type."""
    found: list = []
    for kind, a, b in graph.keys:
        if kind in ("input", "const"):
            found.append(np.asarray(inputs[int(a)] if kind == "input" else a, number))
        else:
            found.append(OPERATIONS[kind](*(found[k] for k in (int(a), b)[: 1 + (kind in ("mul", "add", "sub"))])))
    return found


@dataclass(frozen=True)
class Case:
    """An expression whose worst error or size comes near the bound that one rule gives."""

    rule: str
    expression: Callable[..., ca.SX]
    size: float
    error: float = 0.0
    of_size: bool = False


def constant(x: ca.SX, y: ca.SX, q: ca.SX) -> ca.SX:
    return ca.SX(1 + 2.0**-24)


CASES = (
    Case("_constant", constant, 1.0),
    Case("_product", lambda x, y, q: x * y, 2.95),
    Case("_product", lambda x, y, q: x * y, 3.0, 0.1),
    Case("_product", lambda x, y, q: 0.5 * x, 3.0, 0.1),
    Case("_product", lambda x, y, q: x * y, 3.0, of_size=True),
    Case("_sum", lambda x, y, q: x + y, 4.5),
    Case("_sum", lambda x, y, q: x - y, 3.0, 0.1),
    Case("_sum", lambda x, y, q: x + y, 3.0, of_size=True),
    Case("_of_turn", lambda x, y, q: ca.cos(q) * x + ca.sin(q) * y, 3.0, 0.1),
    Case("_of_turn", lambda x, y, q: ca.cos(q) * x + ca.sin(q) * y, 3.0, of_size=True),
    Case("_bound", lambda x, y, q: ca.sin(x), 0.1, 0.1),
    Case("_bound", lambda x, y, q: ca.cos(q), 1.0, of_size=True),
)


def holds(case: Case) -> bool:
    """Return whether the bound is at least what samples reach."""
    x, y, q = (ca.SX.sym(name) for name in "xyq")
    graph, (number,) = build_graph(ca.Function("f", [ca.vertcat(x, y, q)], [ca.densify(case.expression(x, y, q))]))
    rng = np.random.default_rng(0)
    exact = [case.size * rng.choice([-1, 1], 20000) * rng.uniform(0.98, 1, 20000) for _ in range(2)]
    exact = [each.astype(np.float32).astype(float) for each in exact]
    computed = [each + np.sign(each) * case.error for each in exact]
    angle = rng.uniform(-3, 3, 20000).astype(np.float32).astype(float)
    inputs = [Bound(case.size, case.error), Bound(case.size, case.error), Bound(3.0)]
    (bound,) = BoundAnalysis(graph, [number], FLOAT).bounds(inputs)
    true = values(graph, [*exact, angle], np.float64)[number]
    if case.of_size:
        return bool(np.abs(true).max() <= bound.size)
    return bool(np.abs(values(graph, [*computed, angle], np.float32)[number] - true).max() <= bound.error)


@pytest.mark.parametrize("case", CASES, ids=[f"{k}{case.rule}" for k, case in enumerate(CASES)])
def test_a_rule_holds_and_half_of_it_does_not(case, monkeypatch):
    assert holds(case)
    whole = getattr(BoundAnalysis, case.rule)
    monkeypatch.setattr(BoundAnalysis, case.rule, lambda *args: Bound(*(0.5 * each for each in whole(*args))))
    assert not holds(case)


def test_a_sum_of_kernels_counts_both_errors_and_its_own():
    bound = added(Bound(4.0, 0.1), Bound(5.0, 0.2), FLOAT)
    assert 9.0 <= bound.size < 9.001
    assert 0.3 + 9.3 * FLOAT.unit <= bound.error < 0.30001


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_a_sum_over_joints_counts_every_joint_and_half_of_its_rule_does_not_hold(share, tmp_path, monkeypatch):
    """Halve the rule for a mimic joint's share: the bound no longer holds."""
    (tmp_path / "chain.urdf").write_text(chain_urdf("rpm"))
    chain = stiffgen.load_chain(tmp_path / "chain.urdf")
    whole = BoundAnalysis.bounds
    halved = lambda *args: [Bound(share * each.size, share * each.error) for each in whole(*args)]  # noqa: E731
    monkeypatch.setattr(BoundAnalysis, "bounds", halved)
    step = SumJoints(Array("of_joints", (3,)), Array("of_coordinates", (2,)))
    arrays = {"of_joints": [Bound(4.0, 0.1), Bound(3.0, 0.2), Bound(6.0, 0.4)]}
    ErrorBounds(chain)._linear(chain, step, arrays)
    both, alone = arrays["of_coordinates"]
    assert (both.size >= 4.0 + 0.5 * 6.0 and both.error >= 0.1 + 0.5 * 0.4) == (share == 1.0)
    assert (alone.size >= 3.0 and alone.error >= 0.2) == (share == 1.0)
    assert both.size < 7.001 and both.error < 0.3001


KINDS = (Kind.ROTATION, Kind.POINT)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_sizes_of_kinds_hold_and_half_of_them_do_not(factor, chain):
    """Rotations and points of the chain, and columns and poses made of them, at random joint positions."""
    reach = factor * chain_reach(chain, Ranges(), DOUBLE)
    sizes = {Kind.ROTATION: factor * DOUBLE.rotation, Kind.POINT: reach, Kind.ZERO: 0.0, Kind.ONE: 1.0}
    code, largest = lowered(chain, SINGLE), dict.fromkeys(Kind, 0.0)
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    for name in ("forward_kinematics", "body_jacobian", "hybrid_jacobian", "spatial_jacobian"):
        code.kernel(table[name])
    joints = np.random.default_rng(0).uniform(-2, 2, (7, 2000))
    for function in code.shared.values():
        (item,) = function.items
        assert isinstance(item, Statements)
        assert item.body.kinds
        found = values(item.body.graph, [joints[access.entry] for access in item.body.inputs], np.float64)
        for number, kind in item.body.kinds:
            largest[kind] = max(largest[kind], np.abs(found[number]).max())
    assert largest[Kind.ONE] == 1.0
    assert not largest[Kind.ZERO]
    assert all((largest[kind] <= sizes[kind]) == (factor == 1.0) for kind in KINDS), largest


def test_sizes_of_arguments_are_the_ranges(chain):
    ranges = Ranges(force=3.0, moment=5.0)
    wrench = next(a for kernel in chain_kernels(chain) for a in kernel.arguments if a.name == "wrench")
    assert argument_sizes(chain, wrench, ranges, 1.0, DOUBLE) == [3.0] * 3 + [5.0] * 3
    with pytest.raises(NoBound):
        argument_sizes(chain, Argument("unknown", (3,), "", ""), ranges, 1.0, DOUBLE)


def bounds_of(chain) -> dict[str, dict[str, list[float]]]:
    """Return the rounding bounds of all kernels that have one."""
    analysis, found = ErrorBounds(chain), {}
    for kernel in chain_kernels(chain):
        try:
            found[kernel.qualified_name] = analysis.of(kernel)
        except NoBound:
            continue
    return found


def test_bounds_do_not_depend_on_names(chain, monkeypatch):
    """Rename each local at random: the bounds stay."""
    before = bounds_of(chain)
    rng, groups = random.Random(0), statements.named_sections

    def renamed(sections):
        changed = []
        for section in sections:
            names = {name: f"{rng.choice('RpqsMKx')}{rng.randrange(10**9)}_" for name in section.values}
            kinds = {names[name]: kind for name, kind in section.kinds.items()}
            changed.append(replace(section, values={names[n]: v for n, v in section.values.items()}, kinds=kinds))
        return groups(changed)

    monkeypatch.setattr(statements, "named_sections", renamed)
    assert bounds_of(chain) == before
    assert "hybrid_joint_stiffness" in before


def test_bounds_are_those_of_the_form_that_is_printed(chain):
    """Change a constant of the lowered form: the bound changes, as nothing is derived twice."""
    (kernel,) = (kernel for kernel in chain_kernels(chain) if kernel.qualified_name == "forward_kinematics")
    code = lowered(chain, SINGLE)
    before = ErrorBounds(chain, code=code).of(kernel)
    graph = code.shared["tip_pose"].items[0].body.graph
    graph.keys[:] = [("const", 7.0 * a, b) if kind == "const" else (kind, a, b) for kind, a, b in graph.keys]
    assert ErrorBounds(chain, code=code).of(kernel) != before
