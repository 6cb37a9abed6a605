"""Errors of springs against 60 digits: of the energy's derivatives at given poses, and of the kernels along q."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

import stiffgen
from stiffgen.symbolic.springs import Placement, derivatives, spring
from support.chains import chain_urdf
from support.exact_springs import energy, exact, moved, mp, orthonormal, poses
from support.project import URDF

CASES = ("random", "near", "edge")
PLACEMENTS = {
    "default": Placement(),
    "tip, base, remote": Placement("tip", "base", (0.1, -0.2, 0.3)),
    "equilibrium, tip, remote": Placement("equilibrium", "tip", (-0.05, 0.0, 0.4)),
    "base, equilibrium, remote": Placement("base", "equilibrium", (0.0, 0.3, 0.1)),
}
ROBOTS = ("iiwa14", "six axes", "slides and mimics")
EPS = 2.0**-52


def rotation(vector: np.ndarray) -> np.ndarray:
    """exp([vector]) in 60 digits."""
    v = exact(vector)
    a = mp.sqrt(v @ v)
    K = exact(np.zeros((3, 3)))
    K[0, 1], K[0, 2], K[1, 2] = -v[2], v[1], -v[0]
    K = (K - K.T) / a
    return exact(np.eye(3)) + K * mp.sin(a) + (K @ K) * (1 - mp.cos(a))


def distance(case: str, random: np.random.Generator) -> tuple[float, float]:
    """Angle [rad] and displacement [m] of a case's pose from its equilibrium."""
    if case == "near":
        d = 10 ** random.uniform(-9, -3)
        return d, d
    if case == "edge":
        return np.pi - 10 ** random.uniform(-7, -6), random.uniform(0, 0.5)
    return random.uniform(0.01, np.pi - 0.01), random.uniform(0, 0.5)


def axis(random: np.random.Generator) -> np.ndarray:
    v = random.normal(size=3)
    return v / np.linalg.norm(v)


def stiffnesses(kind: str, random: np.random.Generator) -> list[np.ndarray]:
    root = random.normal(size=(6, 6)) * np.sqrt([300, 300, 300, 20, 20, 20])[:, None]
    K = root @ root.T / 6 + np.diag([30, 30, 30, 2, 2, 2])
    return [K] if kind == "coupled" else [K[:3, :3].copy(), K[3:, 3:].copy()]


def floats(array: np.ndarray) -> np.ndarray:
    return np.array([float(x) for x in array.ravel()]).reshape(array.shape)


@cache
def _of_pose(kind: str, placement: str) -> ca.Function:
    chosen = spring(kind, PLACEMENTS[placement])
    pose = ca.SX.sym("pose", 4, 4)
    parameters = [ca.SX.sym(a.name, *map(int, a.shape)) for a in chosen.parameters]
    results = derivatives(chosen, pose[:3, 3], pose[:3, :3], parameters)
    return ca.Function("f", [pose, *parameters], [ca.densify(r) for r in results], {"cse": True})


def pose_errors(kind: str, placement: str, case: str, count: int, seed: int) -> dict[str, float]:
    """Worst relative errors of energy, wrench and covariant Hessian at poses of doubles, taken as they are."""
    random = np.random.default_rng(seed)
    worst = {"energy": 0.0, "wrench": 0.0, "task_stiffness": 0.0}
    for _ in range(count):
        angle, away = distance(case, random)
        R0 = rotation(axis(random) * random.uniform(0, np.pi))
        pose, H = np.eye(4), np.eye(4)
        H[:3, :3], H[:3, 3] = floats(R0), random.normal(size=3)
        R = R0 @ rotation(axis(random) * angle)
        pose[:3, :3], pose[:3, 3] = floats(R), H[:3, 3] + away * axis(random)
        K = stiffnesses(kind, random)
        # Far from the equilibrium, the rotations that the doubles are roundings of; near it, the doubles.
        turned, rest = (exact(each[:3, :3]) if case == "near" else orthonormal(each[:3, :3]) for each in (pose, H))
        at = moved(exact(pose[:3, 3]), turned)
        U = energy(kind, PLACEMENTS[placement], *at, (exact(H[:3, 3]), rest), *K)
        found = _of_pose(kind, placement)(pose, H, *K)
        for name, value, reference in zip(worst, found, (np.array([U.value]), U.first, U.second), strict=True):
            error = np.abs(np.array(value).reshape(reference.shape) - reference).max() / np.abs(reference).max()
            worst[name] = max(worst[name], float(error))
    return worst


def urdf_of(robot: str, work: Path) -> Path:
    if robot == "iiwa14":
        return URDF
    path = work / "chain.urdf"
    path.write_text(chain_urdf({"six axes": "rrrrrr", "slides and mimics": "rrpmrr"}[robot]))
    return path


def robot_errors(
    robot: str, kind: str, placement: str, case: str, count: int, seed: int, work: Path
) -> dict[str, float]:
    """Worst errors of the kernels by q, in units of 1e-11 of the result plus 16 roundings of the pose."""
    urdf = urdf_of(robot, work)
    chain = stiffgen.load_chain(urdf)
    model = stiffgen.StiffnessModel(chain, springs=[kind], placement=PLACEMENTS[placement])
    group = getattr(model, spring(kind).name)
    random = np.random.default_rng(seed)
    lower = np.array([max(c.lower, -2.0) for c in chain.coordinates])
    upper = np.array([min(c.upper, 2.0) for c in chain.coordinates])
    worst: dict[str, float] = {}
    for _ in range(count):
        q = random.uniform(lower, upper)
        p, R = poses(urdf.read_text(), q)
        value_p, value_R = (np.vectorize(lambda jet: jet.value, otypes=[object])(each) for each in (p, R))
        angle, away = distance(case, random)
        H = np.eye(4)
        H[:3, :3] = floats(value_R @ rotation(axis(random) * angle))
        H[:3, 3] = floats(value_p) + away * axis(random)
        K = stiffnesses(kind, random)
        rest = (exact(H[:3, 3]), orthonormal(H[:3, :3]))
        along = energy(kind, PLACEMENTS[placement], p, R, rest, *K)
        at_tip = energy(kind, PLACEMENTS[placement], *moved(value_p, value_R), rest, *K)
        stiff = max(np.abs(each).max() for each in K)
        lever = 1 + float(np.abs(value_p).max()) + float(np.abs(H[:3, 3]).max())
        F = float(np.abs(at_tip.first).max())
        scales = {
            "energy": F + 16 * EPS * stiff,
            "wrench": stiff * lever,
            "task_stiffness": stiff * lever,
            "torque": stiff * lever**2,
            "joint_stiffness": stiff * lever**3,
        }
        references = {
            "energy": np.array([along.value]),
            "wrench": at_tip.first,
            "task_stiffness": at_tip.second,
            "torque": -along.first,
            "joint_stiffness": along.second,
        }
        for name, reference in references.items():
            value = np.array(getattr(group, name)(q, H, *K)).reshape(reference.shape)
            allowed = 1e-11 * float(np.abs(reference).max()) + 16 * EPS * scales[name]
            worst[name] = max(worst.get(name, 0.0), float(np.abs(value - reference).max()) / allowed)
    return worst
