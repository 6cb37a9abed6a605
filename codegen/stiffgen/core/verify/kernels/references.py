# SPDX-License-Identifier: MIT
"""Reference values of kernels at random states, computed from the chain's joint poses alone.

* pose: a plain product of 4x4 matrices with Rodrigues' formula;
* Jacobians: CasADi's derivative of that pose, J = vee(H^-1 dH) and its relatives;
* dJ^T/dq: CasADi's derivative of those Jacobians; the kinematic stiffness is its contraction;
* Gamma F: the matrix forms in cross-product matrices, written down;
* joint stiffness: the paper's formula put together from the above; and the joint Hessian of a potential
  U(p, R) along the pose, which it must equal for F = dU and K = the covariant Hessian;
* mass matrix, bias forces and gravity: derivatives of kinetic and potential energy
  (:mod:`stiffgen.families.dynamics.reference`).

All are evaluated in the longest numbers of the machine (80 bits on x86-64): where contributions cancel, the reference
must be better than the function.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import BASE_POSE, GRAVITY, TOOL_POSE, VELOCITY, Q, configuration_arguments
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.model import folded
from stiffgen.core.symbolic.stiffness_kernels import DIRECTION
from stiffgen.core.verify.kernels.poses import (
    MovedConfiguration,
    gamma_F,
    homogeneous,
    jacobian_of,
    joint_poses,
    product_of_poses,
)
from stiffgen.core.verify.kernels.rounding import evaluate_longer
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.families.dynamics.reference import differentiated as differentiated_energies
from stiffgen.families.dynamics.reference import potential_energy
from stiffgen.families.joints.kernels import JointPotential
from stiffgen.families.manipulability.reference import Manipulability
from stiffgen.families.sensor.reference import expressions
from stiffgen.families.springs.potentials import KernelOptions
from stiffgen.families.springs.reference import by_hand, differentiated
from stiffgen.families.springs.springs import Spring

WRENCH = arguments.wrench("hybrid")
TASK_STIFFNESS = arguments.task_stiffness("hybrid", triangle=True)
GENERAL_STIFFNESS = arguments.task_stiffness("hybrid", triangle=False)


class References:
    """Reference values of a robot's kernels at random samples, or of the kernels of one tip: the branch to the tip.

    Each is computed when it is first asked for; all are stacks, one value per sample.

    Args:
        chain: the robot, or the branch to one of its tips.
        count: number of samples.
        seed: of the random generator.
        options: springs beyond the default one.
        samples: the samples, in place of random ones.

    """

    def __init__(
        self, chain: Chain, count: int, seed: int, options: KernelOptions | None = None, samples: Samples | None = None
    ) -> None:
        self.chain, self.seed = chain, seed
        self.options = options or KernelOptions()
        self.samples = samples or Samples(chain, count, seed)
        self._place, self._tool = MovedConfiguration(chain), ca.SX.sym("T", 16)

    @cached_property
    def tips(self) -> tuple[References, ...]:
        """References of each tip."""
        if len(self.chain.tips) == 1:
            return (self,)
        count, seed = self.samples.count, self.seed
        return tuple(
            References(self.chain.branch(tip), count, seed + k, self.options, self.samples.of_tip(k))
            for k, tip in enumerate(self.chain.tips)
        )

    def posture_of(self, representation: Representation) -> tuple[FloatArray, ...]:
        """Return q, and the poses of base and tool where the representation's kernels take them (body: no base)."""
        based = self.chain.floating and representation != "body"
        return self.samples.of(configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=based))

    @property
    def _mounted(self) -> ca.SX:
        """Pose of the tool in the tip's frame."""
        return self._tool.reshape((4, 4)).T if self.chain.runtime_tool else ca.SX.eye(4)

    @cached_property
    def _pose(self) -> ca.SX:
        """Pose of the tip as an expression of the configuration."""
        return product_of_poses(self.chain, self._place.q, self._place.base()) @ self._mounted

    @cached_property
    def pose(self) -> FloatArray:
        """Pose of the tip."""
        return self._evaluate(self._pose)

    @cached_property
    def _jacobians(self) -> dict[str, ca.SX]:
        """Jacobian in each representation, as an expression of the configuration."""
        moves = ca.SX.sym("s", self.chain.base_joints)  # rates of the coordinates, at the base's present pose
        moved = product_of_poses(self.chain, self._place.q, self._place.base(moves)) @ self._mounted
        at_rest = ca.DM.zeros(self.chain.base_joints)
        variables = ca.vertcat(moves, self._place.q)
        return {rep: ca.substitute(jacobian_of(moved, variables, rep), moves, at_rest) for rep in REPRESENTATIONS}

    @cached_property
    def jacobian(self) -> dict[str, FloatArray]:
        """Jacobian in each representation."""
        return {rep: self._evaluate(jacobian) for rep, jacobian in self._jacobians.items()}

    @cached_property
    def derivative(self) -> dict[str, FloatArray]:
        """Derivative dJ^T/dq in each representation."""
        derivatives, n = {}, self.chain.dof
        for rep, jacobian in self._jacobians.items():
            # vec() stacks columns: row b*6 + k of the derivative is J[k, b].
            derivative = self._evaluate(ca.jacobian(ca.vec(jacobian), self._place.coordinates))
            # The derivative with respect to a single joint is zero; differentiation leaves only rounding.
            rounding = 64 * np.finfo(float).eps * np.abs(self.jacobian[rep]).max(axis=(1, 2))
            derivative[np.abs(derivative).max(axis=(1, 2)) <= rounding] = 0.0
            derivatives[rep] = derivative.reshape(-1, n, 6, n).transpose(0, 3, 1, 2)
        return derivatives

    def _evaluate(
        self, expression: ca.SX, symbols: Sequence[ca.SX] = (), columns: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """Return the values of an expression of the configuration and further symbols, in the longest numbers."""
        place = self._place
        there = ca.substitute(expression, place.moves, ca.DM.zeros(place.moves.shape[0]))
        of_place = [_as_columns(each) for each in self.samples.of((Q, BASE_POSE, TOOL_POSE))]
        return evaluate_longer([place.q, place.base_pose, self._tool, *symbols], there, [*of_place, *columns])

    @cached_property
    def springs(self) -> dict[str, dict[str, FloatArray]]:
        """Results of each spring's kernels by name, from its differentiated energy."""
        return {spring.name: self._spring(spring) for spring in self.options.all_springs()}

    def _spring(self, spring: Spring) -> dict[str, FloatArray]:
        """Return the results of a spring's kernels."""
        symbols = [ca.SX.sym(a.name, *folded(a.array(self.chain).shape)) for a in spring.parameters]
        # Stacks enter as columns, a matrix row by row.
        rows = [ca.vec(symbol.T) for symbol in symbols]
        columns = [_as_columns(each) for each in self.samples.of(spring.parameters)]
        q, placement = self._place.coordinates, self.options.placement
        results = differentiated(spring, placement, self._pose, q, symbols)
        return {name: self._evaluate(expression, rows, columns) for name, expression in results.items()}

    @cached_property
    def potential(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Wrench F = dU, covariant Hessian K, joint Hessian of a potential of position and orientation."""
        random = np.random.default_rng(self.seed + 1)
        pose = self._pose
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
        joint_hessian, _ = ca.hessian(potential(position, rotation), self._place.coordinates)
        return self._evaluate(wrench)[..., 0], self._evaluate(covariant), self._evaluate(joint_hessian)

    @cached_property
    def direction_gradient(self) -> FloatArray:
        """Gradient of v^T Kq v along the drawn directions."""
        return gradient_along(self, self.samples[DIRECTION], self.samples[TASK_STIFFNESS])

    @cached_property
    def manipulability(self) -> Manipulability:
        """Measure and gradient from the singular values of the columns of the joints on the way to the tip."""
        on_the_way = self.chain.without_side_joints().joints[self.chain.base_joints :]
        columns = sorted({joint.coordinate for joint in on_the_way})
        rates = self.derivative["body"][:, self.chain.base_joints :, columns].transpose(0, 1, 3, 2)
        return Manipulability.of(self.jacobian["body"][:, :, columns], rates)

    @cached_property
    def sensor(self) -> dict[str, FloatArray]:
        """Wrenches and readings of a force-torque sensor, by the kernel's name."""
        poses = joint_poses(self.chain, self._place.q, self._place.base())
        of_sensor = expressions(self.chain, self._place, poses[self.chain.tips[0].joint], self._pose)
        return {
            name: self._evaluate(value, symbols, [_as_columns(each) for each in self.samples.of(arguments)])[..., 0]
            for name, (value, symbols, arguments) in of_sensor.items()
        }

    def kinematic_stiffness(self, representation: Representation, wrench: FloatArray | None = None) -> FloatArray:
        """Return the kinematic stiffness: column i is dJ^T/dq_i F."""
        load = self.samples[WRENCH] if wrench is None else wrench
        contracted: FloatArray = np.einsum("sibk,sk->sbi", self.derivative[representation], load)
        return contracted

    def joint_stiffness(
        self, representation: Representation, *, corrected: bool, wrench: FloatArray | None = None
    ) -> FloatArray:
        """Return the joint stiffness by the formula, term by term; of another ``wrench`` than the samples'."""
        J, transposed = self.jacobian[representation], np.swapaxes(self.jacobian[representation], 1, 2)
        if corrected:
            load = load_stiffness(self, representation, wrench)
            return load + transposed @ self.samples[TASK_STIFFNESS] @ J
        return self.kinematic_stiffness(representation, wrench) + transposed @ self.samples[GENERAL_STIFFNESS] @ J

    @cached_property
    def dynamics(self) -> dict[str, FloatArray]:
        """Mass matrix, bias forces and gravity by kernel, from the energies of the whole tree."""
        place, samples = self._place, self.samples
        poses = joint_poses(self.chain, place.q, place.base())
        stacks = samples[Q], samples[BASE_POSE].reshape(-1, 16), samples[VELOCITY], samples[GRAVITY]
        return differentiated_energies(self.chain, poses, place.moves, place.q, place.base_pose, stacks)

    @cached_property
    def static_torque_derivatives(self) -> FloatArray:
        """Derivative of dU/dq - J^T F: J from differentiated poses, and the base moved twice."""
        chain, place, moves = self.chain, self._place, ca.SX.sym("s", self.chain.base_joints)
        gravity, count = ca.SX.sym("g", 3), len(chain.tips)
        wrenches, tools = (ca.SX.sym(name, size, count) for name, size in (("F", 6), ("T", 16)))
        poses, coordinates = joint_poses(chain, place.q, place.base(moves)), ca.vertcat(moves, place.q)
        torque = ca.gradient(potential_energy(chain, poses, gravity), coordinates)
        for k, tip in enumerate(chain.tips):
            mounted = tools[:, k].reshape((4, 4)).T if chain.runtime_tool else ca.SX.eye(4)
            pose = poses[tip.joint] @ homogeneous(tip.rotation, tip.translation) @ mounted
            torque -= jacobian_of(pose, coordinates, "hybrid").T @ wrenches[:, k]
        at_rest = ca.DM.zeros(chain.base_joints)
        derivative = ca.jacobian(ca.substitute(torque, moves, at_rest), place.coordinates)
        of_tips = (np.stack([tip.samples[each] for tip in self.tips], axis=1) for each in (WRENCH, TOOL_POSE))
        stacks = *self.samples.of((Q, BASE_POSE)), *of_tips, self.samples[GRAVITY]
        symbols = [place.q, place.base_pose, ca.vec(wrenches), ca.vec(tools), gravity]
        there = ca.substitute(derivative, place.moves, at_rest)
        return evaluate_longer(symbols, there, [_as_columns(stack) for stack in stacks])


def load_stiffness(r: References, representation: Representation, wrench: FloatArray | None = None) -> FloatArray:
    """Return the joint stiffness without task stiffness: that of the wrench alone."""
    J, load = r.jacobian[representation], r.samples[WRENCH] if wrench is None else wrench
    matrix = gamma_F(representation, load)
    stiffness: FloatArray = r.kinematic_stiffness(representation, load) + np.swapaxes(J, 1, 2) @ matrix @ J
    if r.chain.floating:
        on_base = np.einsum("ski,sk->si", J[:, :, :6], load)
        stiffness[:, :6, :6] -= gamma_F("body", on_base)
    return stiffness


def gradient_along(r: References, directions: FloatArray, task_stiffness: FloatArray) -> FloatArray:
    """Return the gradients of v^T Kq v from the terms of Kq, each differentiated along v.

    A floating base moves three times: ``then`` for the Jacobian, ``first`` for its derivative along v, and the place's
    own motion for the gradient. The first two are zero afterwards.
    """
    place, base_joints, size = r._place, r.chain.base_joints, r.chain.dof
    first, then = (ca.SX.sym(name, base_joints) for name in ("s", "t"))
    v, F, K = ca.SX.sym("v", size), ca.SX.sym("F", 6), ca.SX.sym("K", 36)
    pose = product_of_poses(r.chain, place.q, place.base(first, then)) @ r._mounted
    jacobian = jacobian_of(pose, ca.vertcat(then, place.q), "hybrid")
    jacobian = ca.substitute(jacobian, then, ca.DM.zeros(base_joints))
    torque, twist = jacobian.T @ F, jacobian @ v
    connection = ca.diagcat(ca.SX(3, 3), -ca.skew(F[3:]) / 2)  # Gamma F, hybrid
    form = ca.jtimes(ca.dot(torque, v), ca.vertcat(first, place.q), v)
    form += twist.T @ (K.reshape((6, 6)) + connection) @ twist
    if base_joints:  # connection of the base's twist
        w, f = v[3:6], torque[:3]
        form -= ca.dot(v[:3], ca.cross(f, w)) + ca.dot(w, ca.cross(torque[3:6], w)) / 2
    form = ca.substitute(form, first, ca.DM.zeros(base_joints))
    stiffness = np.broadcast_to(task_stiffness, (len(directions), 6, 6))
    columns = [_as_columns(each) for each in (directions, r.samples[WRENCH], stiffness)]
    return r._evaluate(ca.gradient(form, place.coordinates), [v, F, K], columns)[..., 0]


def of_joint_potential(r: References, potential: JointPotential) -> dict[str, FloatArray]:
    """Return the results of a joint potential's kernels; entries of a floating base are zero."""
    base_joints = r.chain.base_joints
    by_joints = by_hand(potential.name, *r.samples.of((Q, *potential.parameters)))
    return {name: np.pad(each, [(0, 0), *(each.ndim - 1) * [(base_joints, 0)]]) for name, each in by_joints.items()}


def _as_columns(stack: FloatArray) -> FloatArray:
    """Return a stack (states, ...) as (row-major entries, states)."""
    return stack.reshape(len(stack), -1).T
