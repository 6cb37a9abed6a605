# SPDX-License-Identifier: MIT
"""Energies of two tips with 60 digits, from the text of a random tree's URDF: neither stiffgen's reader nor CasADi."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import mpmath
import numpy as np

from stiffgen.core.robot.chain import Chain
from support.exact_kernels import ExactRobot, dot, matrix
from support.exact_tree import Pose, differentiated, exact_pose, exponential, mp

TIPS = ("left", "right")
Given = Mapping[str, Any]
EnergyOfPoses = Callable[[Pose, Pose], mpmath.mpf]


def pair_tree(seed: int) -> str:
    """Return a random tree with the tips "left" and "right" and 0 to 3 joints that carry both.

    One joint in five slides. In every second tree the second joint of the right branch mimics the first of the left.
    """
    source = random.Random(seed)

    def drawn(count: int, low: float, high: float) -> str:
        return " ".join(f"{source.uniform(low, high):.6f}" for _ in range(count))

    branches = {name: source.randint(2, 4) for name in TIPS}
    names = [("trunk", k) for k in range(seed % 4)] + [(name, k) for name in TIPS for k in range(branches[name])]
    parts, last, mimics = ['<link name="pelvis"/>'], "pelvis", seed % 8 >= 4
    parents = dict.fromkeys(TIPS, last)
    for branch, k in names:
        is_tip = branch != "trunk" and k == branches[branch] - 1
        child = branch if is_tip else f"{branch}_{k}"
        parent = parents["left"] if branch == "trunk" else parents[branch]
        parents |= dict.fromkeys(TIPS, child) if branch == "trunk" else {branch: child}
        kind = "prismatic" if source.random() < 0.2 and (branch, k) != ("left", 0) else "revolute"
        mimic = (
            '<mimic joint="left_j0" multiplier="-0.6" offset="0.25"/>' if mimics and (branch, k) == ("right", 1) else ""
        )
        parts.append(
            f'<link name="{child}"/><joint name="{branch}_j{k}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{drawn(3, -0.3, 0.3)}" rpy="{drawn(3, -3, 3)}"/>'
            f'<axis xyz="{drawn(3, -1, 1)}"/><limit lower="-2" upper="2" effort="10" velocity="1"/>{mimic}</joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


def _trace(matrix: mpmath.matrix) -> mpmath.mpf:
    return sum(matrix[k, k] for k in range(3))


def _symmetric(values: np.ndarray) -> mpmath.matrix:
    given = matrix(values)
    return (given + given.T) / 2


def _weight(Ko: mpmath.matrix) -> mpmath.matrix:
    return mp.eye(3) * _trace(Ko) / 2 - Ko


def between(
    given: Given, translation: str = "translation_stiffness", rotation: str = "rotation_stiffness"
) -> EnergyOfPoses:
    """Return the energy of the spring between two tips."""
    E0, d0 = exact_pose(given["rest"])
    Kt, G = _symmetric(given[translation]), _weight(_symmetric(given[rotation]))

    def energy(a: Pose, b: Pose) -> mpmath.mpf:
        A, B = a[0], b[0] * E0.T
        e = b[1] - a[1] - (A + B) * d0 / 2
        S = (A * Kt * A.T + B * Kt * B.T) / 2
        return dot(e, S * e) / 2 + _trace(G * (mp.eye(3) - A.T * B))

    return energy


def held(given: Given) -> EnergyOfPoses:
    """Return the energy of the spring that holds both tips in the base."""
    (R0, p0), (E0, _) = exact_pose(given["equilibrium"]), exact_pose(given["rest"])
    Kt, G = _symmetric(given["translation_stiffness"]), _weight(_symmetric(given["rotation_stiffness"]))

    def energy(a: Pose, b: Pose) -> mpmath.mpf:
        e = (a[1] + b[1]) / 2 - p0
        turns = sum(_trace(G * (mp.eye(3) - R0.T * R)) for R in (a[0], b[0] * E0.T))
        return dot(e, Kt * e) / 2 + turns / 2

    return energy


def energy_of(group: str, given: Given) -> EnergyOfPoses:
    """Return the energy of the group "pair", "absolute" or "bimanual"."""
    if group == "pair":
        return between(given)
    holding = held(given)
    if group == "absolute":
        return holding
    relative = between(given, "relative_translation_stiffness", "relative_rotation_stiffness")
    return lambda a, b: holding(a, b) + relative(a, b)


def _mounted(pose: Pose, tool: Pose) -> Pose:
    return pose[0] * tool[0], pose[1] + pose[0] * tool[1]


def _moved(pose: Pose, twist: list[Any]) -> Pose:
    return exponential(mp.matrix(twist[3:])) * pose[0], pose[1] + mp.matrix(twist[:3])


def _twisted(at: tuple[Pose, Pose], x: list[Any]) -> tuple[Pose, Pose]:
    """Return the poses after twists of both, twelve numbers."""
    return _moved(at[0], x[:6]), _moved(at[1], x[6:])


def _along(energy: EnergyOfPoses, frames: Callable[[list[Any]], tuple[Pose, Pose]], x: list[Any]) -> mpmath.mpf:
    return energy(*frames(x))


def exact_pair(text: str, chain: Chain, groups: Sequence[str], given: Given) -> dict[str, np.ndarray]:
    """Return the results of the kernels of some groups by qualified name; ``given`` has their arguments by name."""
    robot = ExactRobot.of(text, chain, given)
    tools = [exact_pose(each) for each in given["tool_poses"]] if chain.runtime_tool else []
    poses: dict[tuple[Any, ...], tuple[Pose, Pose]] = {}

    def frames(x: list[Any]) -> tuple[Pose, Pose]:
        key = tuple(x)
        if key not in poses:
            of_links = robot.tree.moved(robot.base, robot.q, x)
            a, b = (of_links[tip] for tip in TIPS)
            poses[key] = (_mounted(a, tools[0]), _mounted(b, tools[1])) if tools else (a, b)
        return poses[key]

    found: dict[str, np.ndarray] = {}
    here = frames([mp.mpf(0)] * robot.size)
    for group in groups:
        energy = energy_of(group, given)
        gradient, hessian = differentiated(partial(_along, energy, frames), robot.size)
        wrench, covariant = differentiated(partial(_along, energy, partial(_twisted, here)), 12)
        found |= {
            f"{group}_energy": np.array(float(energy(*here))), f"{group}_wrench": wrench,
            f"{group}_task_stiffness": covariant, f"{group}_torque": -gradient, f"{group}_joint_stiffness": hessian,
        }  # fmt: skip
    return found
