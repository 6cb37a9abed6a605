# SPDX-License-Identifier: MIT
"""Return the value of any kernel of a robot with 60 digits, by its group and name; no kernel is left out silently."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mpmath
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import Kernel
from support.exact_kernels import (
    Energy,
    ExactRobot,
    Given,
    axial,
    connection,
    dot,
    loaded,
    matrix,
    symmetric,
)
from support.exact_linkage import ExactLinkage
from support.exact_tree import STEP, ExactTree, Pose, as_array, differentiated, exact_pose, exponential, mp

Values = list[np.ndarray]
SPRINGS = ("spring", "spring_rotation_vector", "spring_quaternion", "spring_coupled", "spring_bounded")


def _trace_form(E: mpmath.matrix, Ko: mpmath.matrix) -> mpmath.mpf:
    turned = ((Ko[0, 0] + Ko[1, 1] + Ko[2, 2]) / 2 * mp.eye(3) - Ko) * (mp.eye(3) - E)
    return turned[0, 0] + turned[1, 1] + turned[2, 2]


def _by_angle(E: mpmath.matrix, Ko: mpmath.matrix, factor: Callable[[mpmath.mpf], mpmath.mpf]) -> mpmath.mpf:
    sine = axial(E)
    angle = mp.acos((E[0, 0] + E[1, 1] + E[2, 2] - 1) / 2)
    return factor(angle) * dot(sine, Ko * sine) / dot(sine, sine)


def _softened(V: mpmath.mpf, K: mpmath.matrix, limit: Any) -> mpmath.mpf:
    largest = max(sum(abs(K[r, c]) for c in range(3)) for r in range(3))
    scale = mp.mpf(float(limit)) ** 2 / largest
    return scale * (mp.sqrt(1 + 2 * V / scale) - 1)


def spring_energy(name: str, given: Given) -> Energy:
    """Return the energy of one of stiffgen's springs, from its definition."""
    R0, p0 = exact_pose(given["equilibrium"])
    if name == "spring_coupled":
        K = symmetric(given["stiffness"])

        def coupled(pose: Pose) -> mpmath.mpf:
            E, away = R0.T * pose[0], R0.T * (pose[1] - p0)
            mixed = dot(away, K[:3, 3:] * axial(E))
            return dot(away, K[:3, :3] * away) / 2 + mixed + _trace_form(E, K[3:, 3:])

        return coupled
    Kt, Ko = symmetric(given["translation_stiffness"]), symmetric(given["rotation_stiffness"])
    factors: dict[str, Callable[[mpmath.mpf], mpmath.mpf]] = {
        "spring_rotation_vector": lambda angle: angle * angle / 2,
        "spring_quaternion": lambda angle: 4 * (1 - mp.cos(angle / 2)),
    }

    def turning(E: mpmath.matrix) -> mpmath.mpf:
        return _by_angle(E, Ko, factors[name]) if name in factors else _trace_form(E, Ko)

    def energy(pose: Pose) -> mpmath.mpf:
        away = pose[1] - p0
        linear, angular = dot(away, Kt * away) / 2, turning(R0.T * pose[0])
        if name == "spring_bounded":
            linear = _softened(linear, Kt, given["force_limit"])
            angular = _softened(angular, Ko, given["moment_limit"])
        return linear + angular

    return energy


def joint_energy(name: str, given: Given, q: list[Any]) -> mpmath.mpf:
    """Return the energy of the posture or of the limits."""
    values = {key: [mp.mpf(float(x)) for x in np.ravel(value)] for key, value in given.items()}
    if name == "posture":
        terms = zip(q, values["posture"], values["posture_stiffness"], strict=True)
        return sum((k * (x - r) ** 2 / 2 for x, r, k in terms), mp.mpf(0))
    (zone,), total = values["zone"], mp.mpf(0)
    for x, low, high, k in zip(q, values["lower"], values["upper"], values["limit_stiffness"], strict=True):
        total += k * (max(mp.mpf(0), x - high + zone) ** 3 + max(mp.mpf(0), low + zone - x) ** 3) / (6 * zone)
    return total


class References:
    """References of all kernels of a tree at one sample of its arguments."""

    def __init__(self, text: str, chain: Chain, given: Given) -> None:
        self.chain, self.given = chain, given
        self.robot = ExactRobot.of(text, chain, given)

    def of(self, kernel: Kernel) -> Values:
        """Return the results of a kernel; a kernel without a reference is an error."""
        tip = kernel.tip or self.chain.tips[0]
        name, group = kernel.name, kernel.group
        if name.endswith("_total"):
            return self._of_energy(name.removesuffix("_total"), self._total(str(group)))
        if group in REPRESENTATIONS:
            return [self._of_contact(name, str(group), tip.link)]
        if group in SPRINGS:
            return self._of_spring(name, str(group), tip.link)
        if group in ("posture", "limits"):
            base = self.robot.size - self.robot.tree.size
            return self._of_energy(name, lambda robot: joint_energy(str(group), self.given, robot.q), still=base)
        if group == "gravity":
            return self._of_energy(name, self._weight, positive=True)
        of_name: Callable[[str], np.ndarray] = getattr(self, f"_{name}")
        return [of_name(tip.link)]

    def _of_energy(
        self, name: str, energy: Callable[[ExactRobot], mpmath.mpf], *, positive: bool = False, still: int = 0
    ) -> Values:
        gradient, hessian = self.robot.derivatives(energy)
        of_name = {"energy": np.array(float(energy(self.robot))), "torque": -gradient, "joint_stiffness": hessian}
        of_name["gradient"] = gradient
        assert positive == (name == "gradient") or name in ("energy", "joint_stiffness"), name
        assert not np.any(hessian[:still])
        return [of_name[n] for n in (("energy", "torque", "joint_stiffness") if name == "linearization" else (name,))]

    def _of_spring(self, name: str, group: str, link: str) -> Values:
        energy = spring_energy(group, self.given)
        if name not in ("wrench", "task_stiffness"):
            return self._of_energy(name, lambda robot: energy(robot.pose(link)))
        R, p = self.robot.pose(link)

        def moved(x: list[Any]) -> mpmath.mpf:
            return energy((exponential(mp.matrix(x[3:])) * R, p + mp.matrix(x[:3])))

        return [differentiated(moved, 6)[name == "task_stiffness"]]

    def _total(self, group: str) -> Callable[[ExactRobot], mpmath.mpf]:
        plural = {"equilibria": "equilibrium", "translation_stiffnesses": "translation_stiffness"}
        plural |= {"rotation_stiffnesses": "rotation_stiffness", "stiffnesses": "stiffness"}
        plural |= {"force_limits": "force_limit", "moment_limits": "moment_limit"}
        energies = []
        for k, tip in enumerate(self.chain.tips):
            if group in SPRINGS:
                own = {plural[name]: values[k] for name, values in self.given.items() if name in plural}
                energies.append((tip.link, spring_energy(group, own)))
            else:
                F, K = matrix(self.given["wrenches"][k]), symmetric(self.given["task_stiffnesses"][k])
                energies.append((tip.link, loaded(group, self.robot.pose(tip.link), F, K)))
        return lambda robot: sum((energy(robot.pose(link)) for link, energy in energies), mp.mpf(0))

    def _of_contact(self, name: str, representation: str, link: str) -> np.ndarray:
        jacobian, robot = partial(ExactRobot.jacobian, representation=representation, link=link), self.robot
        if name == "jacobian":
            return as_array(jacobian(robot))
        if name == "connection_correction":
            return as_array(connection(representation, matrix(self.given["wrench"])))
        rates = [robot.along(jacobian, k) for k in range(robot.size)]
        if name == "jacobian_transpose_derivative":
            return np.stack([as_array(rate).T for rate in rates])
        F = matrix(self.given["wrench"])
        if name == "joint_stiffness":
            energy = loaded(representation, robot.pose(link), F, symmetric(self.given["task_stiffness"]))
            _, hessian = robot.derivatives(lambda there: energy(there.pose(link)))
            return hessian
        if name == "stiffness_direction_gradient":
            return self._direction_gradient(link, F)
        kinematic: np.ndarray = np.hstack([as_array(rate.T * F) for rate in rates])
        if name == "kinematic_stiffness":
            return kinematic
        assert name == "joint_stiffness_uncorrected", name
        J = jacobian(robot)
        conventional: np.ndarray = kinematic + as_array(J.T * matrix(self.given["task_stiffness"]) * J)
        return conventional

    def _direction_gradient(self, link: str, F: mpmath.matrix) -> np.ndarray:
        """Return the gradient of v^T Kq v; wrench and stiffness keep their entries in hybrid axes."""
        K, v = symmetric(self.given["task_stiffness"]), [mp.mpf(float(x)) for x in self.given["direction"]]

        def curvature(robot: ExactRobot) -> mpmath.matrix:
            energy = loaded("hybrid", robot.pose(link), F, K)
            up, middle, down = (energy(robot.moved([s * STEP * x for x in v]).pose(link)) for s in (1, 0, -1))
            return mp.matrix([(up - 2 * middle + down) / STEP**2])

        return np.array([float(self.robot.along(curvature, k)[0]) for k in range(self.robot.size)])

    def _forward_kinematics(self, link: str) -> np.ndarray:
        R, p = self.robot.pose(link)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = as_array(R), as_array(p).ravel()
        return pose

    def _measure(self, robot: ExactRobot, link: str) -> mpmath.matrix:
        J = robot.jacobian("body", link)
        own = sorted({joint.coordinate for joint in self.chain.joints[self.chain.base_joints :]})
        on_path = [k for k in own if any(J[row, k] for row in range(6))]
        columns = mp.matrix([[J[row, k] for k in on_path] for row in range(6)])
        square = columns * columns.T if len(on_path) >= 6 else columns.T * columns
        return mp.matrix([mp.sqrt(mp.det(square))])

    def _manipulability(self, link: str) -> np.ndarray:
        return np.array(float(self._measure(self.robot, link)[0]))

    def _manipulability_gradient(self, link: str) -> np.ndarray:
        measure = partial(self._measure, link=link)
        base = self.robot.size - self.robot.tree.size
        return np.array([float(self.robot.along(measure, k)[0]) for k in range(base, self.robot.size)])

    def _weight(self, robot: ExactRobot) -> mpmath.mpf:
        poses = robot.tree.poses(robot.base, robot.q)
        still = () if self.chain.floating else tuple(_still(robot.tree))
        return robot.tree.potential_energy(poses, matrix(self.given["gravity"]), still)

    def _mass_matrix(self, _: str) -> np.ndarray:
        return self.robot.tree.mass_matrix(self.robot.base, self.robot.q, self.robot.size)

    def _bias_forces(self, _: str) -> np.ndarray:
        return self.robot.bias_forces(matrix(self.given["velocity"]), matrix(self.given["gravity"]))

    def _static_torque_derivatives(self, _: str) -> np.ndarray:
        given = self.given["wrenches"] if len(self.chain.tips) > 1 else self.given["wrench"][None]
        wrenches = {tip.link: matrix(each) for tip, each in zip(self.chain.tips, given, strict=True)}

        def torque(robot: ExactRobot) -> mpmath.matrix:
            total = mp.zeros(robot.size, 1)
            for k in range(robot.size):
                total[k] = difference_of(self._weight, robot, k)
            for link, wrench in wrenches.items():
                total -= robot.jacobian("hybrid", link).T * wrench
            return total

        return np.hstack([as_array(self.robot.along(torque, k)) for k in range(self.robot.size)])


def _still(tree: ExactTree) -> set[str]:
    """Return the root and the links that are fixed to it."""
    found = {tree.root}
    for joint in tree.joints:
        if joint.axis is None and joint.parent in found:
            found.add(joint.child)
    return found


def difference_of(energy: Callable[[ExactRobot], mpmath.mpf], robot: ExactRobot, k: int) -> mpmath.mpf:
    """Return the derivative of an energy with respect to coordinate k."""
    return (energy(robot.moved(robot.unit(k, STEP))) - energy(robot.moved(robot.unit(k, -STEP)))) / (2 * STEP)


class MotorReferences:
    """References of the kernels in motor coordinates at a closed configuration."""

    def __init__(self, exact: ExactLinkage, chain: Chain, given: Given) -> None:
        self.exact, self.chain, self.given = exact, chain, given

    def of(self, kernel: Kernel) -> Values:
        """Return the results of a kernel of the group ``motors``."""
        name, link = kernel.name, (kernel.tip or self.chain.tips[0]).link
        if name in ("torque", "joint_stiffness"):
            F = matrix(self.given["wrench"])
            K = symmetric(self.given.get("task_stiffness", np.zeros((6, 6))))
            here = self.exact.tree.poses(self.exact.base, self.exact.q)[link]
            return self._of_tip(name, link, loaded("hybrid", here, F, K))
        for group in SPRINGS[::-1]:
            if name.startswith(f"{group}_"):
                return self._of_tip(name.removeprefix(f"{group}_"), link, spring_energy(group, self.given))
        for group in ("posture", "limits"):
            if name.startswith(f"{group}_"):
                return self._of_joints(name.removeprefix(f"{group}_"), group)
        if name.startswith("gravity_"):
            weight, tree = matrix(self.given["gravity"]), self.exact.tree
            falling = self.exact.of_motors(lambda poses: tree.potential_energy(poses, weight))
            return self._parts(name.removeprefix("gravity_"), falling)
        of_name: Callable[[], Values] = getattr(self, f"_{name}")
        return of_name()

    def _of_tip(self, name: str, link: str, energy: Energy) -> Values:
        return self._parts(name, self.exact.of_motors(lambda poses: energy(poses[link])))

    def _of_joints(self, name: str, group: str) -> Values:
        return self._parts(name, lambda x: joint_energy(group, self.given, self._closed(x)))

    def _parts(self, name: str, energy: Callable[[list[Any]], mpmath.mpf]) -> Values:
        gradient, hessian = differentiated(energy, len(self.chain.actuated))
        return [{"torque": -gradient, "gradient": gradient, "joint_stiffness": hessian}[name]]

    def _closed(self, x: list[Any]) -> list[Any]:
        return self.exact.closed([self.exact.q[k] + d for k, d in zip(self.exact.motors, x, strict=True)])

    def _jacobian(self) -> Values:
        columns = []
        for k in range(len(self.chain.actuated)):
            ends = [self._closed([s * STEP * (i == k) for i in range(len(self.chain.actuated))]) for s in (1, -1)]
            columns.append([float((a - b) / (2 * STEP)) for a, b in zip(*ends, strict=True)])
        return [np.array(columns).T]

    def _from_joints(self) -> Values:
        g, H = matrix(self.given["gradient"]), symmetric(self.given["hessian"])

        def energy(x: list[Any]) -> mpmath.mpf:
            away = mp.matrix([a - b for a, b in zip(self._closed(x), self.exact.q, strict=True)])
            return dot(g, away) + dot(away, H * away) / 2

        return [*differentiated(energy, len(self.chain.actuated))]

    def _rows(self, q: list[Any]) -> mpmath.matrix:
        """Return the equations c(q) that the chain keeps of each loop, in the axes of the link that its ends share."""
        gaps, poses, found = self.exact.gaps(q), self.exact.tree.poses(self.exact.base, q), []
        for k, (loop, ((one, _), (other, _))) in enumerate(zip(self.chain.loops, self.exact.loops, strict=True)):
            shared = next(link for link in self._up(one) if link in self._up(other))
            own = poses[shared][0].T * gaps[3 * k : 3 * k + 3]
            found += [own[row] for row in loop.rows]
        return mp.matrix(found)

    def _up(self, link: str) -> list[str]:
        """Return a link and its parents, the root last."""
        parent_of = {joint.child: joint.parent for joint in self.exact.tree.joints}
        return [link, *(self._up(parent_of[link]) if link in parent_of else [])]

    def _residual(self) -> Values:
        return [as_array(self._rows([mp.mpf(float(x)) for x in self.given["q"]])).ravel()]

    def _multipliers(self) -> Values:
        columns = []
        for k in self.exact.passive:
            ends = [[x + s * STEP * (i == k) for i, x in enumerate(self.exact.q)] for s in (1, -1)]
            up, down = map(self._rows, ends)
            columns.append([(a - b) / (2 * STEP) for a, b in zip(up, down, strict=True)])
        right = mp.matrix([mp.mpf(float(self.given["gradient"][k])) for k in self.exact.passive])
        return [as_array(mp.lu_solve(mp.matrix(columns), right)).ravel()]

    def _mass_matrix(self) -> Values:
        return [self.exact.kinetic([mp.mpf(0)] * len(self.chain.actuated))[0]]

    def _bias_forces(self) -> Values:
        rates = [mp.mpf(float(x)) for x in self.given["motor_velocity"]]
        weight, tree = matrix(self.given["gravity"]), self.exact.tree
        falling = self.exact.of_motors(lambda poses: tree.potential_energy(poses, weight))
        return [self.exact.kinetic(rates)[1] + differentiated(falling, len(rates))[0]]
