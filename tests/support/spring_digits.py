# SPDX-License-Identifier: MIT
"""Compare springs with the energies of ``stiffgen verify``, differentiated and run with 60 digits.

At poses given as doubles, and along q, where torque and joint stiffness follow by the formulas on the Jacobian's
references. A spring near its equilibrium needs the digits: two derivatives of an angle of 1e-9 rad cost eighteen.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

import stiffgen
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.symbolic.placement import AXES, Placement
from stiffgen.core.verify.kernels.references import References, load_stiffness
from stiffgen.core.verify.kernels.rounding import ONE
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.families.springs.reference import differentiated
from stiffgen.families.springs.springs import derivatives, spring
from support.chains import chain_urdf
from support.exact_tree import as_array, exponential, mp
from support.graphs import exactly
from support.project import URDF

CASES = ("random", "near", "edge")
REMOTE = (0.1, -0.2, 0.3)
PLACEMENTS = [Placement(t, r, c) for c in ((0.0, 0.0, 0.0), REMOTE) for t, r in itertools.product(AXES, AXES)]
"""All axes, with the centre of stiffness at the tip's origin and shifted."""
FEW = [Placement(), *(Placement(t, r, REMOTE) for t, r in zip(AXES, (AXES[2], AXES[0], AXES[1]), strict=True))]
"""Default axes, and each choice of axes once with a shifted centre."""
ROBOTS = ("iiwa14", "six axes", "slides and mimics")
EPS = 2.0**-52
LIMITS = 20.0, 5.0
"""Largest force [N] and moment [N m] of the bounded spring."""
RESULTS = ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness")
Errors = dict[tuple[str, Placement], dict[str, float]]
"""Worst errors of a spring's results by kind and placement."""


def distance(case: str, random: np.random.Generator) -> tuple[float, float]:
    """Draw angle [rad] and displacement [m] of a case's pose from its equilibrium."""
    if case == "near":
        return 10 ** random.uniform(-9, -3), 10 ** random.uniform(-9, -3)
    if case == "small":
        return 10 ** random.uniform(-2, -0.8), 1e-3
    if case == "edge":
        return np.pi - 10 ** random.uniform(-9, -6), random.uniform(0.01, 0.5)
    return random.uniform(0.01, np.pi - 0.01), random.uniform(0.01, 0.5)


def axis(random: np.random.Generator) -> np.ndarray:
    v = random.normal(size=3)
    return v / np.linalg.norm(v)


def turned(rotation: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return rotation exp([turn]), multiplied with 60 digits, rounded to doubles."""
    return as_array(mp.matrix(rotation.tolist()) * exponential(mp.matrix(turn.tolist())))


def stiffness(random: np.random.Generator) -> np.ndarray:
    """Draw a full positive definite matrix; its blocks are Kt and Ko."""
    root = random.normal(size=(6, 6)) * np.sqrt([300, 300, 300, 20, 20, 20])[:, None]
    return root @ root.T / 6 + np.diag([30, 30, 30, 2, 2, 2])


def parameters(kind: str, H: np.ndarray, K: np.ndarray) -> list[np.ndarray]:
    """Return the arguments of a spring's kernels after q; stacks."""
    if kind == "coupled":
        return [H, K]
    limits = [np.full(len(K), limit) for limit in LIMITS] if kind == "bounded" else []
    return [H, K[:, :3, :3], K[:, 3:, 3:], *limits]


def in_stacks(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Evaluate a function of CasADi on stacks of arguments; results (count, rows, columns)."""
    count = len(arguments[0])
    results = function.call([ca.DM(np.hstack(list(a.reshape(count, *a.shape[1:2] or (1,), -1)))) for a in arguments])
    return [np.stack(np.hsplit(np.array(result), count)) for result in results]


@cache
def _of_pose(kind: str, placement: Placement) -> tuple[ca.Function, ca.Function]:
    """Return functions of a pose and the parameters: the spring's closed forms, and the derivatives of its energy."""
    chosen, pose = spring(kind, placement), ca.SX.sym("pose", 4, 4)
    given = [ca.SX.sym(a.name, *map(int, a.shape)) for a in chosen.parameters]
    found = derivatives(chosen, pose[:3, 3], pose[:3, :3], given)
    reference = differentiated(chosen, placement, pose, ca.SX.sym("q"), given)
    results = (found.V, found.F, found.K), [reference[name] for name in RESULTS[:3]]
    one, other = (ca.Function("f", [pose, *given], list(map(ca.densify, each)), {"cse": True}) for each in results)
    return one, other


def reference(kind: str, placement: Placement, pose: np.ndarray, H: np.ndarray, K: np.ndarray) -> dict[str, np.ndarray]:
    """Return energy, wrench and task stiffness of a spring at one pose, of doubles or 60 digits; limits are LIMITS."""
    given = (each[0] for each in parameters(kind, H[None], K[None]))
    results = exactly(_of_pose(kind, placement)[1], pose, *given)
    shapes: tuple[tuple[int, ...], ...] = ((), (6,), (6, 6))
    return {n: each.astype(float).reshape(s) for n, each, s in zip(RESULTS, results, shapes, strict=False)}


def _springs(placements: Iterable[Placement]) -> list[tuple[str, Placement]]:
    return list(itertools.product(KINDS, placements))


def pose_errors(placements: list[Placement], case: str, count: int, seed: int) -> Errors:
    """Return the worst relative errors of energy, wrench and covariant Hessian at poses of exact doubles."""
    random = np.random.default_rng(seed)
    pose, H = (np.tile(np.eye(4), (count, 1, 1)) for _ in range(2))
    K = np.stack([stiffness(random) for _ in range(count)])
    for c in range(count):
        angle, away = distance(case, random)
        H[c, :3, :3], H[c, :3, 3] = turned(np.eye(3), axis(random) * random.uniform(0, np.pi)), random.normal(size=3)
        pose[c, :3, :3] = turned(H[c, :3, :3], axis(random) * angle)
        pose[c, :3, 3] = H[c, :3, 3] + away * axis(random)
    worst: Errors = {}
    for s in _springs(placements):
        worst[s] = dict.fromkeys(RESULTS[:3], 0.0)
        found = in_stacks(_of_pose(*s)[0], pose, *parameters(s[0], H, K))
        for c in range(count):
            for value, (name, expected) in zip(found, reference(*s, pose[c], H[c], K[c]).items(), strict=True):
                error = _relative_error(name, value[c].reshape(expected.shape), expected)
                worst[s][name] = max(worst[s][name], error)
    return worst


def _relative_error(name: str, value: np.ndarray, reference: np.ndarray) -> float:
    """Return the error relative to the largest entry; forces, moments and blocks of stiffnesses each have their own."""
    error, size = np.abs(value - reference), np.abs(reference)
    if name == "wrench":
        scale = np.repeat([size[:3].max(), size[3:].max()], 3)
    elif name == "task_stiffness":
        root = np.sqrt(np.repeat([size[:3, :3].max(), size[3:, 3:].max()], 3))
        scale = np.outer(root, root)
    else:
        scale = size.max()
    return float((error / scale).max())


def urdf_of(robot: str, work: Path) -> Path:
    if robot == "iiwa14":
        return URDF
    path = work / f"{robot.replace(' ', '_')}.urdf"
    path.write_text(chain_urdf({"six axes": "rrrrrr", "slides and mimics": "rrpmrr"}[robot]))
    return path


Evaluated = Callable[[str, Placement], dict[str, Callable[..., np.ndarray]]]
"""The five kernels of a spring on stacks, by name."""


def by_casadi(chain: stiffgen.Chain) -> Evaluated:
    """Return the kernels as CasADi functions, called as the module's are."""

    def kernels(kind: str, placement: Placement) -> dict[str, Callable[..., np.ndarray]]:
        """Return the functions of a spring over samples, by name."""
        chosen = spring(kind, placement)
        table = [
            k
            for k in chain_kernels(chain, KernelOptions(springs=(kind,), placement=placement))
            if k.group == chosen.name
        ]
        functions = {k.name: casadi_function(chain, k) for k in table if k.name in RESULTS}
        return {name: lambda *given, f=f: in_stacks(f, *given)[0] for name, f in functions.items()}

    return kernels


def by_module(folder: Path) -> Evaluated:
    """Return the kernels of a compiled folder, whose springs have their default axes."""
    module = stiffgen.open_robot(folder).module
    return lambda kind, _: {name: getattr(getattr(module, spring(kind).name), name) for name in RESULTS}


def robot_errors(
    urdf: Path, kernels: Evaluated, placements: list[Placement], case: str, count: int, seed: int
) -> tuple[Errors, Errors]:
    """Return the worst errors of the kernels along q: relative, and in units of 1e-11 plus 16 roundings of the pose."""
    chain, random = stiffgen.load_chain(urdf), np.random.default_rng(seed)
    lower = np.array([max(c.lower, -2.0) for c in chain.coordinates])
    upper = np.array([min(c.upper, 2.0) for c in chain.coordinates])
    q, H = random.uniform(lower, upper, (count, chain.dof)), np.tile(np.eye(4), (count, 1, 1))
    K = np.stack([stiffness(random) for _ in range(count)])
    r = References(chain, count, seed, samples=Samples(chain, count, seed, {Q: q}))
    pose_of = ca.Function("pose", [r.place.q, ONE], [ca.densify(r.pose_expression)])
    poses = [exactly(pose_of, each, 1.0)[0] for each in q]
    for c, pose in enumerate(poses):
        angle, away = distance(case, random)
        H[c, :3, :3] = turned(pose[:3, :3], axis(random) * angle)
        H[c, :3, 3] = pose[:3, 3].astype(float) + away * axis(random)
    relative: Errors = {s: dict.fromkeys(RESULTS, 0.0) for s in _springs(placements)}
    allowed: Errors = {s: dict.fromkeys(RESULTS, 0.0) for s in relative}
    for s in relative:
        given = parameters(s[0], H, K)
        found = {name: kernel(q, *given) for name, kernel in kernels(*s).items()}
        expected = along_q(r, [reference(*s, poses[c], H[c], K[c]) for c in range(count)])
        for c, by_name in enumerate(expected):
            scales = _scales(by_name["wrench"], poses[c], H[c], K[c])
            for name, value in by_name.items():
                got = found[name][c].reshape(value.shape)
                error = np.abs(got - value).max() / (1e-11 * np.abs(value).max() + 16 * EPS * scales[name])
                relative[s][name] = max(relative[s][name], _relative_error(name, got, value))
                allowed[s][name] = max(allowed[s][name], error)
    return relative, allowed


def along_q(r: References, of_pose: list[dict[str, np.ndarray]]) -> list[dict[str, np.ndarray]]:
    """Add torque -J^T F and joint stiffness at the references' states, with their J and dJ^T/dq."""
    J, wrenches = r.jacobian["hybrid"], np.stack([each["wrench"] for each in of_pose])
    load = load_stiffness(r, "hybrid", wrenches)
    return [
        each
        | {"torque": (-J[c].T @ each["wrench"]).astype(float)}
        | {"joint_stiffness": (load[c] + J[c].T @ each["task_stiffness"] @ J[c]).astype(float)}
        for c, each in enumerate(of_pose)
    ]


def _scales(wrench: np.ndarray, pose: np.ndarray, H: np.ndarray, K: np.ndarray) -> dict[str, float]:
    """Return what a rounding of the pose changes in the results."""
    stiff = np.abs(K).max()
    lever = 1 + np.abs(pose[:3, 3].astype(float)).max() + np.abs(H[:3, 3]).max()
    scales = np.abs(wrench).max() + 16 * EPS * stiff, *(stiff * lever**power for power in (1, 1, 2, 3))
    return dict(zip(RESULTS, map(float, scales), strict=True))
