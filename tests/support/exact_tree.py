# SPDX-License-Identifier: MIT
"""Compute poses and energies of trees on a fixed or floating base with 60 digits, from the numbers in the file.

Derivatives are differences along exponentials, with steps so small that forty of the sixty digits remain. The
coordinates are the joints; on a floating base the base's body twist (linear first) comes before them.
"""

from __future__ import annotations

import itertools
import random
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from support.chains import child_of

mp = mpmath.mp.clone()
mp.dps = 60


def numbers(text: str | None, default: str) -> list[mpmath.mpf]:
    return [mp.mpf(word) for word in (text or default).split()]


STEP = mp.mpf(10) ** -12
MOVING = ("revolute", "continuous", "prismatic")
Pose = tuple[mpmath.matrix, mpmath.matrix]


def tree_urdf(seed: int, joints: int = 12) -> str:
    """Return a random tree with the tips "left" and "right": each with a sliding joint, and one that mimics."""
    source = random.Random(seed)

    def drawn(count: int, low: float, high: float) -> str:
        return " ".join(f"{source.uniform(low, high):.6f}" for _ in range(count))

    def link(name: str) -> str:
        """Return a link with random mass [kg], centre [m] and inertia [kg m^2]."""
        xx, yy = source.uniform(0.02, 0.04), source.uniform(0.02, 0.04)
        offs = [f"{source.uniform(-0.004, 0.004):.6f}" for _ in range(3)]
        return (
            f'<link name="{name}"><inertial><origin xyz="{drawn(3, -0.1, 0.1)}" rpy="{drawn(3, -2, 2)}"/>'
            f'<mass value="{source.uniform(0.5, 3):.6f}"/><inertia ixx="{xx:.6f}" iyy="{yy:.6f}" izz="0.03" '
            f'ixy="{offs[0]}" ixz="{offs[1]}" iyz="{offs[2]}"/></inertial></link>'
        )

    trunk, per_branch = joints - 2 * ((joints - 2) // 2), (joints - 2) // 2
    parts, parents = [link("pelvis")], {"left": "pelvis", "right": "pelvis"}
    names = [("trunk", k) for k in range(trunk)] + [(b, k) for k in range(per_branch) for b in ("left", "right")]
    for branch, k in names:
        last = k == per_branch - 1
        child = f"{branch}_{k}" if branch == "trunk" or not last else branch
        parent = parents["left"] if branch == "trunk" else parents[branch]
        parents |= dict.fromkeys(parents, child) if branch == "trunk" else {branch: child}
        kind = "prismatic" if (branch, k) in (("left", 1), ("right", 2)) else "revolute"
        mimic = '<mimic joint="left_j0" multiplier="-0.6" offset="0.25"/>' if (branch, k) == ("right", 1) else ""
        parts.append(link(child))
        parts.append(
            f'<joint name="{branch}_j{k}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{drawn(3, -0.3, 0.3)}" rpy="{drawn(3, -3, 3)}"/><axis xyz="{drawn(3, -1, 1)}"/>'
            f'<limit lower="-2" upper="2" effort="10" velocity="1"/>{mimic}</joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


def turn(axis: Sequence[Any], angle: Any) -> mpmath.matrix:
    K = mp.matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return mp.eye(3) + mp.sin(angle) * K + (1 - mp.cos(angle)) * K * K


def origin(element: ET.Element) -> tuple[mpmath.matrix, mpmath.matrix]:
    found = element.find("origin")
    given = {} if found is None else found.attrib
    roll, pitch, yaw = numbers(given.get("rpy"), "0 0 0")
    rotation = turn((0, 0, 1), yaw) * turn((0, 1, 0), pitch) * turn((1, 0, 0), roll)
    return rotation, mp.matrix(numbers(given.get("xyz"), "0 0 0"))


def exponential(w: mpmath.matrix) -> mpmath.matrix:
    """Return the rotation exp([w])."""
    angle = mp.norm(w)
    return turn(w / angle, angle) if angle else mp.eye(3)


def _after(outer: Pose, inner: Pose) -> Pose:
    return outer[0] * inner[0], outer[1] + outer[0] * inner[1]


@dataclass
class _Joint:
    parent: str
    child: str
    place: Pose
    axis: mpmath.matrix | None
    slides: bool
    coordinate: int
    multiplier: mpmath.mpf
    offset: mpmath.mpf


class ExactTree:
    """Robot whose file lists joints after their parents; ``coordinates`` names the entries of q."""

    def __init__(self, text: str, coordinates: list[str]) -> None:
        """Read bodies and joints of a URDF text as numbers of many digits."""
        robot = ET.fromstring(text)
        self.size = len(coordinates)
        self.bodies: dict[str, tuple[mpmath.mpf, Pose, mpmath.matrix]] = {}
        for link in robot.findall("link"):
            inertial = link.find("inertial")
            if inertial is not None:
                i = {key: mp.mpf(value) for key, value in child_of(inertial, "inertia").attrib.items()}
                rows = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
                tensor = mp.matrix([[i[key] for key in row] for row in rows])
                mass = mp.mpf(child_of(inertial, "mass").attrib["value"])
                self.bodies[link.attrib["name"]] = mass, origin(inertial), tensor
        self.joints = []
        for joint in robot.findall("joint"):
            axis, mimic, name = None, joint.find("mimic"), joint.attrib["name"]
            parent, child = (child_of(joint, end).attrib["link"] for end in ("parent", "child"))
            if joint.get("type") in MOVING:
                axis = mp.matrix(numbers(child_of(joint, "axis").attrib["xyz"], ""))
                axis /= mp.norm(axis)
            relation = {} if mimic is None else mimic.attrib
            master = relation.get("joint", name)
            self.joints.append(
                _Joint(
                    parent, child, origin(joint), axis,
                    joint.get("type") == "prismatic", coordinates.index(master) if axis is not None else -1,
                    mp.mpf(relation.get("multiplier", "1")), mp.mpf(relation.get("offset", "0")),
                )
            )  # fmt: skip
        self.root = self.joints[0].parent

    def poses(self, base: Pose, q: list[mpmath.mpf]) -> dict[str, Pose]:
        """Return the pose of every link in the base, rotation and origin, with mpmath's digits."""
        poses = {self.root: base}
        for joint in self.joints:
            pose = _after(poses[joint.parent], joint.place)
            if joint.axis is not None:
                position = joint.multiplier * q[joint.coordinate] + joint.offset
                moved = joint.axis * position
                pose = _after(pose, (mp.eye(3), moved) if joint.slides else (exponential(moved), mp.zeros(3, 1)))
            poses[joint.child] = pose
        return poses

    def moved(self, base: Pose, q: list[mpmath.mpf], x: list[mpmath.mpf]) -> dict[str, Pose]:
        """Return the poses after a motion x along the exponentials: base to p + R v, R exp([w]), joints to q + y."""
        own, y = (x[:6], x[6:]) if len(x) > self.size else ([mp.mpf(0)] * 6, x)
        rotation = base[0] * exponential(mp.matrix(own[3:]))
        place = base[1] + base[0] * mp.matrix(own[:3])
        return self.poses((rotation, place), [a + b for a, b in zip(q, y, strict=True)])

    def potential_energy(
        self, poses: dict[str, Pose], gravity: mpmath.matrix, left_out: tuple[str, ...] = ()
    ) -> mpmath.mpf:
        """Return U [J] of all bodies under gravity."""
        total = mp.mpf(0)
        for link, (mass, com, _) in self.bodies.items():
            if link not in left_out:
                total -= mass * (gravity.T * _after(poses[link], com)[1])[0]
        return total

    def twists(
        self, base: Pose, q: list[mpmath.mpf], size: int, frames: Callable[[dict[str, Pose]], list[Pose]]
    ) -> list[mpmath.matrix]:
        """Return the body Jacobians (6, size) of some frames, by central differences of position and rotation."""
        here = frames(self.moved(base, q, [mp.mpf(0)] * size))
        jacobians = [mp.zeros(6, size) for _ in here]
        for k in range(size):
            ends = [frames(self.moved(base, q, [sign * STEP * (i == k) for i in range(size)])) for sign in (1, -1)]
            # (R1, p1) ahead and (R0, p0) behind: v is the velocity, W the skew matrix of the angular velocity.
            for jacobian, (R, _), (R1, p1), (R0, p0) in zip(jacobians, here, *ends, strict=True):
                v, W = R.T * (p1 - p0) / (2 * STEP), R.T * (R1 - R0) / (2 * STEP)
                jacobian[:, k] = mp.matrix([*v, W[2, 1], W[0, 2], W[1, 0]])
        return jacobians

    def mass_matrix(self, base: Pose, q: list[mpmath.mpf], size: int, left_out: tuple[str, ...] = ()) -> np.ndarray:
        """Return the mass matrix: the sum of J^T I J over the bodies."""
        links = [link for link in self.bodies if link not in left_out]
        jacobians = self.twists(base, q, size, lambda poses: [_after(poses[n], self.bodies[n][1]) for n in links])
        total = mp.zeros(size)
        for link, J in zip(links, jacobians, strict=True):
            mass, _, tensor = self.bodies[link]
            total += mass * J[:3, :].T * J[:3, :] + J[3:, :].T * tensor * J[3:, :]
        return as_array(total)


def _chain(text: str, q: np.ndarray) -> tuple[ExactTree, list[mpmath.mpf]]:
    """Read a serial chain on a fixed base; joints stand in order in the file."""
    moving = [joint for joint in ET.fromstring(text).findall("joint") if joint.get("type") in MOVING]
    names = [joint.attrib["name"] for joint in moving if joint.find("mimic") is None]
    return ExactTree(text, names), [mp.mpf(float(each)) for each in q]


AT_ORIGIN: Pose = (mp.eye(3), mp.zeros(3, 1))


def chain_pose(text: str, q: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of a serial chain's last link in its first."""
    tree, positions = _chain(text, q)
    rotation, place = tree.poses(AT_ORIGIN, positions)[tree.joints[-1].child]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = as_array(rotation), as_array(place).ravel()
    return pose


def chain_mass_matrix(text: str, q: np.ndarray) -> np.ndarray:
    """Return the mass matrix (n, n) of a serial chain."""
    tree, positions = _chain(text, q)
    return tree.mass_matrix(AT_ORIGIN, positions, len(q))


def differentiated(function: Callable[[list[mpmath.mpf]], mpmath.mpf], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient and Hessian at zero, by central differences."""

    def at(*steps: tuple[int, int]) -> mpmath.mpf:
        x = [mp.mpf(0)] * size
        for k, sign in steps:
            x[k] += sign * STEP
        return function(x)

    middle = at()
    ends = [(at((k, 1)), at((k, -1))) for k in range(size)]
    gradient = mp.matrix([(up - down) / (2 * STEP) for up, down in ends])
    hessian = mp.diag([(up - 2 * middle + down) / STEP**2 for up, down in ends])
    for i, j in itertools.combinations(range(size), 2):
        both = at((i, 1), (j, 1)) + at((i, -1), (j, -1)) - sum(ends[i]) - sum(ends[j]) + 2 * middle
        hessian[i, j] = hessian[j, i] = both / (2 * STEP**2)
    return as_array(gradient).ravel(), as_array(hessian)


def as_array(matrix: mpmath.matrix) -> np.ndarray:
    return np.array([[float(matrix[r, c]) for c in range(matrix.cols)] for r in range(matrix.rows)])


def exact_pose(pose: np.ndarray) -> Pose:
    """Convert a pose (4, 4) of doubles as it is."""
    return mp.matrix(pose[:3, :3].tolist()), mp.matrix(pose[:3, 3].tolist())
