# SPDX-License-Identifier: MIT
"""Provide a reference with 60 digits for every kernel of a tree: definitions and differences, no formula of a kernel.

A joint stiffness is the Hessian of an energy whose wrench and covariant Hessian are the arguments. All derivatives are
differences along the coordinates x: on a floating base, its body twist comes before the joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mpmath
import numpy as np

from stiffgen.core.robot.chain import Chain
from support.exact_tree import AT_ORIGIN, STEP, ExactTree, Pose, as_array, differentiated, exact_pose, exponential, mp

Vector = list[Any]
Energy = Callable[[Pose], mpmath.mpf]
Given = Mapping[str, Any]


def matrix(values: Any) -> mpmath.matrix:
    """Return doubles as a matrix; a vector becomes a column."""
    return mp.matrix(np.asarray(values, dtype=float).tolist())


def symmetric(values: Any) -> mpmath.matrix:
    """Return the symmetric part of a matrix of doubles."""
    return (matrix(values) + matrix(values).T) / 2


def axial(W: mpmath.matrix) -> mpmath.matrix:
    """Return the vector of the antisymmetric part."""
    return mp.matrix([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2


def cross(v: mpmath.matrix) -> mpmath.matrix:
    return mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def blocks(rows: list[list[Any]]) -> mpmath.matrix:
    """Return a 6x6 matrix of four 3x3 blocks, where 0 stands for zeros."""
    total = mp.zeros(6)
    for r, row in enumerate(rows):
        for c, block in enumerate(row):
            if not isinstance(block, int):
                total[3 * r : 3 * r + 3, 3 * c : 3 * c + 3] = block
    return total


def dot(a: mpmath.matrix, b: mpmath.matrix) -> mpmath.mpf:
    return (a.T * b)[0]


def difference(function: Callable[[mpmath.mpf], mpmath.matrix]) -> mpmath.matrix:
    """Return the derivative at 0."""
    return (function(STEP) - function(-STEP)) / (2 * STEP)


def displacement(representation: str, at: Pose, pose: Pose) -> mpmath.matrix:
    """Return the coordinates (v, w) about ``at`` in which second derivatives are those of the connection.

    body: p = p0 + R0 v, R = R0 exp([w]). hybrid: p = p0 + v, R = exp([w]) R0. spatial: p = exp([w]) p0 + v, R as in
    hybrid form.
    """
    (R0, p0), (R, p) = at, pose
    if representation == "body":
        away, turned = R0.T * (p - p0), axial(R0.T * R)
    elif representation == "hybrid":
        away, turned = p - p0, axial(R * R0.T)
    else:
        away, turned = p - R * R0.T * p0, axial(R * R0.T)
    return mp.matrix([*away, *turned])


def connection(representation: str, wrench: mpmath.matrix) -> mpmath.matrix:
    """Return Gamma F, as the paper's appendix lists it."""
    f, m = cross(wrench[:3]), cross(wrench[3:])
    if representation == "body":
        return blocks([[0, f], [0, m / 2]])
    return blocks([[0, 0], [f.T, m.T / 2]]) if representation == "spatial" else blocks([[0, 0], [0, m.T / 2]])


@dataclass(frozen=True)
class ExactRobot:
    """A tree at a configuration: pose of its base, and joint positions."""

    tree: ExactTree
    size: int
    base: Pose
    q: Vector

    @staticmethod
    def of(text: str, chain: Chain, given: Given) -> ExactRobot:
        """Return the tree of a URDF at the arguments ``base_pose`` and ``q``."""
        tree = ExactTree(text, [each.name for each in chain.coordinates])
        base = exact_pose(given["base_pose"]) if chain.floating else AT_ORIGIN
        return ExactRobot(tree, chain.dof, base, [mp.mpf(float(x)) for x in given["q"]])

    def unit(self, k: int, size: Any) -> Vector:
        """Return the displacement x of one coordinate."""
        return [size if i == k else mp.mpf(0) for i in range(self.size)]

    def moved(self, x: Vector) -> ExactRobot:
        """Return the robot displaced by x."""
        own, y = (x[:6], x[6:]) if self.size > self.tree.size else ([mp.mpf(0)] * 6, x)
        R, p = self.base
        base = R * exponential(mp.matrix(own[3:])), p + R * mp.matrix(own[:3])
        return replace(self, base=base, q=[a + b for a, b in zip(self.q, y, strict=True)])

    def pose(self, link: str) -> Pose:
        return self.tree.poses(self.base, self.q)[link]

    def jacobian(self, representation: str, link: str) -> mpmath.matrix:
        R, p = self.pose(link)
        total = mp.zeros(6, self.size)
        for k in range(self.size):
            (R1, p1), (R0, p0) = (self.moved(self.unit(k, s * STEP)).pose(link) for s in (1, -1))
            v, w = (p1 - p0) / (2 * STEP), axial((R1 - R0) * R.T) / (2 * STEP)
            if representation == "body":
                v, w = R.T * v, R.T * w
            elif representation == "spatial":
                v = v - cross(w) * p
            total[:, k] = mp.matrix([*v, *w])
        return total

    def along(self, function: Callable[[ExactRobot], mpmath.matrix], k: int) -> mpmath.matrix:
        """Return the derivative of a function with respect to coordinate k."""
        return difference(lambda size: function(self.moved(self.unit(k, size))))

    def derivatives(self, energy: Callable[[ExactRobot], mpmath.mpf]) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and Hessian with respect to x."""
        return differentiated(lambda x: energy(self.moved(x)), self.size)

    def bias_forces(self, velocity: mpmath.matrix, gravity: mpmath.matrix) -> np.ndarray:
        """Return the generalised forces at zero accelerations, from the bodies' momenta (d'Alembert)."""
        rates = [*velocity]

        def at(time: mpmath.mpf) -> dict[str, Pose]:
            x = [rate * time for rate in rates]
            if self.size > self.tree.size:  # a body twist (v, w) that is constant bends the path: dv/dt = w x v
                bend = cross(mp.matrix(rates[3:6])) * mp.matrix(rates[:3]) * time**2 / 2
                x[:3] = [a + b for a, b in zip(x[:3], bend, strict=True)]
            there = self.moved(x)
            return self.tree.poses(there.base, there.q)

        near = mp.mpf(10) ** -18
        poses = {time: at(time) for t in (-STEP, mp.mpf(0), STEP) for time in (t - near, t, t + near)}
        twists = self.tree.twists(self.base, self.q, self.size, lambda each: [each[n] for n in self.tree.bodies])
        total = mp.zeros(self.size, 1)
        for (link, (mass, (place, com), tensor)), J in zip(self.tree.bodies.items(), twists, strict=True):
            R = poses[mp.mpf(0)][link][0]
            centre = {t: poses[t][link][1] + poses[t][link][0] * com for t in (-STEP, mp.mpf(0), STEP)}
            force = mass * ((centre[STEP] - 2 * centre[mp.mpf(0)] + centre[-STEP]) / STEP**2 - gravity)

            def momentum(t: mpmath.mpf, link: str = link, inertia: mpmath.matrix = place * tensor * place.T) -> Any:
                turn = poses[t][link][0]
                rate = axial((poses[t + near][link][0] - poses[t - near][link][0]) * turn.T) / (2 * near)
                return turn * inertia * turn.T * rate

            moment = difference(momentum)
            linear = R * (J[:3, :] - cross(com) * J[3:, :])
            total += linear.T * force + (R * J[3:, :]).T * moment
        return as_array(total).ravel()


def loaded(representation: str, at: Pose, wrench: mpmath.matrix, stiffness: mpmath.matrix) -> Energy:
    """Return the energy whose wrench and covariant Hessian at a pose are given."""

    def energy(pose: Pose) -> mpmath.mpf:
        x = displacement(representation, at, pose)
        return dot(wrench, x) + dot(x, stiffness * x) / 2

    return energy
