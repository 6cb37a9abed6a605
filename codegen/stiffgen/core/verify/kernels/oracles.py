# SPDX-License-Identifier: MIT
"""Oracles: independent sources of the values of every kernel, by its group and name.

A kernel without an oracle is a failed check: the comparison with the CasADi functions sees the printing alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from stiffgen.core.family import families
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.comparison import KernelCall, Oracle, but_for_rounding, symmetry
from stiffgen.core.verify.kernels.poses import gamma_F
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH, References
from stiffgen.core.verify.result import NO_ORACLE, Check, Kernels

Oracles = dict[str, tuple[Oracle, ...]]


def _of_representation(rep: Representation) -> Oracles:
    """Return the oracles of the kernels of a representation."""

    def stiffness(r: References, *, corrected: bool) -> FloatArray:
        return r.joint_stiffness(rep, corrected=corrected)

    formula = "formula on differentiated Jacobian"
    return {
        f"{rep}_jacobian": (Oracle("differentiated pose", lambda r: r.jacobian[rep]),),
        f"{rep}_jacobian_transpose_derivative": (Oracle("differentiated Jacobian", lambda r: r.derivative[rep]),),
        f"{rep}_kinematic_stiffness": (Oracle("differentiated Jacobian . F", lambda r: r.kinematic_stiffness(rep)),),
        f"{rep}_connection_correction": (Oracle("cross-product matrices", lambda r: gamma_F(rep, r.samples[WRENCH])),),
        f"{rep}_joint_stiffness": (Oracle(formula, partial(stiffness, corrected=True)),),
        f"{rep}_joint_stiffness_uncorrected": (Oracle(formula, partial(stiffness, corrected=False)),),
    }  # fmt: skip


def _turned_to_hybrid(r: References) -> tuple[FloatArray, FloatArray]:
    """Return wrench and covariant Hessian of the potential in hybrid axes."""
    wrench, covariant, _ = r.potential
    turn = _turns(r)
    in_hybrid = np.einsum("sij,sj->si", turn, wrench)
    return in_hybrid.astype(float), (turn @ covariant @ _back(turn)).astype(float)


def _turns(r: References) -> Any:
    """Return blkdiag(R, R) in every state, R the tip's rotation: it turns body wrenches to hybrid ones."""
    rotation = r.pose[:, :3, :3]
    turn = np.zeros((len(rotation), 6, 6), dtype=rotation.dtype)
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation
    return turn


def _back(turn: Any) -> Any:
    """Return the transposes of matrices."""
    return np.swapaxes(turn, 1, 2)


def _in_body_axes(r: References) -> tuple[FloatArray, FloatArray]:
    """Return wrench and covariant Hessian of the potential in body axes."""
    wrench, covariant, _ = r.potential
    return wrench.astype(float), covariant.astype(float)


def _of_potential(loads: Any) -> Oracle:
    return Oracle("Hessian of a potential", lambda r: r.potential[2], loads=loads, rounded="arguments")


ORACLES: Oracles = {
    "forward_kinematics": (Oracle("product of poses", lambda r: r.pose),),
    **{name: oracles for rep in REPRESENTATIONS for name, oracles in _of_representation(rep).items()},
}
"""Oracles of the core's kernels by group and name; families have those of their own (:func:`oracles_of`)."""
ORACLES["body_joint_stiffness"] += (_of_potential(_in_body_axes),)
ORACLES["hybrid_joint_stiffness"] += (_of_potential(_turned_to_hybrid),)


def oracles_of(options: KernelOptions | None) -> Oracles:
    """Return the table with the oracles of all families, also of a user's potentials."""
    table = dict(ORACLES)
    for family in families():
        if family.oracles:
            module = import_module(f"stiffgen.families.{family.oracles}")
            table |= module.ORACLES
            if hasattr(module, "of_options"):
                table |= module.of_options(options)
    return table


def _found(table: Oracles, kernel: Kernel) -> tuple[Oracle, ...]:
    """Return the oracles of a kernel; a total over the tips has the sum of the tips' references."""
    if not kernel.by_tips:
        return table.get(kernel.function, ())
    return tuple(map(_sum_over_tips, table.get(kernel.function.removesuffix("_total"), ())[:1]))


def _sum_over_tips(of: Oracle) -> Oracle:
    """Return the oracle of a total from that of one tip."""

    def total(r: References) -> Any:
        each = [of.values(tip) for tip in r.tips]
        return tuple(map(sum, zip(*each, strict=True))) if isinstance(each[0], tuple) else sum(each)

    return Oracle(f"sum over the tips: {of.name}", total)


def check_oracles(table: Iterable[Kernel], options: KernelOptions | None = None) -> list[Check]:
    """Return a failed check for every kernel without an oracle.

    A vector-Jacobian product is compared with differences of its kernel
    (:mod:`stiffgen.families.derivatives.check`), the closure of loops with their equations
    (:mod:`stiffgen.families.loops.oracles`).
    """
    known, kernels = oracles_of(options), tuple(table)
    names, checks = {(kernel.path, kernel.name) for kernel in kernels}, list[Check]()
    for kernel in kernels:
        is_product = (kernel.path, kernel.product_of) in names
        if not (_found(known, kernel) or is_product or kernel.name == "close"):
            place = f'write ORACLES["{kernel.function}"] in the family\'s oracles.py'
            remedy = f"{place}, from a source that shares no code"
            checks.append(Check(kernel.qualified_name, NO_ORACLE, math.inf, 0.0, remedy))
    return checks


def check_robot(
    kernels: Kernels,
    chain: Chain,
    count: int,
    seed: int,
    options: KernelOptions | None = None,
    table: Sequence[Kernel] | None = None,
) -> list[Check]:
    """Compare all kernels of a robot with their oracles; ``table`` has those of a folder with fewer."""
    return check_kernels(kernels, References(chain, count, seed, options), table)


def check_kernels(kernels: Kernels, references: References, table: Sequence[Kernel] | None = None) -> list[Check]:
    """Compare kernels of a robot with their oracles, at the samples of the references."""
    chain, options, checks = references.chain, references.options, list[Check]()
    known, table = oracles_of(options), chain_kernels(chain, options) if table is None else table
    tips = {tip.name: of_tip for tip, of_tip in zip(chain.tips, references.tips, strict=True)}
    for kernel in table:
        references_of_tip = tips[kernel.tip.name] if kernel.tip else references
        oracles = [oracle for oracle in _found(known, kernel) if not oracle.closed]
        for oracle in oracles:
            checks += oracle.checks(kernels, chain, kernel, references_of_tip)
        if oracles:
            checks += _symmetries(kernels, chain, kernel, references_of_tip)
        if kernel.function == "body_joint_stiffness":
            checks.append(_check_body_form(kernels, chain, kernel, references_of_tip))
    return checks


def _symmetries(kernels: Kernels, chain: Chain, kernel: Kernel, at: References) -> list[Check]:
    """Return a check for each symmetric result."""
    if not any(result.symmetric for result in kernel.results):
        return []
    call = KernelCall(kernels, chain, kernel, at.samples.of(kernel.arguments))
    return [symmetry(call.title(k), call.values[k]) for k, result in enumerate(kernel.results) if result.symmetric]


def _check_body_form(kernels: Kernels, chain: Chain, body: Kernel, at: References) -> Check:
    """Compare the hybrid joint stiffness with the body one at turned wrench and stiffness; each has its rounding."""
    functions = chain_kernels(chain)
    hybrid = next(each for each in functions if each.function == "hybrid_joint_stiffness" and each.tip == body.tip)
    turn = _turns(at)  # from body to hybrid axes
    wrench_in_body = np.einsum("sji,sj->si", turn, at.samples[WRENCH])
    stiffness_in_body = _back(turn) @ at.samples[TASK_STIFFNESS] @ turn
    body_arguments = *at.posture_of("body"), wrench_in_body.astype(float), stiffness_in_body.astype(float)
    in_body = KernelCall(kernels, chain, body, body_arguments, "arguments")
    in_hybrid = KernelCall(kernels, chain, hybrid, at.samples.of(hybrid.arguments), "arguments")

    def errors() -> FloatArray:
        return np.asarray(np.hypot(in_body.largest_errors(0), in_hybrid.largest_errors(0)))

    value, reference = in_body.values[0], np.asarray(in_hybrid.values[0])
    return but_for_rounding(hybrid.qualified_name, "body form, turned", value, reference, errors)
