# SPDX-License-Identifier: MIT
"""Oracles for the kernels of a generated robot, independent of the code that generated them.

What the kernels compute in closed form is computed here another way, from the chain's joint poses alone:

* pose: a plain product of 4x4 matrices with Rodrigues' formula;
* Jacobians: CasADi's differentiation of that pose, J = vee(H^-1 dH) and its relatives;
* dJ^T/dq: CasADi's differentiation of those Jacobians; the kinematic stiffness is its contraction;
* Gamma F: the matrix forms in cross-product matrices, written down;
* joint stiffness: the paper's formula put together from the above; and the joint Hessian of a potential
  U(p, R) along the pose, which it must equal for F = dU and K = the covariant Hessian;
* mass matrix, bias forces and gravity: kinetic and potential energy, differentiated (:mod:`stiffgen.verify.dynamics`);
* vector-Jacobian products: differences of the functions that they belong to, of eighth order.

Errors are relative to the largest entry of the reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from stiffgen.errors import StiffgenError
from stiffgen.folder import temporary_folder
from stiffgen.lower.scalar import Scalar, scalar_of
from stiffgen.opened import GeneratedRobot, open_robot
from stiffgen.robot.chain import Chain
from stiffgen.symbolic import arguments
from stiffgen.symbolic.arguments import Argument, Q
from stiffgen.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.symbolic.joint_potentials import JOINT_POTENTIALS
from stiffgen.symbolic.kernels import Kernel, chain_kernels
from stiffgen.symbolic.model import casadi_function, folded
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.springs import Spring
from stiffgen.verify.batches import LONG, check_c_batches, check_stacks
from stiffgen.verify.bounds import check_bounds
from stiffgen.verify.certified import check_certified_bounds
from stiffgen.verify.controller import check_controller
from stiffgen.verify.derivatives import check_derivatives
from stiffgen.verify.dynamics import differentiated as differentiated_energies
from stiffgen.verify.files import (
    check_files,
    check_functions,
    check_tables,
    check_text,
    check_urdf,
    load_module,
    print_again,
)
from stiffgen.verify.masses import check_masses
from stiffgen.verify.missing import missing_functions, without_missing
from stiffgen.verify.not_finite import check_not_finite
from stiffgen.verify.result import Array, Check, Kernels, as_results, compared, one_by_one
from stiffgen.verify.rounding import beyond_rounding, rounding_errors
from stiffgen.verify.sessions import check_sessions
from stiffgen.verify.springs import by_hand, differentiated
from stiffgen.verify.widths import build_widths


@dataclass(frozen=True)
class Samples:
    """Random states: q within the limits, wrenches, symmetric and general task stiffness, and potential data."""

    q: Array
    wrench: Array
    task_stiffness: Array
    general_stiffness: Array
    tool_pose: Array
    equilibrium: Array
    translation_stiffness: Array
    rotation_stiffness: Array
    stiffness: Array
    posture: Array
    posture_stiffness: Array
    lower: Array
    upper: Array
    zone: Array
    limit_stiffness: Array
    velocity: Array
    gravity: Array
    base_pose: Array

    @staticmethod
    def draw(chain: Chain, count: int, seed: int) -> Samples:
        """Uniform postures (unbounded joints: one turn, one metre), wrenches of tens of N and some N m."""
        random = np.random.default_rng(seed)
        reach = [math.pi if c.type != "prismatic" else 1.0 for c in chain.coordinates]
        lower = [max(c.lower, -r) for c, r in zip(chain.coordinates, reach, strict=True)]
        upper = [min(c.upper, r) for c, r in zip(chain.coordinates, reach, strict=True)]
        # Limits wholly beyond the reach: sample at the nearer limit.
        upper = [max(a, b) for a, b in zip(lower, upper, strict=True)]
        general = random.normal(size=(count, 6, 6)) * 100 + np.diag([700.0, 700, 800, 30, 30, 30])
        q = random.uniform(lower, upper, (count, len(chain.coordinates)))
        # Every joint at or beyond its lower and its upper limit in turn, now and then at both or none of them.
        joints = np.random.default_rng([seed, 1])
        turn = (np.arange(count)[:, None] + np.arange(q.shape[1])) % 2 == 0
        odd = np.arange(count)[:, None] % 4 == 3
        at_lower = np.where(odd, joints.random(q.shape) < 0.5, turn)
        at_upper = np.where(odd, joints.random(q.shape) < 0.5, ~turn)
        near, away = joints.uniform(-0.2, 0.15, (2, *q.shape)), joints.uniform(0.5, 1.5, (2, *q.shape))
        return Samples(
            q=q,
            wrench=random.normal(size=(count, 6)) * np.array([30.0, 30, 30, 10, 10, 10]),
            task_stiffness=(general + general.transpose(0, 2, 1)) / 2,
            general_stiffness=general,
            tool_pose=_random_poses(random, count),
            equilibrium=_random_poses(random, count),
            translation_stiffness=_random_positive(random, count, 3, 300.0),
            rotation_stiffness=_random_positive(random, count, 3, 20.0),
            stiffness=_random_positive(random, count, 6, 30.0),
            posture=joints.uniform(-2.0, 2.0, q.shape),
            posture_stiffness=joints.uniform(0.5, 20.0, q.shape),
            lower=q - np.where(at_lower, near[0], away[0]),
            upper=q + np.where(at_upper, near[1], away[1]),
            zone=joints.uniform(0.2, 0.4, count),
            limit_stiffness=joints.uniform(50.0, 500.0, q.shape),
            velocity=joints.normal(size=(count, chain.dof)),
            gravity=joints.normal(size=(count, 3)) * 6.0,
            base_pose=_random_poses(np.random.default_rng([seed, 2]), count),
        )

    def of(self, argument: Argument, seed: int) -> Array:
        """The values of a kernel's argument; what a user's potential takes is drawn for it."""
        known = getattr(self, argument.name, None)
        if known is not None and len(known.shape) == 1 + len(argument.shape):
            sizes = zip(argument.shape, known.shape[1:], strict=True)
            if all(extent in ("n", "q", size) for extent, size in sizes):
                values: Array = known
                return values
        return _random_parameter(argument, len(self.q), seed, self.velocity.shape[1])

    def __getitem__(self, argument: str) -> Array:
        """The values of a kernel's argument by its name."""
        values: Array = getattr(self, argument)
        return values


def _random_poses(random: np.random.Generator, count: int) -> Array:
    """Orientations from random quaternions, positions of some decimetres."""
    w, x, y, z = (lambda quaternion: quaternion / np.linalg.norm(quaternion, axis=0))(random.normal(size=(4, count)))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    poses = np.zeros((count, 4, 4))
    poses[:, :3, :3] = np.array(rows).transpose(2, 0, 1)
    poses[:, :3, 3] = random.normal(size=(count, 3)) * 0.2
    poses[:, 3, 3] = 1
    return poses


def _random_parameter(argument: Argument, count: int, seed: int, dof: int) -> Array:
    """Values of about 1: of both signs for cotangents, positive for what a user's potential takes."""
    extents = [dof if extent == "n" else int(extent) for extent in argument.shape]
    if argument.own:
        cotangents: Array = np.random.default_rng([seed, *argument.name.encode()]).normal(size=(count, *extents))
        return cotangents
    return np.random.default_rng(seed + 77).uniform(0.2, 2.0, (count, *extents))


def _random_positive(random: np.random.Generator, count: int, size: int, scale: float) -> Array:
    """Symmetric positive definite matrices, nothing diagonal about them."""
    roots = random.normal(size=(count, size, size))
    matrices: Array = scale * (roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(size))
    return matrices


def joint_poses(chain: Chain, q: ca.SX, base_pose: ca.SX | None = None) -> list[ca.SX]:
    """Pose of every joint's frame in the base, or in the world where ``base_pose`` is, by plain 4x4 products."""
    own = chain.base_joints
    base = ca.SX.eye(4) if base_pose is None else base_pose
    joints: list[ca.SX] = own * [base]
    for joint in chain.joints[own:]:
        pose = joints[joint.parent] if joint.parent >= 0 else base
        position = joint.multiplier * q[joint.coordinate - own] + joint.offset
        axis = ca.DM(joint.axis)
        motion = ca.SX.eye(4)
        if joint.type == "prismatic":
            motion[:3, 3] = axis * position
        else:
            cross = ca.skew(axis)
            motion[:3, :3] = ca.DM.eye(3) + ca.sin(position) * cross + (1 - ca.cos(position)) * (cross @ cross)
        joints.append(pose @ _homogeneous(joint.rotation, joint.translation) @ motion)
    return joints


def product_of_poses(chain: Chain, q: ca.SX, base_pose: ca.SX | None = None) -> ca.SX:
    """Pose (4x4) of the chain's only tip in the base, or the world, by plain 4x4 products."""
    (tip,) = chain.tips
    return joint_poses(chain, q, base_pose)[tip.joint] @ _homogeneous(chain.tip_rotation, chain.tip_translation)


def _homogeneous(rotation: Any, translation: Any) -> ca.DM:
    return ca.vertcat(ca.horzcat(ca.DM(rotation), ca.DM(translation)), ca.DM([[0, 0, 0, 1]]))


def _vee(matrix: ca.SX) -> ca.SX:
    return ca.vertcat(matrix[0, 3], matrix[1, 3], matrix[2, 3], matrix[2, 1], matrix[0, 2], matrix[1, 0])


def _inverse(pose: ca.SX) -> ca.SX:
    rotation = pose[:3, :3].T
    return ca.vertcat(ca.horzcat(rotation, -rotation @ pose[:3, 3]), ca.SX([[0, 0, 0, 1]]))


def _jacobian(pose: ca.SX, q: ca.SX, representation: Representation) -> ca.SX:
    """By differentiation of the pose."""
    columns = []
    for k in range(q.shape[0]):
        rate = ca.jacobian(ca.vec(pose), q[k]).reshape((4, 4))
        body = _vee(_inverse(pose) @ rate)
        if representation == "body":
            columns.append(body)
        elif representation == "spatial":
            columns.append(_vee(rate @ _inverse(pose)))
        else:
            rotation = pose[:3, :3]
            columns.append(ca.vertcat(rate[:3, 3], rotation @ body[3:]))
    return ca.horzcat(*columns)


class Place:
    """Symbols of a configuration: joint positions, the base's pose, and how far the base has moved from there.

    Coordinates are those motions (none if the base stands), then the joint positions. The base moves by x = (v, w) to
    p + R v, R exp([w]), of which two derivatives at zero are exact.
    """

    def __init__(self, chain: Chain) -> None:
        self.floating = chain.floating
        self.q = ca.SX.sym("q", len(chain.coordinates))
        self.base_pose = ca.SX.sym("B", 16)  # row by row
        self.moves = ca.SX.sym("x", chain.base_joints)

    @property
    def coordinates(self) -> ca.SX:
        """What derivatives are taken by."""
        return ca.vertcat(self.moves, self.q)

    def base(self, *further: ca.SX) -> ca.SX | None:
        """Pose of the base after its motion, and after ``further`` ones; None if it stands."""
        if not self.floating:
            return None
        pose = self.base_pose.reshape((4, 4)).T
        for moves in (self.moves, *further):
            turn = ca.skew(moves[3:])
            rotation = ca.SX.eye(3) + turn + turn @ turn / 2
            pose = pose @ ca.blockcat([[rotation, moves[:3]], [ca.SX.zeros(1, 3), ca.SX.ones(1)]])
        return pose


def gamma_F(representation: Representation, wrench: Array) -> Array:
    """Gamma F in cross-product matrices (facts of the paper's appendix), for a stack of wrenches."""
    force, moment = (_cross_matrices(wrench[..., part]) for part in (slice(0, 3), slice(3, 6)))
    result = np.zeros((*wrench.shape[:-1], 6, 6))
    if representation == "hybrid":
        result[..., 3:, 3:] = np.swapaxes(moment, -1, -2) / 2
        return result
    result[..., :3, 3:] = force
    result[..., 3:, 3:] = moment / 2
    return result if representation == "body" else np.swapaxes(result, -1, -2)


def _cross_matrices(v: Array) -> Array:
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, -2)


class References:
    """Reference values of the kernels of one tip at random samples.

    Args:
        chain: the robot, or the branch to one of its tips.
        count: number of samples.
        seed: of the random generator.
        at: where joint positions and base poses are taken from instead of random ones.
        options: springs beyond the default one.

    """

    def __init__(
        self, chain: Chain, count: int, seed: int, at: Samples | None = None, options: SpringOptions | None = None
    ) -> None:
        self.chain = chain
        self.options = options or SpringOptions()
        self.samples = Samples.draw(chain, count, seed)
        if at is not None:
            self.samples = replace(self.samples, q=at.q, base_pose=at.base_pose)
        place, tool = Place(chain), ca.SX.sym("T", 16)
        self._symbols, self._moves, symbol = (place.q, place.base_pose, tool), place.moves, place.coordinates
        mounted = tool.reshape((4, 4)).T if chain.runtime_tool else ca.SX.eye(4)
        pose = product_of_poses(chain, place.q, place.base()) @ mounted
        self.pose = self._evaluate(pose)
        # Rates of the coordinates, wherever the base has moved to.
        moves = ca.SX.sym("s", chain.base_joints)
        moved = product_of_poses(chain, place.q, place.base(moves)) @ mounted
        self.jacobian: dict[str, Array] = {}
        self.derivative: dict[str, Array] = {}
        for representation in REPRESENTATIONS:
            jacobian = _jacobian(moved, ca.vertcat(moves, place.q), representation)
            jacobian = ca.substitute(jacobian, moves, ca.DM.zeros(chain.base_joints))
            self.jacobian[representation] = self._evaluate(jacobian)
            # vec() stacks columns: row b*6 + k of the derivative is J[k, b].
            derivative = self._evaluate(ca.jacobian(ca.vec(jacobian), symbol))
            n = chain.dof
            # Of a single joint it is zero: what differentiation leaves of it is the rounding of sums in the columns.
            rounding = 64 * np.finfo(float).eps * np.abs(self.jacobian[representation]).max(axis=(1, 2))
            derivative[np.abs(derivative).max(axis=(1, 2)) <= rounding] = 0.0
            self.derivative[representation] = derivative.reshape(count, n, 6, n).transpose(0, 3, 1, 2)
        self.potential = self._potential(symbol, pose, seed)
        self.parameters: dict[str, list[Array]] = {}
        self.springs = {spring.name: self._spring(spring, symbol, pose, seed) for spring in self.options.springs()}

    @property
    def posture(self) -> tuple[Array, ...]:
        """What the kernels take before everything else: q, and the poses of base and tool where they are arguments."""
        given = arguments.configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=self.chain.floating)
        return tuple(self.samples[argument.name] for argument in given)

    def posture_of(self, representation: Representation) -> tuple[Array, ...]:
        """The same for the kernels of a representation: seen from the tip, the base's place does not matter."""
        based = self.chain.floating and representation != "body"
        given = arguments.configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=based)
        return tuple(self.samples[argument.name] for argument in given)

    @property
    def _columns(self) -> list[Array]:
        """The stacks of what expressions depend on, as columns."""
        samples = self.samples
        return [each.reshape(len(each), -1).T for each in (samples.q, samples.base_pose, samples.tool_pose)]

    def _function(self, given: list[ca.SX], expression: ca.SX) -> ca.Function:
        there = ca.substitute(expression, self._moves, ca.DM.zeros(self._moves.shape[0]))
        return ca.Function("f", [*self._symbols, *given], [ca.densify(there)], {})

    def _evaluate(self, expression: ca.SX) -> Array:
        count = len(self.samples.q)
        rows, columns = expression.shape
        mapped = np.asarray(self._function([], expression).map(count)(*self._columns))
        return np.ascontiguousarray(mapped.reshape(rows, -1, columns).transpose(1, 0, 2))

    def _spring(self, spring: Spring, q: ca.SX, pose: ca.SX, seed: int) -> dict[str, Array]:
        """Results of a spring's kernels by name, from its differentiated energy."""
        count = len(self.samples.q)
        symbols = [ca.SX.sym(a.name, *folded(a.array(self.chain).shape)) for a in spring.parameters]
        stacks = self.parameters[spring.name] = [
            self.samples.of(argument, seed + k) for k, argument in enumerate(spring.parameters)
        ]
        # Stacks go in as columns, a matrix row by row.
        given = [ca.vec(symbol.T) for symbol in symbols]
        columns = [*self._columns, *(each.reshape(count, -1).T for each in stacks)]
        results = {}
        for name, expression in differentiated(spring, self.options.placement, pose, q, symbols).items():
            rows, width = expression.shape
            function = self._function(given, expression)
            mapped = np.asarray(function.map(count)(*columns)).reshape(rows, -1, width).transpose(1, 0, 2)
            shape = {"energy": (count,), "wrench": (count, rows), "torque": (count, rows)}.get(name, mapped.shape)
            results[name] = np.ascontiguousarray(mapped).reshape(shape)
        return results

    def _potential(self, q: ca.SX, pose: ca.SX, seed: int) -> tuple[Array, Array, Array]:
        """(F = dU, covariant Hessian K, joint Hessian) of a potential of position and orientation."""
        random = np.random.default_rng(seed + 1)
        stiff = random.normal(size=(3, 3)) * 100
        stiff, centre = stiff @ stiff.T / 100, random.normal(size=3)
        turning, mixed = random.normal(size=(3, 3)) * 30, random.normal(size=(3, 9)) * 20

        def potential(position: ca.SX, rotation: ca.SX) -> ca.SX:
            away = position - centre
            linear = ca.dot(ca.DM(turning), rotation)
            return away.T @ ca.DM(stiff) @ away / 2 + linear + away.T @ ca.DM(mixed) @ ca.vec(rotation)

        x = ca.SX.sym("x", 6)
        turn = ca.skew(x[3:])
        position, rotation = pose[:3, 3], pose[:3, :3]
        # exp([w]) to second order: its first two derivatives at zero are exact.
        moved = potential(position + rotation @ x[:3], rotation @ (ca.DM.eye(3) + turn + turn @ turn / 2))
        hessian, gradient = ca.hessian(moved, x)
        wrench, covariant = (ca.substitute(e, x, ca.DM.zeros(6)) for e in (gradient, hessian))
        joint_hessian, _ = ca.hessian(potential(position, rotation), q)
        return self._evaluate(wrench)[..., 0], self._evaluate(covariant), self._evaluate(joint_hessian)

    def kinematic_stiffness(self, representation: Representation) -> Array:
        """Column i is dJ^T/dq_i F."""
        contracted: Array = np.einsum("sibk,sk->sbi", self.derivative[representation], self.samples.wrench)
        return contracted

    def joint_stiffness(self, representation: Representation, *, corrected: bool) -> Array:
        """The formula, term by term."""
        J = self.jacobian[representation]
        if corrected:
            matrix = self.samples.task_stiffness + gamma_F(representation, self.samples.wrench)
        else:
            matrix = self.samples.general_stiffness
        stiffness: Array = self.kinematic_stiffness(representation) + np.swapaxes(J, 1, 2) @ matrix @ J
        if corrected and self.chain.floating:
            on_base = np.einsum("ski,sk->si", J[:, :, :6], self.samples.wrench)
            stiffness[:, :6, :6] -= gamma_F("body", on_base)
        return stiffness


def dynamics_references(chain: Chain, samples: Samples) -> dict[str, tuple[tuple[Array, ...], Array]]:
    """Arguments and reference values of the kernels of a robot's masses, those of the whole tree, by qualified name."""
    if not chain.masses:
        return {}
    place = Place(chain)
    stacks = samples.q, samples.base_pose.reshape(-1, 16), samples.velocity, samples.gravity
    poses = joint_poses(chain, place.q, place.base())
    expected = differentiated_energies(chain, poses, place.moves, place.q, place.base_pose, stacks)
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    given = {name: tuple(samples[argument.name] for argument in table[name].arguments) for name in expected}
    return {name: (given[name], reference) for name, reference in expected.items()}


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
    kernels: Kernels, chain: Chain, prefix: str, name: str, oracle: str, reference: Array, *given: Array
) -> Check:
    """Compare the only result of a kernel of a tip with a reference; ``chain`` is the tip's branch."""
    return _ResultComparison(chain, None, prefix, oracle, given).check(name, kernels[prefix + name](*given), reference)


def check_kernels(kernels: Kernels, references: References, prefix: str = "") -> list[Check]:
    """Compare the kernels of one tip with every oracle but the CasADi functions they came from.

    ``prefix`` is what stands before the kernels' names where a robot has several tips ("left_hand_").
    """
    samples, wrench = references.samples, references.samples.wrench
    checks = []

    def add(name: str, oracle: str, reference: Array, *arguments: Array) -> None:
        checks.append(_of_one(kernels, references.chain, prefix, name, oracle, reference, *arguments))

    add("forward_kinematics", "product of poses", references.pose, *references.posture)
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
    arguments: tuple[Array, ...]

    def check(self, name: str, value: Any, reference: Array, result: str = "") -> Check:
        """Compare a result, the only one or the one that is named, of a kernel."""
        title = self.prefix + name + (f", {result}" if result else "")

        def errors() -> Array:
            (kernel,) = (each for each in chain_kernels(self.chain, self.options) if each.qualified_name == name)
            which = [each.name for each in kernel.results].index(result) if result else 0
            return _rounding(self.chain, kernel, list(self.arguments), scalar_of(value), which)

        return _but_for_rounding(title, self.oracle, value, reference, errors)


def _joint_potential_checks(kernels: Kernels, chain: Chain, samples: Samples) -> list[Check]:
    checks = []
    for group, given in joint_potential_arguments(samples).items():
        for result, by_joints in by_hand(group, *given).items():
            # A floating base's coordinates come first, and do not feel it.
            own = chain.base_joints
            reference = np.pad(by_joints, [(0, 0), *(by_joints.ndim - 1) * [(own, 0)]])
            name = f"{group}_{result}"
            checks.append(compared(name, "derivatives by hand", kernels[name](*given), reference))
    return checks


def joint_potential_arguments(samples: Samples) -> dict[str, tuple[Array, ...]]:
    """What the kernels of the joint potentials take, by group."""
    return {
        potential.name: (samples.q, *(samples[argument.name] for argument in potential.parameters))
        for potential in JOINT_POTENTIALS
    }


def _symmetry(kernel: str, value: Any) -> Check:
    matrices = np.asarray(value)
    return Check(kernel, "bitwise symmetry", float(np.abs(matrices - np.swapaxes(matrices, 1, 2)).max()), 0.0)


def _potential_checks(kernels: Kernels, references: References, prefix: str) -> list[Check]:
    samples, posture, seen_from_tip = references.samples, references.posture, references.posture_of("body")
    body_kernel, hybrid_kernel = (f"{prefix}{rep}_joint_stiffness" for rep in ("body", "hybrid"))
    wrench, covariant, hessian = references.potential
    rotation = references.pose[:, :3, :3]
    turn = np.zeros((len(rotation), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation
    back = np.swapaxes(turn, 1, 2)

    def turned(vector: Array) -> Array:
        result: Array = np.einsum("sij,sj->si", turn, vector)
        return result

    oracle, chain = "Hessian of a potential", references.chain
    in_hybrid = turned(wrench), turn @ covariant @ back
    in_body = np.einsum("sji,sj->si", turn, samples.wrench)
    stiffness_in_body = back @ samples.task_stiffness @ turn
    as_body = np.asarray(kernels[body_kernel](*seen_from_tip, in_body, stiffness_in_body), dtype=float)
    as_hybrid = kernels[hybrid_kernel](*posture, samples.wrench, samples.task_stiffness)
    return [
        _of_one(kernels, chain, prefix, "body_joint_stiffness", oracle, hessian, *seen_from_tip, wrench, covariant),
        _of_one(kernels, chain, prefix, "hybrid_joint_stiffness", oracle, hessian, *posture, *in_hybrid),
        compared(hybrid_kernel, "body form, turned", as_hybrid, as_body),
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


def _tool_pose(references: References) -> tuple[Array, ...]:
    """What each tip has a posture of its own by."""
    return (references.samples.tool_pose,) if references.chain.runtime_tool else ()


def _shared_posture(posture: tuple[Array, ...], chain: Chain) -> tuple[Array, ...]:
    """The rest of it."""
    return posture[:-1] if chain.runtime_tool else posture


def argument_samples(
    chain: Chain, count: int, seed: int, options: SpringOptions | None = None
) -> dict[Argument, Array]:
    """A stack of ``count`` random values for every argument that kernels take."""
    drawn = [Samples.draw(chain, count, seed + index) for index in range(len(chain.tips))]
    names = [tip.name for tip in chain.tips]
    pool = {}
    for kernel in chain_kernels(replace(chain, tips=chain.tips[:1]), options):
        for k, argument in enumerate(kernel.arguments):
            each = [samples.of(argument, seed + index + k) for index, samples in enumerate(drawn)]
            pool[argument] = each[0]
            if argument.plural:
                pool[argument.of_all_tips(names)] = np.stack(each, axis=1)
    for kernel in chain_kernels(chain, options):
        for argument in kernel.arguments:
            if argument.own and argument not in pool:  # cotangents, of what is summed over the tips, too
                pool[argument] = drawn[0].of(argument, seed)
    return pool


FAR = (1.5e4, -1.0e6, 3.0e9)
"""Angles beyond those that the generated code reduces itself."""


def check_far_angles(kernels: Kernels, chain: Chain, seed: int, options: SpringOptions | None = None) -> list[Check]:
    """One joint many turns away at a time, against the CasADi functions.

    Not where joints mimic: their positions, multiplied and shifted, are rounded there, in either code its own way.
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
    """Every kernel with its CasADi function, which takes as long to make as all that is compared with it."""
    return [(kernel, casadi_function(chain, kernel)) for kernel in chain_kernels(chain, options)]


def _against_casadi(
    kernels: Kernels, chain: Chain, pool: dict[Argument, Array], options: SpringOptions | None
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


def _but_for_rounding(name: str, oracle: str, value: Any, reference: Array, errors: Callable[[], Array]) -> Check:
    """The check that a value is its reference; contributions that cancel leave their rounding, each program its own."""
    check = compared(name, oracle, value, reference)
    if check.passed:
        return check
    rest = beyond_rounding(np.asarray(value) - reference, errors())
    return compared(name, oracle, (reference + rest).astype(np.asarray(value).dtype), reference)


def _rounding(chain: Chain, kernel: Kernel, given: list[Array], scalar: Scalar, which: int) -> Array:
    """Standard errors of one of a kernel's results, zero where they are not known."""
    found = rounding_errors(chain, kernel, given, scalar)
    return np.zeros((len(given[0]), *kernel.results[which].array(chain).shape)) if found is None else found[which]


Step = Callable[[], list[Check]]


def verify(
    folder: str | Path,
    *,
    urdf: str | Path | None = None,
    count: int | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda step: None,
) -> list[Check]:
    """Hold a robot's folder against what did not make it.

    Files against the digests in the manifest; the manifest's chain against the URDF, if it is given; names and limits
    against the chain; every function against independent oracles and against the CasADi function it was printed from;
    stacks and C batches of every length, with steps of every kind, against single calls; NaN, infinity and numbers that
    overflow; no memory but the arguments'; the controller against its law, its limits and its reaction to faults.

    Args:
        folder: what ``stiffgen generate`` wrote.
        urdf: the file that it was generated from. Without it the chain in the manifest is believed.
        count: number of random postures within the limits (default: 200 up to 7 joints, fewer for more, at least 10).
        seed: of the random generator, not negative.
        progress: called with a few words before each step.

    Returns:
        One record a comparison.

    Raises:
        OutputError: the folder is none of stiffgen's, is damaged, or is not compiled.
        DescriptionError, ChainError: the URDF has no such chain.
        StiffgenError: ``count`` or ``seed`` is out of range.

    """
    if seed < 0 or (count is not None and count < 1):
        raise StiffgenError("the seed must not be negative, and there must be at least one posture")
    robot = open_robot(folder)
    count = default_count(robot.chain) if count is None else count
    checks = check_files(robot)
    if not checks[0].passed:
        return [*checks, Check("functions", "not run", math.inf, 0.0, "nothing of a folder with other files is run")]
    load_module(robot)
    with temporary_folder("verify") as build:
        steps = _steps(robot, None if urdf is None else Path(urdf), count, seed, build)
        for number, (title, step) in enumerate(steps, start=1):
            progress(f"{title} ({number} of {len(steps)})")
            try:
                checks += step()
            except (ValueError, TypeError, IndexError, KeyError, AttributeError) as error:
                # A folder that does not even take its own arguments has failed, it is no bad input.
                checks.append(Check(title, "runs", math.inf, 0.0, f"{type(error).__name__}: {error}"))
    return checks


def default_count(chain: Chain) -> int:
    """Postures for a chain: the cost of one grows with the cube of its joints."""
    return max(10, min(200, round(200 * (7 / len(chain.joints)) ** 2)))


def _steps(robot: GeneratedRobot, urdf: Path | None, count: int, seed: int, build: Path) -> list[tuple[str, Step]]:
    chain, kernels, table, springs = robot.chain, robot.kernels, robot.table, robot.springs
    # Stacks go through the batch functions where there are any; the oracles shall see the single ones, too.
    single = {name: one_by_one(kernel) for name, kernel in kernels.items()}
    missing = missing_functions(robot)
    pool = argument_samples(chain, LONG, seed, springs)
    # Not symmetric: a batch that reads another triangle than the single call is seen.
    general = Samples.draw(chain, LONG, seed).general_stiffness
    pool |= {argument: general for argument in pool if argument.name == "task_stiffness"}
    texts = print_again(robot)
    libraries = build_widths(robot, build)
    library = next(iter(libraries.values()), None)
    steps: list[tuple[str, Step]] = [
        ("printing again", lambda: [check_functions(robot), check_text(robot, texts)]),
        ("names and limits", lambda: check_tables(robot, libraries)),
        (
            "differentiating and comparing",
            lambda: without_missing(check_robot(missing | single, chain, count, seed, springs), missing),
        ),
        ("comparing with CasADi", lambda: check_against_casadi(single, chain, min(count, 50), seed, springs)),
        ("angles many turns away", lambda: check_far_angles(single, chain, seed, springs)),
        ("stacks of every length", lambda: check_stacks(kernels, single, table, chain, pool)),
        (
            "certified bounds",
            lambda: check_certified_bounds(
                (single, kernels), table, chain, robot.scalar, robot.manifest["rounding"], pool
            ),
        ),
        ("NaN and infinity", lambda: check_not_finite(kernels, table, pool, robot.scalar)),
        ("stepping the controller", lambda: check_controller(robot, seed)),
        ("hostile sessions", lambda: check_sessions(robot, texts, seed, build / "sessions")),
    ]
    if springs.derivatives:
        steps.append(("differences of what has derivatives", lambda: check_derivatives(single, table, chain, pool)))
    if library is not None:
        loaded = library
        steps.append(
            ("batches in C", lambda: check_c_batches(libraries, robot.name, single, table, chain, pool, robot.scalar))
        )
        steps.append(("bounds of memory", lambda: check_bounds(loaded, robot.name, table, chain, pool, robot.scalar)))
    if urdf is not None:
        file = urdf
        steps.insert(1, ("reading the URDF", lambda: [check_urdf(chain, file)]))
        states = Samples.draw(chain, 5, seed)
        steps.insert(2, ("masses of the URDF", lambda: check_masses(single, table, chain, file, states)))
    return steps
