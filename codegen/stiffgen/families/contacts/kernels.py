# SPDX-License-Identifier: MIT
"""Sums over several tips: contacts and springs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import over_joints, pairs_on_the_way
from stiffgen.core.symbolic.program import Array, Program
from stiffgen.core.symbolic.steps import ArgumentSlice, StraightLine, Sum, SumJoints, Term
from stiffgen.families.contacts import expressions as contacts
from stiffgen.families.springs.springs import Spring


def joint_stiffness_total(
    chain: Chain, representation: Representation, result: Argument, inputs: tuple[Argument, ...]
) -> Program:
    """Return the program of the tips' joint stiffnesses, added up: one triangle, mirrored.

    ``inputs`` are the arguments of the kernel.
    """

    def steps(output: Array) -> Program:
        S, u = (Array(name, (6, len(chain.joints))) for name in ("S", "u"))
        expressions = partial(contacts.columns_and_covectors, representation=representation)
        arguments = tuple(argument.array(chain) for argument in inputs)
        heading = "columns S of the joints at one point; covectors u of the loads beyond each joint"
        step = StraightLine((S, u), expressions, arguments, heading=heading, columns=2)
        return step, *pairs_on_the_way(chain, S, u, output, "Kq_ij = S_i . u_j", ca.dot)

    return over_joints(chain, result, steps, mirror=True)


def spring_total(
    chain: Chain,
    spring: Spring,
    inputs: tuple[Argument, ...],
    results: Mapping[str, Argument],
) -> Program:
    """Return the program of the springs at all tips, in one pass over the tree.

    ``inputs`` are the arguments of the kernel; ``results`` holds results under the names "energy", "torque" and
    "joint_stiffness", or some of them.
    """
    energy, torque, joint_stiffness = (results.get(name) for name in ("energy", "torque", "joint_stiffness"))
    m = len(chain.joints)
    S, u = Array("S", (6, m)), Array("u", (6, m))
    # arrays and heading by the letter of contacts.spring_terms; columns of joints must come first
    quantities: dict[str, tuple[tuple[Array, ...], str]] = {}
    if joint_stiffness:
        quantities["S"] = (S, u), "columns S of the joints at one point; covectors u of the loads beyond each joint"
    if energy:
        quantities["U"] = (energy.array(chain),), "energy U"
    sum_of_torques: Program = ()  # over the joints of each coordinate
    if torque:
        total = torque.array(chain)
        of_joints = Array(f"{torque.name}_of_joints", (m,)) if chain.coupled else total
        sum_of_torques = (SumJoints(of_joints, total),) if chain.coupled else ()
        heading = "torques -S_j . W_j of the joints, W_j the sum of the wrenches beyond joint j"
        quantities["T"] = (of_joints,), heading
    step = StraightLine(
        outputs=tuple(array for arrays, _ in quantities.values() for array in arrays),
        expressions=partial(contacts.spring_terms, spring=spring, parts="".join(quantities)),
        arguments=tuple(argument.array(chain) for argument in inputs),
        heading="; ".join(heading for _, heading in quantities.values()),
        columns=2 if joint_stiffness else 0,
    )
    program: Program = (step, *sum_of_torques)
    if joint_stiffness:
        program += over_joints(
            chain,
            joint_stiffness,
            lambda output: pairs_on_the_way(chain, S, u, output, "Kq_ij = S_i . u_j", ca.dot),
            mirror=True,
        )
    return program


def _total_program(chain: Chain, of: Kernel, inputs: tuple[Argument, ...], results: tuple[Argument, ...]) -> Program:
    """Return the sum of a kernel's results over the tips.

    Every argument outside the configuration holds one value per tip.
    """
    arrays = [(argument.array(chain), argument.of_configuration) for argument in inputs]
    terms = []
    for index, tip in enumerate(chain.tips):
        kernel = replace(of, tip=tip)
        parameters = [argument.array(chain) for argument in kernel.arguments]
        slices = (ArgumentSlice(array, None if shared else index) for array, shared in arrays)
        pairs = tuple(zip(parameters, slices, strict=True))
        terms.append(Term(kernel.qualified_name, kernel.scope(chain), kernel.steps(chain), pairs))
    outputs = tuple(result.array(chain) for result in results)
    return (Sum(outputs, tuple(result.name for result in of.results), tuple(terms)),)


def _total(chain: Chain, of: Kernel, summary: str, note: str, spring: Spring | None = None) -> Kernel:
    """Return the kernel that sums the results of a kernel over the tips; ``spring`` is the kernel's, if any."""
    names = [tip.name for tip in chain.tips]
    inputs = tuple(each if each.of_configuration else each.of_all_tips(names) for each in of.arguments)
    results = tuple(
        replace(
            result,
            name=f"{result.name}_total",
            meaning="sum over the tips" + (", bitwise symmetric" if result.symmetric else ""),
        )
        for result in of.results
    )
    by_tips = partial(_total_program, of=of, inputs=inputs, results=results)
    one_pass: Callable[[Chain], Program]
    if spring:
        parts = {result.name: total for result, total in zip(of.results, results, strict=True)}
        one_pass = partial(spring_total, spring=spring, inputs=inputs, results=parts)
    else:
        representation = next(each for each in REPRESENTATIONS if each == of.group)
        (result,) = results
        one_pass = partial(joint_stiffness_total, representation=representation, result=result, inputs=inputs)
    equation = f"sum over the tips of {of.equation}"
    return Kernel(
        name=f"{of.name}_total",
        group=of.group,
        arguments=inputs,
        results=results,
        summary=summary,
        equation=equation,
        program=one_pass,
        note=note,
        batch=True,
        by_tips=by_tips,
    )


def total_kernels(chain: Chain, kernels: tuple[Kernel, ...], springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    """Return the sums over the tips of the stiffnesses and springs among the ``kernels`` of one tip."""
    spring_of = {spring.name: spring for spring in springs}
    totals = []
    for kernel in kernels:
        if kernel.group in REPRESENTATIONS and kernel.name == "joint_stiffness":
            summary = "Symmetric joint stiffness of the contacts at all tips, added up."
            note = "For a tip without contact, pass zero wrench and task stiffness."
            totals.append(_total(chain, kernel, summary, note))
        if kernel.group in spring_of and kernel.name in ("energy", "torque", "joint_stiffness", "linearization"):
            summary = f"{kernel.summary} Sum over the springs at all tips."
            note = "For a tip without a spring, pass zero stiffnesses."
            totals.append(_total(chain, kernel, summary, note, spring_of[kernel.group]))
    return tuple(totals)
