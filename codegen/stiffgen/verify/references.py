# SPDX-License-Identifier: MIT
"""Reference values of kernels at random states, computed from the chain's joint poses alone.

* pose: a plain product of 4x4 matrices with Rodrigues' formula;
* Jacobians: CasADi's derivative of that pose, J = vee(H^-1 dH) and its relatives;
* dJ^T/dq: CasADi's derivative of those Jacobians; the kinematic stiffness is its contraction;
* Gamma F: the matrix forms in cross-product matrices, written down;
* joint stiffness: the paper's formula put together from the above; and the joint Hessian of a potential
  U(p, R) along the pose, which it must equal for F = dU and K = the covariant Hessian;
* mass matrix, bias forces and gravity: derivatives of kinetic and potential energy (:mod:`stiffgen.verify.dynamics`).

All are evaluated in the longest numbers of the machine (80 bits on x86-64): where contributions cancel, the reference
must be better than the function.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from stiffgen.robot.chain import Chain
from stiffgen.robot.geometry import FloatArray
from stiffgen.symbolic import arguments
from stiffgen.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.model import folded
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.springs import Spring
from stiffgen.verify.dynamics import differentiated as differentiated_energies
from stiffgen.verify.dynamics import potential_energy
from stiffgen.verify.manipulability import Manipulability
from stiffgen.verify.poses import (
    MovedConfiguration,
    gamma_F,
    homogeneous,
    jacobian_of,
    joint_poses,
    product_of_poses,
)
from stiffgen.verify.rounding import evaluate_longer, in_form_of
from stiffgen.verify.samples import Samples
from stiffgen.verify.springs import differentiated


class References:
    """Reference values of the kernels of one tip at random samples.

    Args:
        chain: the robot, or the branch to one of its tips.
        count: number of samples.
        seed: of the random generator.
        at: where joint positions and base poses are taken from instead of random ones.
        options: springs beyond the default one.

    """

    def __init__(
        self, chain: Chain, count: int, seed: int, at: Samples | None = None, options: SpringOptions | None = None
    ) -> None:
        self.chain = chain
        self.options = options or SpringOptions()
        self.samples = Samples.draw(chain, count, seed)
        if at is not None:
            self.samples = replace(self.samples, q=at.q, base_pose=at.base_pose)
        place, tool = MovedConfiguration(chain), ca.SX.sym("T", 16)
        self._symbols, self._moves, symbol = (place.q, place.base_pose, tool), place.moves, place.coordinates
        mounted = tool.reshape((4, 4)).T if chain.runtime_tool else ca.SX.eye(4)
        pose = product_of_poses(chain, place.q, place.base()) @ mounted
        self.pose = self._evaluate(pose)
        # Rates of the coordinates, at the base's present pose.
        moves = ca.SX.sym("s", chain.base_joints)
        moved = product_of_poses(chain, place.q, place.base(moves)) @ mounted
        self.jacobian: dict[str, FloatArray] = {}
        self.derivative: dict[str, FloatArray] = {}
        for representation in REPRESENTATIONS:
            jacobian = jacobian_of(moved, ca.vertcat(moves, place.q), representation)
            jacobian = ca.substitute(jacobian, moves, ca.DM.zeros(chain.base_joints))
            self.jacobian[representation] = self._evaluate(jacobian)
            # vec() stacks columns: row b*6 + k of the derivative is J[k, b].
            derivative = self._evaluate(ca.jacobian(ca.vec(jacobian), symbol))
            n = chain.dof
            # The derivative with respect to a single joint is zero; differentiation leaves only rounding.
            rounding = 64 * np.finfo(float).eps * np.abs(self.jacobian[representation]).max(axis=(1, 2))
            derivative[np.abs(derivative).max(axis=(1, 2)) <= rounding] = 0.0
            self.derivative[representation] = derivative.reshape(count, n, 6, n).transpose(0, 3, 1, 2)
        self.potential = self._potential(symbol, pose, seed)
        self.direction_gradient = self._direction_gradient(place, mounted)
        self.parameters: dict[str, list[FloatArray]] = {}
        self.springs = {spring.name: self._spring(spring, symbol, pose, seed) for spring in self.options.springs()}

    @property
    def posture(self) -> tuple[FloatArray, ...]:
        """Configuration arguments: q, and the poses of base and tool where they are arguments."""
        given = arguments.configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=self.chain.floating)
        return tuple(self.samples[argument.name] for argument in given)

    def posture_of(self, representation: Representation) -> tuple[FloatArray, ...]:
        """Return the configuration arguments of a representation's kernels; body ones do not take the base's pose."""
        based = self.chain.floating and representation != "body"
        given = arguments.configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=based)
        return tuple(self.samples[argument.name] for argument in given)

    @property
    def _columns(self) -> list[FloatArray]:
        """Return the stacks of arguments of the expressions, as columns."""
        samples = self.samples
        return [each.reshape(len(each), -1).T for each in (samples.q, samples.base_pose, samples.tool_pose)]

    def _evaluate(
        self, expression: ca.SX, symbols: Sequence[ca.SX] = (), columns: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """Return the values of an expression of the configuration and further symbols, in the longest numbers."""
        there = ca.substitute(expression, self._moves, ca.DM.zeros(self._moves.shape[0]))
        return evaluate_longer([*self._symbols, *symbols], there, [*self._columns, *columns])

    def _spring(self, spring: Spring, q: ca.SX, pose: ca.SX, seed: int) -> dict[str, FloatArray]:
        """Return the results of a spring's kernels by name, from its differentiated energy."""
        count = len(self.samples.q)
        symbols = [ca.SX.sym(a.name, *folded(a.array(self.chain).shape)) for a in spring.parameters]
        stacks = self.parameters[spring.name] = [
            self.samples.of(argument, seed + k) for k, argument in enumerate(spring.parameters)
        ]
        # Stacks enter as columns, a matrix row by row.
        given = [ca.vec(symbol.T) for symbol in symbols]
        columns = [each.reshape(count, -1).T for each in stacks]
        results = {}
        for name, expression in differentiated(spring, self.options.placement, pose, q, symbols).items():
            values = self._evaluate(expression, given, columns)
            results[name] = in_form_of(name, values)
        return results

    def _potential(self, q: ca.SX, pose: ca.SX, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (F = dU, covariant Hessian K, joint Hessian) of a potential of position and orientation."""
        random = np.random.default_rng(seed + 1)
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
        joint_hessian, _ = ca.hessian(potential(position, rotation), q)
        return self._evaluate(wrench)[..., 0], self._evaluate(covariant), self._evaluate(joint_hessian)

    def _direction_gradient(self, place: MovedConfiguration, mounted: ca.SX) -> FloatArray:
        """Return the gradient of v^T Kq v from the terms of Kq, each differentiated along v."""
        own, size = self.chain.base_joints, self.chain.dof
        first, then = (ca.SX.sym(name, own) for name in ("s", "t"))
        v, F, K = ca.SX.sym("v", size), ca.SX.sym("F", 6), ca.SX.sym("K", 36)
        pose = product_of_poses(self.chain, place.q, place.base(first, then)) @ mounted
        jacobian = jacobian_of(pose, ca.vertcat(then, place.q), "hybrid")
        jacobian = ca.substitute(jacobian, then, ca.DM.zeros(own))
        torque, twist = jacobian.T @ F, jacobian @ v
        half = ca.diagcat(ca.SX(3, 3), -ca.skew(F[3:]) / 2)
        form = ca.jtimes(ca.dot(torque, v), ca.vertcat(first, place.q), v)
        form += twist.T @ (K.reshape((6, 6)) + half) @ twist
        if own:
            w, f = v[3:6], torque[:3]
            form -= ca.dot(v[:3], ca.cross(f, w)) + ca.dot(w, ca.cross(torque[3:6], w)) / 2
        form = ca.substitute(form, first, ca.DM.zeros(own))
        columns = [self.samples.direction, self.samples.wrench, self.samples.task_stiffness.reshape(-1, 36)]
        gradient = ca.gradient(form, place.coordinates)
        return self._evaluate(gradient, [v, F, K], [each.T for each in columns])[..., 0]

    @property
    def manipulability(self) -> Manipulability:
        """Measure and gradient from the singular values of the columns of the joints on the way to the tip."""
        on_the_way = self.chain.without_side_joints().joints[self.chain.base_joints :]
        own = sorted({joint.coordinate for joint in on_the_way})
        rates = self.derivative["body"][:, self.chain.base_joints :, own].transpose(0, 1, 3, 2)
        return Manipulability.of(self.jacobian["body"][:, :, own], rates)

    def kinematic_stiffness(self, representation: Representation) -> FloatArray:
        """Return the kinematic stiffness: column i is dJ^T/dq_i F."""
        contracted: FloatArray = np.einsum("sibk,sk->sbi", self.derivative[representation], self.samples.wrench)
        return contracted

    def joint_stiffness(self, representation: Representation, *, corrected: bool) -> FloatArray:
        """Return the joint stiffness by the formula, term by term."""
        J = self.jacobian[representation]
        if corrected:
            matrix = self.samples.task_stiffness + gamma_F(representation, self.samples.wrench)
        else:
            matrix = self.samples.general_stiffness
        stiffness: FloatArray = self.kinematic_stiffness(representation) + np.swapaxes(J, 1, 2) @ matrix @ J
        if corrected and self.chain.floating:
            on_base = np.einsum("ski,sk->si", J[:, :, :6], self.samples.wrench)
            stiffness[:, :6, :6] -= gamma_F("body", on_base)
        return stiffness


def dynamics_references(chain: Chain, samples: Samples) -> dict[str, tuple[tuple[FloatArray, ...], FloatArray]]:
    """Return arguments and reference values of the kernels of the whole tree's masses, by qualified name."""
    if not chain.masses:
        return {}
    place = MovedConfiguration(chain)
    stacks = samples.q, samples.base_pose.reshape(-1, 16), samples.velocity, samples.gravity
    poses = joint_poses(chain, place.q, place.base())
    expected = differentiated_energies(chain, poses, place.moves, place.q, place.base_pose, stacks)
    table = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    expected["static_torque_derivatives"] = _static_torque_derivatives(chain, samples)
    given = {name: tuple(map(samples.per_tip, table[name].arguments)) for name in expected}
    return {name: (given[name], reference) for name, reference in expected.items()}


def _static_torque_derivatives(chain: Chain, samples: Samples) -> FloatArray:
    """Return the derivative of dU/dq - J^T F: J from differentiated poses, and the base moved twice."""
    place, moves = MovedConfiguration(chain), ca.SX.sym("s", chain.base_joints)
    gravity, count = ca.SX.sym("g", 3), len(chain.tips)
    wrenches, tools = (ca.SX.sym(name, size, count) for name, size in (("F", 6), ("T", 16)))
    poses, coordinates = joint_poses(chain, place.q, place.base(moves)), ca.vertcat(moves, place.q)
    torque = ca.gradient(potential_energy(chain, poses, gravity), coordinates)
    for k, tip in enumerate(chain.tips):
        mounted = tools[:, k].reshape((4, 4)).T if chain.runtime_tool else ca.SX.eye(4)
        pose = poses[tip.joint] @ homogeneous(tip.rotation, tip.translation) @ mounted
        torque -= jacobian_of(pose, coordinates, "hybrid").T @ wrenches[:, k]
    torque = ca.substitute(torque, moves, ca.DM.zeros(chain.base_joints))
    derivative = ca.substitute(
        ca.jacobian(torque, place.coordinates), place.moves, ca.DM.zeros(chain.base_joints)
    )  # fmt: skip
    stacks = samples.q, samples.base_pose, *(samples.of_tips(each) for each in ("wrench", "tool_pose")), samples.gravity
    columns = [stack.reshape(len(stack), -1).T for stack in stacks]
    symbols = [place.q, place.base_pose, ca.vec(wrenches), ca.vec(tools), gravity]
    return evaluate_longer(symbols, derivative, columns)
