# SPDX-License-Identifier: MIT
"""Compare kernels with reference values, and with the CasADi functions from which they were printed.

Errors are relative to the largest entry of the reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

from stiffgen.lower.scalar import Scalar, scalar_of
from stiffgen.robot.chain import Chain
from stiffgen.robot.geometry import FloatArray
from stiffgen.symbolic.arguments import Argument, Q
from stiffgen.symbolic.connection import REPRESENTATIONS
from stiffgen.symbolic.kernels import Kernel, chain_kernels
from stiffgen.symbolic.model import casadi_function, folded
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.verify.poses import (
    gamma_F,
)
from stiffgen.verify.references import References, dynamics_references
from stiffgen.verify.result import Check, Kernels, as_results, compared
from stiffgen.verify.rounding import beyond_rounding, rounding_errors
from stiffgen.verify.samples import (
    Samples,
    argument_samples,
    joint_potential_arguments,
)
from stiffgen.verify.springs import by_hand


def _dynamics_checks(kernels: Kernels, chain: Chain, samples: Samples) -> list[Check]:
    checks = []
    for name, (given, reference) in dynamics_references(chain, samples).items():
        value = kernels[name](*given)
        compare = _ResultComparison(chain, None, "", "differentiated energies", given)
        checks.append(compare.check(name, value, reference))
        if name.endswith(("_matrix", "_stiffness")):
            checks.append(_symmetry(name, value))
    return checks


def _of_one(
    kernels: Kernels, chain: Chain, prefix: str, name: str, oracle: str, reference: FloatArray, *given: FloatArray,
    rounded: str = "constants",
) -> Check:  # fmt: skip
    """Compare the only result of a kernel of a tip with a reference; ``chain`` is the tip's branch."""
    value = kernels[prefix + name](*given)
    return _ResultComparison(chain, None, prefix, oracle, given).check(name, value, reference, rounded=rounded)


def check_kernels(kernels: Kernels, references: References, prefix: str = "") -> list[Check]:
    """Compare the kernels of one tip with every oracle but the CasADi functions they came from.

    ``prefix`` is what stands before the kernels' names where a robot has several tips ("left_hand_").
    """
    samples, wrench = references.samples, references.samples.wrench
    checks = []

    def add(name: str, oracle: str, reference: FloatArray, *arguments: FloatArray) -> None:
        checks.append(_of_one(kernels, references.chain, prefix, name, oracle, reference, *arguments))

    add("forward_kinematics", "product of poses", references.pose, *references.posture)
    checks += _manipulability_checks(kernels, references, prefix)
    held = wrench, samples.task_stiffness, samples.direction
    along = "form differentiated along v"
    add("hybrid_stiffness_direction_gradient", along, references.direction_gradient, *references.posture, *held)
    for rep in REPRESENTATIONS:
        posture = references.posture_of(rep)
        derivative, kinematic = references.derivative[rep], references.kinematic_stiffness(rep)
        add(f"{rep}_jacobian", "differentiated pose", references.jacobian[rep], *posture)
        add(f"{rep}_jacobian_transpose_derivative", "differentiated Jacobian", derivative, *posture)
        add(f"{rep}_kinematic_stiffness", "differentiated Jacobian . F", kinematic, *posture, wrench)
        add(f"{rep}_connection_correction", "cross-product matrices", gamma_F(rep, wrench), wrench)
        for corrected, name, K in (
            (True, "joint_stiffness", samples.task_stiffness),
            (False, "joint_stiffness_uncorrected", samples.general_stiffness),
        ):
            reference = references.joint_stiffness(rep, corrected=corrected)
            add(f"{rep}_{name}", "formula on differentiated Jacobian", reference, *posture, wrench, K)
        Kq = kernels[f"{prefix}{rep}_joint_stiffness"](*posture, wrench, samples.task_stiffness)
        checks.append(_symmetry(f"{prefix}{rep}_joint_stiffness", Kq))
    if not prefix:
        checks += _dynamics_checks(kernels, references.chain, samples) + _joint_potential_checks(
            kernels, references.chain, samples
        )
    return checks + _potential_checks(kernels, references, prefix) + _spring_checks(kernels, references, prefix)


def _manipulability_checks(kernels: Kernels, references: References, prefix: str) -> list[Check]:
    found, checks = references.manipulability, []
    for name, reference, sensitivity in (
        ("manipulability", found.measure, found.measure_error),
        ("manipulability_gradient", found.gradient, found.gradient_error),
    ):
        value = kernels[prefix + name](*references.posture_of("body"))
        errors = partial(np.multiply, np.finfo(np.asarray(value).dtype).eps, sensitivity)
        checks.append(_but_for_rounding(prefix + name, "singular values", value, reference, errors))
    return checks


def _spring_checks(kernels: Kernels, references: References, prefix: str) -> list[Check]:
    chain, checks = references.chain, []
    for spring in references.options.springs():
        expected = references.springs[spring.name]
        arguments = (*references.posture, *references.parameters[spring.name])
        compare = _ResultComparison(chain, references.options, prefix, "differentiated energy", arguments)
        for name, reference in expected.items():
            kernel = f"{spring.name}_{name}"
            value = kernels[prefix + kernel](*arguments)
            checks.append(compare.check(kernel, value, reference))
            if name.endswith("_stiffness"):
                checks.append(_symmetry(prefix + kernel, value))
        kernel = f"{spring.name}_linearization"
        for name, value in zip(
            ("energy", "torque", "joint_stiffness"), kernels[prefix + kernel](*arguments), strict=True
        ):
            checks.append(compare.check(kernel, value, expected[name], name))
    return checks


@dataclass(frozen=True)
class _ResultComparison:
    """Comparison of kernels' results with references, up to the rounding of contributions that cancel.

    Attributes:
        chain: the branch that the kernels are of.
        options: its springs.
        prefix: what stands before the kernels' names where a robot has several tips.
        oracle: name of the references.
        arguments: stacks of the kernels' arguments.

    """

    chain: Chain
    options: SpringOptions | None
    prefix: str
    oracle: str
    arguments: tuple[FloatArray, ...]

    def check(
        self, name: str, value: Any, reference: FloatArray, result: str = "", *, rounded: str = "constants"
    ) -> Check:
        """Compare a result of a kernel: the only one, or the one with a name; ``rounded``: see `rounding_errors`."""
        errors = partial(self.errors, name, value, result, rounded=rounded)
        return _but_for_rounding(self._title(name, result), self.oracle, value, reference, errors)

    def check_form(self, name: str, value: Any, other: _ResultComparison, of: str, reference: FloatArray) -> Check:
        """Compare the only result of a kernel with that of another one, ``of``, which has rounding of its own."""

        def errors() -> FloatArray:
            own = self.errors(name, value, rounded="arguments")
            return np.asarray(np.hypot(own, other.errors(of, reference, rounded="arguments")))

        return _but_for_rounding(self._title(of), self.oracle, value, reference, errors)

    def errors(self, name: str, value: Any, result: str = "", *, rounded: str) -> FloatArray:
        """Return the standard errors of a result's samples, the largest of a sample for all its entries."""
        (kernel,) = (each for each in chain_kernels(self.chain, self.options) if each.qualified_name == name)
        which = [each.name for each in kernel.results].index(result) if result else 0
        found = _rounding(self.chain, kernel, list(self.arguments), scalar_of(value), which, rounded=rounded)
        # Entries that are zero for orthonormal rotations are rounding in the reference.
        whole = np.nan_to_num(found.reshape(len(found), -1), nan=0.0, posinf=0.0).max(axis=1)
        return np.broadcast_to(whole.reshape(-1, *[1] * (found.ndim - 1)), found.shape)

    def _title(self, name: str, result: str = "") -> str:
        return self.prefix + name + (f", {result}" if result else "")


def _joint_potential_checks(kernels: Kernels, chain: Chain, samples: Samples) -> list[Check]:
    checks = []
    for group, given in joint_potential_arguments(samples).items():
        for result, by_joints in by_hand(group, *given).items():
            # A floating base's coordinates come first; the potential does not depend on them.
            own = chain.base_joints
            reference = np.pad(by_joints, [(0, 0), *(by_joints.ndim - 1) * [(own, 0)]])
            name = f"{group}_{result}"
            checks.append(compared(name, "derivatives by hand", kernels[name](*given), reference))
    return checks


def _symmetry(kernel: str, value: Any) -> Check:
    matrices = np.asarray(value)
    return Check(kernel, "bitwise symmetry", float(np.abs(matrices - np.swapaxes(matrices, 1, 2)).max()), 0.0)


def _potential_checks(kernels: Kernels, references: References, prefix: str) -> list[Check]:
    samples, posture, seen_from_tip = references.samples, references.posture, references.posture_of("body")
    body_kernel, hybrid_kernel = (f"{prefix}{rep}_joint_stiffness" for rep in ("body", "hybrid"))
    wrench, covariant, hessian = references.potential
    rotation = references.pose[:, :3, :3]
    turn = np.zeros((len(rotation), 6, 6), dtype=rotation.dtype)
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation
    back = np.swapaxes(turn, 1, 2)

    def turned(vector: FloatArray) -> FloatArray:
        result: FloatArray = np.einsum("sij,sj->si", turn, vector)
        return result

    oracle, chain = "Hessian of a potential", references.chain
    in_hybrid = turned(wrench).astype(float), (turn @ covariant @ back).astype(float)
    seen = wrench.astype(float), covariant.astype(float)
    in_body = np.einsum("sji,sj->si", turn, samples.wrench).astype(float)
    stiffness_in_body = (back @ samples.task_stiffness @ turn).astype(float)
    body_arguments = (*seen_from_tip, in_body, stiffness_in_body)
    hybrid_arguments = (*posture, samples.wrench, samples.task_stiffness)
    as_body, as_hybrid = kernels[body_kernel](*body_arguments), np.asarray(kernels[hybrid_kernel](*hybrid_arguments))
    body, hybrid = (
        _ResultComparison(chain, None, prefix, "body form, turned", each) for each in (body_arguments, hybrid_arguments)
    )
    return [
        _of_one(
            kernels, chain, prefix, "body_joint_stiffness", oracle, hessian, *seen_from_tip, *seen, rounded="arguments"
        ),
        _of_one(
            kernels, chain, prefix, "hybrid_joint_stiffness", oracle, hessian, *posture, *in_hybrid, rounded="arguments"
        ),
        body.check_form("body_joint_stiffness", as_body, hybrid, "hybrid_joint_stiffness", as_hybrid),
    ]


def check_robot(
    kernels: Kernels, chain: Chain, count: int, seed: int, options: SpringOptions | None = None
) -> list[Check]:
    """Compare all kernels of a robot with every oracle but the CasADi functions they came from."""
    if len(chain.tips) == 1:
        return check_kernels(kernels, References(chain, count, seed, options=options))
    whole = Samples.draw(chain, count, seed)
    tips = [References(chain.branch(tip), count, seed + index, whole, options) for index, tip in enumerate(chain.tips)]
    checks = _dynamics_checks(kernels, chain, whole) + _joint_potential_checks(kernels, chain, whole)
    for tip, references in zip(chain.tips, tips, strict=True):
        checks += check_kernels(kernels, references, f"{tip.name}_")
    for rep in REPRESENTATIONS:
        contacts = [
            (*_tool_pose(references), references.samples.wrench, references.samples.task_stiffness)
            for references in tips
        ]
        stacked = [np.stack(each, axis=1) for each in zip(*contacts, strict=True)]
        name = f"{rep}_joint_stiffness_total"
        total = sum(references.joint_stiffness(rep, corrected=True) for references in tips)
        arguments_of_all = (*_shared_posture(tips[0].posture_of(rep), chain), *stacked)
        value = kernels[name](*arguments_of_all)
        compare = _ResultComparison(chain, options, "", "sum of formulas", arguments_of_all)
        checks += [compare.check(name, value, np.asarray(total)), _symmetry(name, value)]
    for spring in tips[0].options.springs():
        given = [np.stack(each, axis=1) for each in zip(*(r.parameters[spring.name] for r in tips), strict=True)]
        poses = [np.stack(each, axis=1) for each in zip(*map(_tool_pose, tips), strict=True)]
        where = _shared_posture(tips[0].posture, chain)
        for result in ("energy", "torque", "joint_stiffness"):
            name = f"{spring.name}_{result}_total"
            total = np.asarray(sum(references.springs[spring.name][result] for references in tips))
            stacks = (*where, *poses, *given)
            compare = _ResultComparison(chain, options, "", "sum of differentiated energies", stacks)
            checks.append(compare.check(name, kernels[name](*stacks), total))
    return checks


def _tool_pose(references: References) -> tuple[FloatArray, ...]:
    """Return the argument that each tip has for itself: the pose of its tool, if it is an argument."""
    return (references.samples.tool_pose,) if references.chain.runtime_tool else ()


def _shared_posture(posture: tuple[FloatArray, ...], chain: Chain) -> tuple[FloatArray, ...]:
    """Return the configuration arguments that all tips share."""
    return posture[:-1] if chain.runtime_tool else posture


FAR = (1.5e4, -1.0e6, 3.0e9)
"""Angles beyond the range that the generated code reduces itself."""


def check_far_angles(kernels: Kernels, chain: Chain, seed: int, options: SpringOptions | None = None) -> list[Check]:
    """Compare kernels with the CasADi functions, with one joint many turns away at a time.

    Chains with mimic joints are left out: either code rounds multiplied and shifted positions in its own way.
    """
    turning = [k for k, coordinate in enumerate(chain.coordinates) if coordinate.type != "prismatic"]
    if chain.coupled or not turning:
        return []
    pool = argument_samples(chain, len(FAR) * len(turning), seed, options)
    for row, (angle, joint) in enumerate((angle, joint) for angle in FAR for joint in turning):
        pool[Q][row, joint] = angle
    return [
        replace(check, oracle="CasADi, many turns away") for check in _against_casadi(kernels, chain, pool, options)
    ]


def check_against_casadi(
    kernels: Kernels, chain: Chain, count: int, seed: int, options: SpringOptions | None = None
) -> list[Check]:
    """Compare kernels with the CasADi functions of the same chain (the C printing and the compiler)."""
    pool = argument_samples(chain, count, seed, options)
    general = Samples.draw(chain, count, seed).general_stiffness
    pool |= {argument: general for argument in pool if argument.name == "task_stiffness"}
    return _against_casadi(kernels, chain, pool, options)


@lru_cache(maxsize=1)
def _formulas(chain: Chain, options: SpringOptions | None) -> list[tuple[Kernel, ca.Function]]:
    """Yield every kernel with its CasADi function; making the functions takes as long as all comparisons."""
    return [(kernel, casadi_function(chain, kernel)) for kernel in chain_kernels(chain, options)]


def _against_casadi(
    kernels: Kernels, chain: Chain, pool: dict[Argument, FloatArray], options: SpringOptions | None
) -> list[Check]:
    checks = []
    for kernel, function in _formulas(chain, options):
        arguments = [pool[argument] for argument in kernel.arguments]
        folds = [folded(argument.array(chain).shape) for argument in kernel.arguments]
        each = [
            as_results(function(*(a.reshape(f) for a, f in zip(one, folds, strict=True))))
            for one in zip(*arguments, strict=True)
        ]
        values = as_results(kernels[kernel.qualified_name](*arguments))
        for k, (result, value, stack) in enumerate(zip(kernel.results, values, zip(*each, strict=True), strict=True)):
            name = kernel.qualified_name + (f", {result.name}" if len(values) > 1 else "")
            reference = np.stack([np.asarray(one).reshape(result.array(chain).shape) for one in stack])
            errors = partial(_rounding, chain, kernel, arguments, scalar_of(value), k)
            checks.append(_but_for_rounding(name, "closed form in CasADi", value, reference, errors))
    return checks


def _but_for_rounding(
    name: str, oracle: str, value: Any, reference: FloatArray, errors: Callable[[], FloatArray]
) -> Check:
    """Compare a value with its reference, up to the rounding of contributions that cancel."""
    check = compared(name, oracle, value, reference)
    if check.passed:
        return check
    rest = beyond_rounding(np.asarray(value) - reference, errors())
    return compared(name, oracle, (reference + rest).astype(np.asarray(value).dtype), reference)


def _rounding(
    chain: Chain, kernel: Kernel, given: list[FloatArray], scalar: Scalar, which: int, *, rounded: str = ""
) -> FloatArray:
    """Return the standard errors of one result of a kernel, zero where they are unknown."""
    found = rounding_errors(chain, kernel, given, scalar, rounded=rounded)
    return np.zeros((len(given[0]), *kernel.results[which].array(chain).shape)) if found is None else found[which]
