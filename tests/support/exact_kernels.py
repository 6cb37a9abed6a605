# SPDX-License-Identifier: MIT
"""Values of some kernels of a tree with 60 digits, from the text of its URDF: neither stiffgen's reader nor CasADi.

The oracles of ``stiffgen verify`` take the chain as it was read, and CasADi differentiates them. These values see a
fault of either. A joint stiffness is the Hessian of an energy whose wrench and covariant Hessian are the arguments. All
derivatives are differences along the coordinates x: on a floating base, its body twist comes before the joints.
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


def axial(W: mpmath.matrix) -> mpmath.matrix:
    """Return the vector of the antisymmetric part."""
    return mp.matrix([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2


def cross(v: mpmath.matrix) -> mpmath.matrix:
    return mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def dot(a: mpmath.matrix, b: mpmath.matrix) -> mpmath.mpf:
    return (a.T * b)[0]


def difference(function: Callable[[mpmath.mpf], mpmath.matrix]) -> mpmath.matrix:
    """Return the derivative at 0."""
    return (function(STEP) - function(-STEP)) / (2 * STEP)


def loaded(representation: str, at: Pose, wrench: mpmath.matrix, stiffness: mpmath.matrix) -> Energy:
    """Return the energy whose wrench and covariant Hessian at a pose are given.

    Its coordinates (v, w) are those in which second derivatives are the connection's. Body: p = p0 + R0 v,
    R = R0 exp([w]). Hybrid: p = p0 + v, R = exp([w]) R0.
    """
    (R0, p0), in_body = at, representation == "body"

    def energy(pose: Pose) -> mpmath.mpf:
        R, p = pose
        away, turned = (R0.T * (p - p0), axial(R0.T * R)) if in_body else (p - p0, axial(R * R0.T))
        x = mp.matrix([*away, *turned])
        return dot(wrench, x) + dot(x, stiffness * x) / 2

    return energy


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
        """Return the Jacobian (6, size) of a link by central differences of its pose."""
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

    def hessian_at(self, link: str, energy: Energy) -> np.ndarray:
        """Return the Hessian of an energy of a link's pose."""
        return self.derivatives(lambda there: energy(there.pose(link)))[1]

    def weight(self, gravity: mpmath.matrix) -> mpmath.mpf:
        """Return the potential energy of the links that can move."""
        still = {self.tree.root} if self.size == self.tree.size else set()
        for joint in self.tree.joints:
            still |= {joint.child} if joint.axis is None and joint.parent in still else set()
        return self.tree.potential_energy(self.tree.poses(self.base, self.q), gravity, tuple(still))

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


def exact_values(text: str, chain: Chain, link: str, given: Given) -> dict[str, np.ndarray]:
    """Return values of a tip's kernels and of the robot's, by the name without the tip's."""
    robot = ExactRobot.of(text, chain, given)
    R, p = here = robot.pose(link)
    F, gravity = matrix(given["wrench"]), matrix(given["gravity"])
    K = (matrix(given["task_stiffness"]) + matrix(given["task_stiffness"]).T) / 2
    rates = [robot.along(lambda there: there.jacobian("hybrid", link), k) for k in range(robot.size)]
    gradient, hessian = robot.derivatives(lambda there: there.weight(gravity))
    found = {f"{rep}_jacobian": as_array(robot.jacobian(rep, link)) for rep in ("body", "hybrid", "spatial")}
    for rep in ("body", "hybrid"):
        found[f"{rep}_joint_stiffness"] = robot.hessian_at(link, loaded(rep, here, F, K))
    return found | {
        "forward_kinematics": np.vstack([np.hstack([as_array(R), as_array(p)]), [0, 0, 0, 1]]),
        "hybrid_jacobian_transpose_derivative": np.stack([as_array(rate).T for rate in rates]),
        "gravity_gradient": gradient,
        "gravity_joint_stiffness": hessian,
        "mass_matrix": robot.tree.mass_matrix(robot.base, robot.q, robot.size),
        "bias_forces": robot.bias_forces(matrix(given["velocity"]), gravity),
    }
