# SPDX-License-Identifier: MIT
"""Oracles of springs between two tips: derivatives of the textbook's energy along products of joint poses."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca

from stiffgen.core.robot.chain import Tip
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.model import folded
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.poses import homogeneous, joint_poses
from stiffgen.core.verify.kernels.references import References, as_columns
from stiffgen.families.pair import reference
from stiffgen.families.pair.kernels import PARAMETERS, kinds_of
from stiffgen.families.pair.springs import TOOL_POSES, matrices
from stiffgen.families.pair.way import TipPair, names_of, pairs_of

Results = dict[str, FloatArray]


def _pose(r: References, tip: Tip, tool: ca.SX | None) -> reference.FramePose:
    """Return rotation and origin of a tip in the base or, on a floating base, the world."""
    pose = joint_poses(r.chain, r.place.q, r.place.base())[tip.joint] @ homogeneous(tip.rotation, tip.translation)
    pose = pose if tool is None else pose @ tool
    return pose[:3, :3], pose[:3, 3]


def _symbols(arguments: tuple[Argument, ...], r: References) -> list[ca.SX]:
    return [ca.SX.sym(each.name, *(folded(each.array(r.chain).shape) or (1,))) for each in arguments]


def results(r: References, pair: TipPair, kind: str) -> Results:
    """Return the results of the kernels of a kind of a pair by name.

    Torque and joint stiffness are derivatives of the energy with respect to q. Wrench and task stiffness are those with
    respect to twists x of both tips, at x = 0.
    """
    of_tools = (TOOL_POSES,) if r.chain.runtime_tool else ()
    arguments = (*of_tools, *PARAMETERS[kind])
    symbols = _symbols(arguments, r)
    rows = [ca.vec(symbol.T) for symbol in symbols]  # stacks enter as columns, a matrix row by row
    columns = [as_columns(each) for each in r.samples.of(arguments)]
    parameters = symbols[len(of_tools) :]
    tool_a, tool_b = matrices(rows[0]) if of_tools else (None, None)
    a, b = _pose(r, pair.first, tool_a), _pose(r, pair.second, tool_b)
    energy = reference.energy_of(kind, a, b, parameters)
    hessian, gradient = ca.hessian(energy, r.place.coordinates)
    x = ca.SX.sym("x", 12)
    displaced = reference.energy_of(kind, reference.moved(a, x[:6]), reference.moved(b, x[6:]), parameters)
    covariant, wrench = (ca.substitute(each, x, ca.DM.zeros(12)) for each in ca.hessian(displaced, x))
    expressions = {
        "energy": energy,
        "wrench": wrench,
        "task_stiffness": covariant,
        "torque": -gradient,
        "joint_stiffness": hessian,
    }
    return {name: r.evaluate(expression, rows, columns) for name, expression in expressions.items()}


@cache
def _of_pair(index: int, kind: str) -> Callable[[References], Results]:
    """Return the function of the results of a kind of the pair with this number; one for all kernels."""
    return lambda r: results(r, pairs_of(r.chain, r.options.pairs)[index], kind)


def _oracle(index: int, kind: str, names: tuple[str, ...]) -> Oracle:
    return Oracle("differentiated energy", lambda r: tuple(r.of(_of_pair(index, kind))[name] for name in names))


def of_options(options: KernelOptions | None) -> dict[str, tuple[Oracle, ...]]:
    """Return the oracles of the pairs that the options name."""
    options, table = options or KernelOptions(), dict[str, tuple[Oracle, ...]]()
    for index, name in enumerate(names_of(options.pairs)):
        for kind in kinds_of(options.all_springs()):
            group = "_".join(filter(None, (kind, name)))
            for result in ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness"):
                table[f"{group}_{result}"] = (_oracle(index, kind, (result,)),)
            table[f"{group}_linearization"] = (_oracle(index, kind, ("energy", "torque", "joint_stiffness")),)
    return table


ORACLES: dict[str, tuple[Oracle, ...]] = {}
"""Those of pairs follow from the options."""
