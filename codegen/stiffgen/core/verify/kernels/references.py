# SPDX-License-Identifier: MIT
"""Reference values of kernels at random states, computed from the chain's joint poses alone.

* pose: a plain product of 4x4 matrices with Rodrigues' formula;
* Jacobians: CasADi's derivative of that pose, J = vee(H^-1 dH) and its relatives;
* dJ^T/dq: CasADi's derivative of those Jacobians; the kinematic stiffness is its contraction;
* Gamma F: the matrix forms in cross-product matrices, written down;
* joint stiffness: the paper's formula put together from the above; and the joint Hessian of a potential
  U(p, R) along the pose, which it must equal for F = dU and K = the covariant Hessian;
* mass matrix, bias forces and gravity: derivatives of kinetic and potential energy
  (:mod:`stiffgen.families.dynamics.reference`). Families derive their references by :meth:`References.of`.

All are evaluated in the longest numbers of the machine (80 bits on x86-64): where contributions cancel, the reference
must be better than the function.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import BASE_POSE, TOOL_POSE, Q, configuration_arguments
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.verify.kernels.poses import MovedConfiguration, gamma_F, jacobian_of, product_of_poses
from stiffgen.core.verify.kernels.rounding import evaluate_longer
from stiffgen.core.verify.kernels.samples import Samples, symmetric

Derived = TypeVar("Derived")
WRENCH = arguments.wrench("hybrid")
TASK_STIFFNESS = arguments.task_stiffness("hybrid", symmetric_part=True)
GENERAL_STIFFNESS = arguments.task_stiffness("hybrid", symmetric_part=False)


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
        self._derived: dict[Callable[[References], Any], Any] = {}
        self.place, self._tool = MovedConfiguration(chain), ca.SX.sym("T", 16)

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

    def of(self, derive: Callable[[References], Derived]) -> Derived:
        """Return the result of a family's function of these references, computed once."""
        if derive not in self._derived:
            self._derived[derive] = derive(self)
        result: Derived = self._derived[derive]
        return result

    def posture_of(self, representation: Representation) -> tuple[FloatArray, ...]:
        """Return q, and the poses of base and tool where the representation's kernels take them (body: no base)."""
        based = self.chain.floating and representation != "body"
        return self.samples.of(configuration_arguments(runtime_tool=self.chain.runtime_tool, floating=based))

    @property
    def mounted(self) -> ca.SX:
        """Pose of the tool in the tip's frame."""
        return self._tool.reshape((4, 4)).T if self.chain.runtime_tool else ca.SX.eye(4)

    @cached_property
    def pose_expression(self) -> ca.SX:
        """Pose of the tip as an expression of the configuration."""
        return product_of_poses(self.chain, self.place.q, self.place.base()) @ self.mounted

    @cached_property
    def pose(self) -> FloatArray:
        """Pose of the tip."""
        return self.evaluate(self.pose_expression)

    @cached_property
    def jacobian_expressions(self) -> dict[str, ca.SX]:
        """Jacobian in each representation, as an expression of the configuration."""
        moves = ca.SX.sym("s", self.chain.base_joints)  # rates of the coordinates, at the base's present pose
        moved = product_of_poses(self.chain, self.place.q, self.place.base(moves)) @ self.mounted
        at_rest = ca.DM.zeros(self.chain.base_joints)
        variables = ca.vertcat(moves, self.place.q)
        return {rep: ca.substitute(jacobian_of(moved, variables, rep), moves, at_rest) for rep in REPRESENTATIONS}

    @cached_property
    def jacobian(self) -> dict[str, FloatArray]:
        """Jacobian in each representation."""
        return {rep: self.evaluate(jacobian) for rep, jacobian in self.jacobian_expressions.items()}

    @cached_property
    def derivative(self) -> dict[str, FloatArray]:
        """Derivative dJ^T/dq in each representation."""
        derivatives, n = {}, self.chain.dof
        for rep, jacobian in self.jacobian_expressions.items():
            # vec() stacks columns: row b*6 + k of the derivative is J[k, b].
            derivative = self.evaluate(ca.jacobian(ca.vec(jacobian), self.place.coordinates))
            # The derivative with respect to a single joint is zero; differentiation leaves only rounding.
            rounding = 64 * np.finfo(float).eps * np.abs(self.jacobian[rep]).max(axis=(1, 2))
            derivative[np.abs(derivative).max(axis=(1, 2)) <= rounding] = 0.0
            derivatives[rep] = derivative.reshape(-1, n, 6, n).transpose(0, 3, 1, 2)
        return derivatives

    def evaluate(
        self, expression: ca.SX, symbols: Sequence[ca.SX] = (), columns: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """Return the values of an expression of the configuration and further symbols, in the longest numbers."""
        place = self.place
        there = ca.substitute(expression, place.moves, ca.DM.zeros(place.moves.shape[0]))
        of_place = [as_columns(each) for each in self.samples.of((Q, BASE_POSE, TOOL_POSE))]
        return evaluate_longer([place.q, place.base_pose, self._tool, *symbols], there, [*of_place, *columns])

    @cached_property
    def potential(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Wrench F = dU, covariant Hessian K, joint Hessian of a potential of position and orientation."""
        random = np.random.default_rng(self.seed + 1)
        pose = self.pose_expression
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
        joint_hessian, _ = ca.hessian(potential(position, rotation), self.place.coordinates)
        return self.evaluate(wrench)[..., 0], self.evaluate(covariant), self.evaluate(joint_hessian)

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
            return load + transposed @ symmetric(self.samples[TASK_STIFFNESS]) @ J
        return self.kinematic_stiffness(representation, wrench) + transposed @ self.samples[GENERAL_STIFFNESS] @ J


def load_stiffness(r: References, representation: Representation, wrench: FloatArray | None = None) -> FloatArray:
    """Return the joint stiffness without task stiffness: that of the wrench alone."""
    J, load = r.jacobian[representation], r.samples[WRENCH] if wrench is None else wrench
    matrix = gamma_F(representation, load)
    stiffness: FloatArray = r.kinematic_stiffness(representation, load) + np.swapaxes(J, 1, 2) @ matrix @ J
    if r.chain.floating:
        on_base = np.einsum("ski,sk->si", J[:, :, :6], load)
        stiffness[:, :6, :6] -= gamma_F("body", on_base)
    return stiffness


def as_columns(stack: FloatArray) -> FloatArray:
    """Return a stack (states, ...) as (row-major entries, states)."""
    return stack.reshape(len(stack), -1).T
