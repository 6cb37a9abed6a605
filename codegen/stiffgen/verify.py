"""Oracles for the kernels of a generated robot, independent of the code that generated them.

What the kernels compute in closed form is computed here another way, from the chain's joint poses alone:

* pose: a plain product of 4x4 matrices with Rodrigues' formula;
* Jacobians: CasADi's differentiation of that pose, J = vee(H^-1 dH) and its relatives;
* dJ^T/dq: CasADi's differentiation of those Jacobians; the kinematic stiffness is its contraction;
* Gamma F: the matrix forms in cross-product matrices, written down;
* joint stiffness: the paper's formula put together from the above; and the joint Hessian of a potential
  U(p, R) along the pose, which it must equal for F = dU and K = the covariant Hessian;
* mass matrix: the Hessian of the kinetic energy by the joint velocities.

Errors are relative to the largest entry of the reference.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from stiffgen.chain import Chain
from stiffgen.connection import REPRESENTATIONS, Representation
from stiffgen.emit.render import chain_from_manifest
from stiffgen.errors import OutputError
from stiffgen.generate import read_manifest
from stiffgen.kernels import KERNELS
from stiffgen.model import casadi_function

Array = NDArray[np.float64]
Kernels = Mapping[str, Callable[..., Any]]
"""Functions by qualified name ("hybrid_joint_stiffness"), taking stacks of arguments."""

BOUND = 1e-12


@dataclass(frozen=True)
class Check:
    """One row of the table: what was compared, against what, and the worst relative error over the samples."""

    kernel: str
    oracle: str
    error: float
    bound: float

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the bound."""
        return self.error <= self.bound


@dataclass(frozen=True)
class Samples:
    """Random states: q within the limits, wrenches, symmetric and general task stiffness, and potential data."""

    q: Array
    wrench: Array
    task_stiffness: Array
    general_stiffness: Array

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
        return Samples(
            q=random.uniform(lower, upper, (count, chain.dof)),
            wrench=random.normal(size=(count, 6)) * np.array([30.0, 30, 30, 10, 10, 10]),
            task_stiffness=(general + general.transpose(0, 2, 1)) / 2,
            general_stiffness=general,
        )


def _product_of_poses(chain: Chain, q: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Pose of every joint's frame and of the tip in the base, by plain 4x4 products."""
    pose, joints = ca.SX.eye(4), []
    for joint in chain.joints:
        position = joint.multiplier * q[joint.coordinate] + joint.offset
        axis = ca.DM(joint.axis)
        motion = ca.SX.eye(4)
        if joint.type == "prismatic":
            motion[:3, 3] = axis * position
        else:
            cross = ca.skew(axis)
            motion[:3, :3] = ca.DM.eye(3) + ca.sin(position) * cross + (1 - ca.cos(position)) * (cross @ cross)
        pose = pose @ _homogeneous(joint.rotation, joint.translation) @ motion
        joints.append(pose)
    return joints, pose @ _homogeneous(chain.tip_rotation, chain.tip_translation)


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
    """Reference values of all kernels at random samples.

    Args:
        chain: the robot.
        count: number of samples.
        seed: of the random generator.

    """

    def __init__(self, chain: Chain, count: int, seed: int) -> None:
        self.chain = chain
        self.samples = Samples.draw(chain, count, seed)
        q = ca.SX.sym("q", chain.dof)
        joint_poses, pose = _product_of_poses(chain, q)
        self.pose = self._evaluate(q, pose)
        self.jacobian: dict[str, Array] = {}
        self.derivative: dict[str, Array] = {}
        for representation in REPRESENTATIONS:
            jacobian = _jacobian(pose, q, representation)
            self.jacobian[representation] = self._evaluate(q, jacobian)
            # vec() stacks columns: row b*6 + k of the derivative is J[k, b].
            derivative = self._evaluate(q, ca.jacobian(ca.vec(jacobian), q))
            n = chain.dof
            self.derivative[representation] = derivative.reshape(count, n, 6, n).transpose(0, 3, 1, 2)
        self.mass_matrix = self._evaluate(q, self._kinetic_hessian(joint_poses, q))
        self.potential = self._potential(q, pose, seed)

    def _evaluate(self, q: ca.SX, expression: ca.SX) -> Array:
        function = ca.Function("f", [q], [ca.densify(expression)], {"cse": True})
        rows, columns = expression.shape
        mapped = np.asarray(function.map(len(self.samples.q))(self.samples.q.T))
        return np.ascontiguousarray(mapped.reshape(rows, -1, columns).transpose(1, 0, 2))

    def _kinetic_hessian(self, joint_poses: list[ca.SX], q: ca.SX) -> ca.SX:
        total = ca.SX(self.chain.dof, self.chain.dof)
        for joint, pose in zip(self.chain.joints, joint_poses, strict=True):
            xx, xy, xz, yy, yz, zz = joint.body.tensor
            tensor = ca.DM([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            moment = ca.skew(ca.DM(joint.body.moment))
            # Kinetic energy 1/2 (m v.v + 2 v.(w x mc) + w.I w) as a 6x6 form on the frame's body twist.
            form = ca.vertcat(ca.horzcat(joint.body.mass * ca.DM.eye(3), -moment), ca.horzcat(moment, tensor))
            jacobian = _jacobian(pose, q, "body")
            total += jacobian.T @ form @ jacobian
        return total

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
        return self._evaluate(q, wrench)[..., 0], self._evaluate(q, covariant), self._evaluate(q, joint_hessian)

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
        return stiffness


def relative_error(value: Any, reference: Array) -> float:
    """Largest difference of any sample over the largest entry of that sample's reference; NaN if any is NaN."""
    difference = np.abs(np.asarray(value, dtype=float) - reference).reshape(len(reference), -1).max(axis=1)
    scale = np.abs(reference).reshape(len(reference), -1).max(axis=1)
    scale[scale == 0] = 1.0
    return float((difference / scale).max())


def check_kernels(kernels: Kernels, references: References) -> list[Check]:
    """Compare kernels with every oracle but the CasADi functions they came from."""
    samples = references.samples
    q, wrench = samples.q, samples.wrench
    checks = [
        _check("forward_kinematics", "product of poses", kernels["forward_kinematics"](q), references.pose),
        _check("mass_matrix", "Hessian of the kinetic energy", kernels["mass_matrix"](q), references.mass_matrix),
    ]
    for rep in REPRESENTATIONS:

        def add(name: str, oracle: str, reference: Array, *arguments: Array, rep: str = rep) -> None:
            checks.append(_check(f"{rep}_{name}", oracle, kernels[f"{rep}_{name}"](*arguments), reference))

        add("jacobian", "differentiated pose", references.jacobian[rep], q)
        add("jacobian_transpose_derivative", "differentiated Jacobian", references.derivative[rep], q)
        add("kinematic_stiffness", "differentiated Jacobian . F", references.kinematic_stiffness(rep), q, wrench)
        add("connection_correction", "cross-product matrices", gamma_F(rep, wrench), wrench)
        for corrected, name, K in (
            (True, "joint_stiffness", samples.task_stiffness),
            (False, "joint_stiffness_uncorrected", samples.general_stiffness),
        ):
            reference = references.joint_stiffness(rep, corrected=corrected)
            add(name, "formula on differentiated Jacobian", reference, q, wrench, K)
        Kq = np.asarray(kernels[f"{rep}_joint_stiffness"](q, wrench, samples.task_stiffness))
        asymmetry = float(np.abs(Kq - np.swapaxes(Kq, 1, 2)).max())
        checks.append(Check(f"{rep}_joint_stiffness", "bitwise symmetry", asymmetry, 0.0))
    checks += _potential_checks(kernels, references)
    return checks


def _check(kernel: str, oracle: str, value: Any, reference: Array) -> Check:
    return Check(kernel, oracle, relative_error(value, reference), BOUND)


def _potential_checks(kernels: Kernels, references: References) -> list[Check]:
    samples = references.samples
    wrench, covariant, hessian = references.potential
    rotation = references.pose[:, :3, :3]
    turn = np.zeros((len(rotation), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation
    back = np.swapaxes(turn, 1, 2)

    def turned(vector: Array) -> Array:
        result: Array = np.einsum("sij,sj->si", turn, vector)
        return result

    body = kernels["body_joint_stiffness"](samples.q, wrench, covariant)
    hybrid = kernels["hybrid_joint_stiffness"](samples.q, turned(wrench), turn @ covariant @ back)
    in_body = np.einsum("sji,sj->si", turn, samples.wrench)
    stiffness_in_body = back @ samples.task_stiffness @ turn
    as_body = np.asarray(kernels["body_joint_stiffness"](samples.q, in_body, stiffness_in_body), dtype=float)
    as_hybrid = kernels["hybrid_joint_stiffness"](samples.q, samples.wrench, samples.task_stiffness)
    return [
        _check("body_joint_stiffness", "Hessian of a potential", body, hessian),
        _check("hybrid_joint_stiffness", "Hessian of a potential", hybrid, hessian),
        _check("hybrid_joint_stiffness", "body form, turned", as_hybrid, as_body),
    ]


def check_against_casadi(kernels: Kernels, references: References) -> list[Check]:
    """Compare kernels with the CasADi functions of the same chain (the C printing and the compiler)."""
    samples = references.samples
    checks = []
    for kernel in KERNELS:
        symmetric = kernel.name != "joint_stiffness_uncorrected"
        pool = {
            "q": samples.q,
            "wrench": samples.wrench,
            "task_stiffness": samples.task_stiffness if symmetric else samples.general_stiffness,
        }
        arguments = [pool[argument.name] for argument in kernel.arguments]
        function = casadi_function(references.chain, kernel)
        shape = kernel.result.array(references.chain).shape
        reference = np.stack([np.asarray(function(*each)).reshape(shape) for each in zip(*arguments, strict=True)])
        value = kernels[kernel.qualified_name](*arguments)
        checks.append(_check(kernel.qualified_name, "closed form in CasADi", value, reference))
    return checks


def _one_by_one(kernel: Callable[..., Any]) -> Callable[..., Any]:
    def call(*stacks: Array) -> Any:
        return np.stack([kernel(*each) for each in zip(*stacks, strict=True)])

    return call


def check_batches(kernels: Kernels, single: Kernels, references: References) -> list[Check]:
    """Compare batch functions with single calls; the last block of a batch is not full."""
    samples = references.samples
    pool = {"q": samples.q, "wrench": samples.wrench, "task_stiffness": samples.task_stiffness}
    checks = []
    for kernel in KERNELS:
        if kernel.batch:
            arguments = [pool[argument.name] for argument in kernel.arguments]
            name = kernel.qualified_name
            checks.append(_check(f"{name}_batch", "single calls", kernels[name](*arguments), single[name](*arguments)))
    return checks


def import_robot(folder: Path) -> ModuleType:
    """Import a generated folder as a package, wherever it lies.

    Raises:
        OutputError: the folder is none of stiffgen's, or its C module is not built for this Python.

    """
    manifest = read_manifest(folder)
    if manifest is None:
        raise OutputError(f"{folder}: no folder of stiffgen (it has no manifest)")
    name = f"_stiffgen_robot_{abs(hash(folder.resolve()))}"
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    if spec is None or spec.loader is None:
        raise OutputError(f"{folder}: has no __init__.py; generate it again")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except ImportError as error:
        del sys.modules[name]
        raise OutputError(f"{folder}: {error}") from error
    return module


def kernels_of(module: ModuleType) -> dict[str, Callable[..., Any]]:
    """The ufuncs of a generated module by qualified name."""
    return {
        kernel.qualified_name: getattr(
            getattr(module, kernel.representation) if kernel.representation else module, kernel.name
        )
        for kernel in KERNELS
    }


def verify(
    folder: str | Path, *, count: int = 200, seed: int = 0, progress: Callable[[str], None] = lambda step: None
) -> list[Check]:
    """Run every oracle on the compiled kernels of a robot's folder.

    Args:
        folder: what ``stiffgen generate`` wrote.
        count: number of random postures within the limits.
        seed: of the random generator.
        progress: called with a few words before each step.

    Returns:
        One record a comparison.

    Raises:
        OutputError: the folder is none of stiffgen's or is not compiled.

    """
    folder = Path(folder)
    module = import_robot(folder)
    manifest = read_manifest(folder)
    assert manifest is not None
    progress("differentiating")
    references = References(chain_from_manifest(manifest), count, seed)
    kernels = kernels_of(module)
    progress("comparing")
    # Stacks go through the batch functions where there are any; the oracles shall see the single ones, too.
    single = {name: _one_by_one(kernel) for name, kernel in kernels.items()}
    checks = check_kernels(single, references) + check_against_casadi(single, references)
    return checks + check_batches(kernels, single, references)
