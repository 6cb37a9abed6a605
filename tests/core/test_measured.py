# SPDX-License-Identifier: MIT
"""Stiffness arguments: kernels use the symmetric part, and a stiffness measured under a load is turned into one.

The environment is a random quadratic function of the entries of the tip's pose. Its wrench and the changes of the
wrench per twist are exact, from derivatives of a polynomial; its joint Hessian is CasADi's, through the pose alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import chain_between
from stiffgen.core.lower.form import Function, Invoke, Loop, Pointer
from stiffgen.core.lower.statements import upper_entry
from stiffgen.core.lower.steps import lowered
from stiffgen.core.lower.variant import BATCH, CUDA, SINGLE, Variant
from stiffgen.core.robot.chain import Chain, ChainOptions
from stiffgen.core.robot.reader import read_description
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.measured import ASYMMETRY, REMEDY
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.samples import argument_samples, symmetric
from stiffgen.core.verify.result import as_results
from stiffgen.lab.analyze.analysis import checked_stiffness
from support.chains import chain_urdf
from support.project import kernels_of
from support.random_urdf import Plain, random_robot

Array = np.ndarray
BOUND = 1e-12
HYBRID = "hybrid"


def motion(representation: str, k: int, pose: Array) -> Array:
    """Return the rate of a pose (4, 4) along twist number k: affine in the pose."""
    twist = np.zeros((4, 4))
    if k < 3:
        twist[k, 3] = 1.0
    else:
        i, j = (k + 1 - 3) % 3, (k + 2 - 3) % 3
        twist[j, i], twist[i, j] = 1.0, -1.0
    if representation == "hybrid":
        turned = np.zeros((4, 4))
        turned[:3, :3] = pose[:3, :3]
        return twist if k < 3 else twist @ turned
    return pose @ twist if representation == "body" else twist @ pose


@dataclass(frozen=True)
class Environment:
    """Energy |B x - b|^2 / 2 of the entries x of the pose's upper three rows."""

    B: Array
    b: Array

    @staticmethod
    def of(random: np.random.Generator, pose: Array) -> Environment:
        """Return an environment of some 500 N/m and 30 N m/rad with a wrench of some 20 N and 5 N m at the pose."""
        B = random.normal(size=(12, 12)) * np.tile([4.0, 4.0, 4.0, 15.0], 3)
        return Environment(B, B @ pose[:3].ravel() + random.normal(size=12))

    def measured(self, representation: str, pose: Array) -> tuple[Array, Array]:
        """Return the wrench, and the changes of its components per twist: Km[i, j] of component i per twist j."""
        stress = self.B @ pose[:3].ravel() - self.b
        rates = [motion(representation, k, pose) for k in range(6)]
        columns = np.array([self.B @ rate[:3].ravel() for rate in rates])
        bent = [[motion(representation, i, pose + rates[j]) - rates[i] for j in range(6)] for i in range(6)]
        curved = np.array([[stress @ (self.B @ each[:3].ravel()) for each in row] for row in bent])
        return columns @ stress, columns @ columns.T + curved

    def joint_stiffness(self, pose_of: ca.Function, q: Array) -> Array:
        """Return d2U/dq2, through the pose's entries alone."""
        symbol = ca.SX.sym("q", len(q))
        entries = ca.vec(pose_of(symbol)[:3, :].T)
        hessian, _ = ca.hessian(ca.sumsqr(self.B @ entries - self.b) / 2, symbol)
        return np.array(ca.Function("H", [symbol], [hessian])(q))


def robots(folder: Path, seeds: range) -> list[tuple[int, Chain]]:
    """Return random chains with fixed base; every kind of joint occurs."""
    file, chains = folder / "robot.urdf", []
    for seed in seeds:
        robot = random_robot(Plain(seed), 6)
        file.write_text(robot.text, encoding="utf-8")
        chains.append((seed, chain_between(read_description(file), ChainOptions(tip=robot.tip, base=robot.base))))
    return chains


def functions_of(chain: Chain) -> dict[str, ca.Function]:
    """Return pose and joint stiffnesses of a chain."""
    wanted = ("forward_kinematics", "joint_stiffness", "joint_stiffness_uncorrected")
    kernels = (kernel for kernel in chain_kernels(chain) if kernel.name in wanted and kernel.group != "spring")
    return {kernel.qualified_name: casadi_function(chain, kernel) for kernel in kernels}


def largest_error(found: Any, expected: Array, scale: float) -> float:
    return float(np.abs(np.asarray(found) - expected).max(initial=0.0) / scale)


@pytest.mark.parametrize(
    "seeds",
    [
        range(12),
        *(pytest.param(range(k, k + 47), marks=pytest.mark.wide) for k in range(12, 200, 47)),
    ],
)
def test_measured_under_a_load(seeds: range, tmp_path: Path) -> None:
    """Exact Kq in every representation; in hybrid also of Km as it is. Before, 9 N m/rad of 295 were wrong."""
    errors: dict[str, float] = {}
    for seed, chain in robots(tmp_path, seeds):
        functions, random = functions_of(chain), np.random.default_rng(seed)
        q = random.uniform(-1.0, 1.0, len(chain.coordinates))
        pose = np.array(functions["forward_kinematics"](q))
        environment = Environment.of(random, pose)
        exact = environment.joint_stiffness(functions["forward_kinematics"], q)
        for rep in REPRESENTATIONS:
            F, Km = environment.measured(rep, pose)
            scale = max(float(np.abs(exact).max(initial=0.0)), float(np.abs(Km).max()))
            K, residual = stiffgen.measured_stiffness(Km, F, rep)
            assert np.array_equal(K, K.T)
            given = {"joint_stiffness": K, "joint_stiffness_uncorrected": Km}
            found = {name: functions[f"{rep}_{name}"](q, F, each) for name, each in given.items()}
            if rep == HYBRID:
                found["as it is"] = functions["hybrid_joint_stiffness"](q, F, Km)
            errors |= {f"{seed} {rep} {name}": largest_error(each, exact, scale) for name, each in found.items()}
            errors[f"{seed} {rep} residual"] = float(np.abs(residual.matrix).max()) / scale
            assert residual.share < 1e-9
    assert {name: error for name, error in errors.items() if not error <= BOUND} == {}


@pytest.fixture(scope="module")
def loaded(chain: Chain) -> tuple[Environment, Array]:
    """An environment at a pose of the iiwa 14."""
    q = np.array([0.3, 0.7, -0.4, -1.1, 0.5, 0.9, 0.2])
    pose = np.array(functions_of(chain)["forward_kinematics"](q))
    return Environment.of(np.random.default_rng(3), pose), pose


def test_seeded_mistakes_leave_a_residual(loaded: tuple[Environment, Array]) -> None:
    """Transpose Km, take the other half of [m], or body for hybrid axes: none is silent."""
    environment, pose = loaded
    F, Km = environment.measured("hybrid", pose)
    of_body = environment.measured("body", pose)
    assert stiffgen.measured_stiffness(Km.T, F).residual.share == pytest.approx(2.0)
    assert stiffgen.measured_stiffness(Km, F * [1, 1, 1, -1, -1, -1]).residual.share == pytest.approx(2.0)
    for wrong in (of_body, (F, of_body[1]), (of_body[0], Km)):
        assert stiffgen.measured_stiffness(wrong[1], wrong[0]).residual.share > 0.1
    for rep in REPRESENTATIONS:
        for other in REPRESENTATIONS:
            residual = stiffgen.measured_stiffness(*environment.measured(other, pose)[::-1], rep).residual
            assert (np.abs(residual.matrix).max() < 1e-9) == (rep == other), (rep, other)


def test_stacks_and_no_moment(loaded: tuple[Environment, Array]) -> None:
    """Pass leading dimensions, which broadcast, and no wrench, where nothing is corrected."""
    environment, pose = loaded
    F, Km = environment.measured("body", pose)
    one, many = stiffgen.measured_stiffness(Km, F, "body"), stiffgen.measured_stiffness([Km, Km.T], [[F], [F]], "body")
    assert many.K.shape == (2, 2, 6, 6)
    assert many.residual.share.shape == (2, 2)
    assert np.array_equal(many.K[1, 0], one.K)
    K, residual = stiffgen.measured_stiffness(np.eye(6), np.zeros(6))
    assert np.array_equal(K, np.eye(6))
    assert residual.share == 0.0
    assert stiffgen.measured_stiffness(np.eye(6) + np.eye(6, k=2), np.zeros(6)).residual.share == np.inf


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(5), np.zeros(6)), r"Km must have the shape \(..., 6, 6\), not \(5, 5\)"),
        ((np.eye(6), np.zeros(5)), r"wrench must have the shape \(..., 6\), not \(5,\)"),
        ((np.eye(6), np.zeros(6), "world"), "no representation 'world'; representations are"),
        ((np.ones((2, 6, 6)), np.ones((3, 6))), r"leading dimensions \(2,\) of Km and \(3,\) of wrench"),
    ],
)
def test_refusals(arguments: tuple[Any, ...], message: str) -> None:
    """Pass wrong shapes or representations: refused, and the argument is named."""
    with pytest.raises(StiffgenError, match=f"^measured_stiffness: .*{message}"):
        stiffgen.measured_stiffness(*arguments)


def halves(values: Array) -> tuple[Array, Array]:
    """Return symmetric matrices, and others with the same mean of both triangles to the last bit: 4 K and -2 K."""
    mean = symmetric(values)
    upper = np.triu(mean, 1)
    lower = np.swapaxes(upper, -1, -2)
    return mean, mean - (upper + lower) + 4 * upper - 2 * lower


def with_stiffnesses(kernels: Any, pool: dict[Argument, Array]) -> list[tuple[Kernel, list[Array], list[Array]]]:
    """Return every kernel that takes a stiffness, with symmetric arguments and with others of the same symmetric
    part.
    """
    cases = []
    for kernel in kernels:
        if any(argument.symmetric_part for argument in kernel.arguments):
            both = [halves(pool[a]) if a.symmetric_part else (pool[a], pool[a]) for a in kernel.arguments]
            cases.append((kernel, [one for one, _ in both], [other for _, other in both]))
    return cases


@pytest.mark.parametrize(
    ("options", "least"),
    [
        (KernelOptions(springs=KINDS, kernels="all,compliance,tangents"), 40),
        (KernelOptions(derivatives=True, kernels="hybrid,spring"), 14),
    ],
)
def test_every_function_of_casadi_uses_the_symmetric_part(chain: Chain, options: KernelOptions, least: int) -> None:
    """Pass K plus an antisymmetric matrix to each function: the results are those of K, to the bit."""
    pool = argument_samples(chain, 2, 5, options)
    cases = with_stiffnesses(chain_kernels(chain, options), pool)
    assert len(cases) >= least
    wrong = []
    for kernel, plain, other in cases:
        function = casadi_function(chain, kernel)
        one, two = (as_results(function(*(each[0] for each in given))) for given in (plain, other))
        if not all(np.array_equal(np.array(a), np.array(b)) for a, b in zip(one, two, strict=True)):
            wrong.append(kernel.qualified_name)
    assert wrong == []


def test_every_function_in_c_uses_the_symmetric_part(chain: Chain, robot: ModuleType) -> None:
    """Single calls, stacks with a stiffness each, and stacks that share one: the same bits."""
    pool, functions = argument_samples(chain, 37, 5), kernels_of(robot, chain)
    cases = with_stiffnesses(chain_kernels(chain), pool)
    assert len(cases) > 8
    for kernel, plain, other in cases:
        function = functions[kernel.qualified_name]
        shared = [a.symmetric_part for a in kernel.arguments]
        first = [[each[0] for each in given] for given in (plain, other)]
        share = [[v[0] if s else v for v, s in zip(given, shared, strict=True)] for given in (plain, other)]
        for one, two in (first, (plain, other), share):
            for a, b in zip(as_results(function(*one)), as_results(function(*two)), strict=True):
                assert np.array_equal(a, b), kernel.qualified_name
        each = as_results(function(*plain))
        for stack, alone in zip(each, as_results(function(*first[0])), strict=True):
            assert np.abs(stack[0] - alone).max() <= BOUND * np.abs(alone).max()


def test_one_sentence(robot: ModuleType, chain: Chain) -> None:
    """Pass asymmetric matrices: whoever can speak names the remedy; a difference by single precision passes."""
    q, F, C = np.full(7, 0.4), np.zeros(6), np.eye(6)
    K, Kq = np.eye(6) + 1e-3 * np.eye(6, k=2), np.eye(7) + 1e-3 * np.eye(7, k=2)
    law = robot.PaperLaw(motor_inertia=0.1)
    spring = {"translation_stiffness": 100 * K[:3, :3], "rotation_stiffness": np.eye(3)}
    arm = {"sample_time": 1e-3, "delay_samples": 1, "motor_inertia": 0.1, "heaviest_wrench": [80.0, 15.0]}
    controller = robot.Impedance(**arm, errors="raise")
    calls = {
        "in_series": lambda: stiffgen.in_series(Kq, np.ones(7)),
        "gears": lambda: stiffgen.in_series(np.eye(7), Kq),
        "tip_compliance_in_series": lambda: stiffgen.tip_compliance_in_series(K, np.eye(4), []),
        "part": lambda: stiffgen.tip_compliance_in_series(C, np.eye(4), [(K, np.eye(4))]),
        "settle": lambda: stiffgen.settle(robot, q, Kq, F),
        "buckling_load": lambda: stiffgen.buckling_load(robot, q, Kq, F),
        "compliance_gradient": lambda: stiffgen.compliance_gradient(robot, q, F, Kq, np.eye(6)[0]),
        "stiffness_deviation": lambda: stiffgen.stiffness_deviation(robot, q, F, K, C),
        "move_stiffness": lambda: stiffgen.move_stiffness(np.eye(4), F, K, "body", "hybrid"),
        "analyze": lambda: checked_stiffness(K),
        "PaperLaw": lambda: law.step(q=q, dq=0 * q, q0=q, wrench=F, task_stiffness=K),
        "Impedance": lambda: [controller.step(counter=k, q=q, dq=0 * q, q0=q, **spring) for k in range(5)],
    }
    silent = []
    for name, call in calls.items():
        with pytest.raises((StiffgenError, ValueError)) as raised:
            call()
        if REMEDY not in str(raised.value):
            silent.append(f"{name}: {raised.value}")
    assert silent == []
    stiffgen.in_series(np.eye(7) + 0.9 * ASYMMETRY * np.eye(7, k=1), np.ones(7))
    assert "stiffgen.measured_stiffness(Km, wrench, representation)" in REMEDY


def lower_entries(function: Function) -> set[str]:
    """Return the reads of lower triangles of stiffnesses in a lowered function, and calls that are passed one.

    The step that takes the symmetric part in a kernel for one configuration reads all entries, and copy_symmetric the
    upper triangle alone. Kernels that a sum calls take the symmetric part themselves.
    """
    found = set()
    for item in function.items:
        body = getattr(item, "body", None)
        if body and not (isinstance(item, Loop) and item.comment.startswith("symmetric part of")):
            for k in body.reads:
                array, entry = body.inputs[k].storage.array, body.inputs[k].entry
                rows = array.shape[-1] if array.symmetric_part else 1
                if entry % rows**2 != upper_entry(entry % rows**2, rows):
                    found.add(f"{function.name}: {array.name}[{entry}]")
        for call in getattr(item, "calls", ()):
            pointers = [each for each in call.arguments if isinstance(each, Pointer)]
            if call.helper != "copy_symmetric" and any(each.storage.array.symmetric_part for each in pointers):
                found.add(f"{function.name}: {call.helper}")
        if isinstance(item, Invoke) and any(storage.array.symmetric_part for storage in item.arguments):
            found.add(f"{function.name}: {item.function.name}")
    return found


@pytest.mark.parametrize("variant", [SINGLE, BATCH, CUDA], ids=["single", "batch", "cuda"])
def test_only_upper_triangles_of_symmetric_parts_are_read(variant: Variant, tmp_path: Path) -> None:
    """Nobody fills the lower ones. Before, NaN of springs by quaternions read them, in CUDA from shared memory."""
    options = KernelOptions(springs=KINDS, derivatives=True, kernels="all,compliance,tangents")
    (tmp_path / "arm.urdf").write_text(chain_urdf("rp"))
    chain = stiffgen.load_chain(tmp_path / "arm.urdf")
    kernels = [
        kernel
        for kernel in chain_kernels(chain, options)
        if (kernel.batch or not variant.batches) and any(argument.symmetric_part for argument in kernel.arguments)
    ]
    code = lowered(chain, variant)
    functions = [code.kernel(kernel) for kernel in kernels]
    assert len(functions) > 60
    assert set().union(*map(lower_entries, (*functions, *code.shared.values()))) == set()
