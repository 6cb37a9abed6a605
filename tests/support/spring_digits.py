# SPDX-License-Identifier: MIT
"""Compare springs with 60 digits: derivatives of the energy at given poses, and kernels along q."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

import stiffgen
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.symbolic.placement import AXES, Placement
from stiffgen.families.springs.springs import derivatives, spring
from support.chains import chain_urdf
from support.exact_springs import Energies, Jet, Kinematics, exact, floats, moved, orthonormal, rotation
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
        return 10 ** random.uniform(-3, -1), 1e-3
    if case == "edge":
        return np.pi - 10 ** random.uniform(-9, -6), random.uniform(0.01, 0.5)
    return random.uniform(0.01, np.pi - 0.01), random.uniform(0.01, 0.5)


def axis(random: np.random.Generator) -> np.ndarray:
    v = random.normal(size=3)
    return v / np.linalg.norm(v)


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
def _of_pose(kind: str, placement: Placement) -> ca.Function:
    chosen = spring(kind, placement)
    pose = ca.SX.sym("pose", 4, 4)
    given = [ca.SX.sym(a.name, *map(int, a.shape)) for a in chosen.parameters]
    found = derivatives(chosen, pose[:3, 3], pose[:3, :3], given)
    return ca.Function("f", [pose, *given], [ca.densify(r) for r in (found.V, found.F, found.K)], {"cse": True})


def _springs(placements: Iterable[Placement]) -> list[tuple[str, Placement]]:
    return list(itertools.product(KINDS, placements))


def pose_errors(placements: list[Placement], case: str, count: int, seed: int) -> Errors:
    """Return the worst relative errors of energy, wrench and covariant Hessian at poses of exact doubles."""
    random = np.random.default_rng(seed)
    pose, H = (np.tile(np.eye(4), (count, 1, 1)) for _ in range(2))
    K = np.stack([stiffness(random) for _ in range(count)])
    for c in range(count):
        angle, away = distance(case, random)
        R0 = rotation(axis(random) * random.uniform(0, np.pi))
        H[c, :3, :3], H[c, :3, 3] = floats(R0), random.normal(size=3)
        R = R0 @ rotation(axis(random) * angle)
        pose[c, :3, :3], pose[c, :3, 3] = floats(R), H[c, :3, 3] + away * axis(random)
    found = {s: in_stacks(_of_pose(*s), pose, *parameters(s[0], H, K)) for s in _springs(placements)}
    worst: Errors = {s: dict.fromkeys(RESULTS[:3], 0.0) for s in found}
    for c in range(count):
        # Far from the equilibrium, the rotations that the doubles are roundings of; near it, the doubles.
        as_it_is = exact if case in ("near", "small") else orthonormal
        R, R0 = (as_it_is(each[c, :3, :3]) for each in (pose, H))
        energies = Energies(*moved(exact(pose[c, :3, 3]), R), (exact(H[c, :3, 3]), R0), K[c], LIMITS)
        for s, values in found.items():
            for name, value, reference in zip(RESULTS, values, _derivatives(energies(*s)), strict=False):
                error = _relative_error(name, value[c].reshape(reference.shape), reference)
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


def _derivatives(energy: Jet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value, gradient (k) and Hessian (k, k) in doubles; the radii of the balls must be far smaller."""
    assert min(each.rel_accuracy_bits() for each in (energy.value, *energy.second.entries()[:1])) > 80
    return np.array(float(energy.value)), floats(energy.first)[0], floats(energy.second)


def urdf_of(robot: str, work: Path) -> Path:
    if robot == "iiwa14":
        return URDF
    path = work / f"{robot.replace(' ', '_')}.urdf"
    path.write_text(chain_urdf({"six axes": "rrrrrr", "slides and mimics": "rrpmrr"}[robot]))
    return path


Evaluated = Callable[[str, Placement], dict[str, Callable[..., np.ndarray]]]
"""The five kernels of a spring on stacks, by name."""


def by_casadi(chain: stiffgen.Chain) -> Evaluated:
    """Return the kernels as CasADi functions."""

    def kernels(kind: str, placement: Placement) -> dict[str, Callable[..., np.ndarray]]:
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
    chain, exactly = stiffgen.load_chain(urdf), Kinematics(urdf.read_text())
    random = np.random.default_rng(seed)
    lower = np.array([max(c.lower, -2.0) for c in chain.coordinates])
    upper = np.array([min(c.upper, 2.0) for c in chain.coordinates])
    q, H = random.uniform(lower, upper, (count, chain.dof)), np.tile(np.eye(4), (count, 1, 1))
    K = np.stack([stiffness(random) for _ in range(count)])
    jets = [exactly.poses(each) for each in q]
    values = [tuple(np.vectorize(lambda jet: jet.value, otypes=[object])(each) for each in at) for at in jets]
    for c, (p, R) in enumerate(values):
        angle, away = distance(case, random)
        H[c, :3, :3] = floats(R @ rotation(axis(random) * angle))
        H[c, :3, 3] = floats(p) + away * axis(random)
    found = {
        s: {name: kernel(q, *parameters(s[0], H, K)) for name, kernel in kernels(*s).items()}
        for s in _springs(placements)
    }
    relative: Errors = {s: dict.fromkeys(RESULTS, 0.0) for s in found}
    allowed: Errors = {s: dict.fromkeys(RESULTS, 0.0) for s in found}
    for c in range(count):
        rest = exact(H[c, :3, 3]), orthonormal(H[c, :3, :3])
        along, at_tip = Energies(*jets[c], rest, K[c], LIMITS), Energies(*moved(*values[c]), rest, K[c], LIMITS)
        stiff = np.abs(K[c]).max()
        lever = 1 + np.abs(floats(values[c][0])).max() + np.abs(H[c, :3, 3]).max()
        for s, results in found.items():
            U, gradient, hessian = _derivatives(along(*s))
            _, F, covariant = _derivatives(at_tip(*s))
            for name, reference, scale in (
                ("energy", U, np.abs(F).max() + 16 * EPS * stiff),
                ("wrench", F, stiff * lever),
                ("task_stiffness", covariant, stiff * lever),
                ("torque", -gradient, stiff * lever**2),
                ("joint_stiffness", hessian, stiff * lever**3),
            ):
                value, largest = results[name][c].reshape(reference.shape), np.abs(reference).max()
                error = np.abs(value - reference).max() / (1e-11 * largest + 16 * EPS * scale)
                relative[s][name] = max(relative[s][name], _relative_error(name, value, reference))
                allowed[s][name] = max(allowed[s][name], error)
    return relative, allowed
