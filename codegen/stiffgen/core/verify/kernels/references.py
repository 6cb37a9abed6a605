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
from typing import Any, TypeVar, cast

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import BASE_POSE, TOOL_POSE, Q, configuration_arguments
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.verify.kernels.poses import MovedConfiguration, gamma_F, jacobian_of, product_of_poses
from stiffgen.core.verify.kernels.rounding import evaluate_longer
from stiffgen.core.verify.kernels.samples import Samples, symmetric

Derived = TypeVar("Derived")
WRENCH = arguments.wrench("hybrid")
TASK_STIFFNESS = arguments.task_stiffness("hybrid", symmetric_part=True)
GENERAL_STIFFNESS = arguments.task_stiffness("hybrid", symmetric_part=False)


class ReadOnDemand(dict[Representation, Derived]):
    """Values by representation, each computed when it is first read."""

    def __init__(self, compute: Callable[[Representation], Derived]) -> None:
        super().__init__()
        self._compute = compute

    def __missing__(self, representation: Representation) -> Derived:
        return self.setdefault(representation, self._compute(representation))


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
        return cast(Derived, self._derived[derive])

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
    def jacobian_expressions(self) -> ReadOnDemand[ca.SX]:
        """Jacobian in each representation, as an expression of the configuration."""
        moves = ca.SX.sym("s", self.chain.base_joints)  # rates of the coordinates, at the base's present pose
        moved = product_of_poses(self.chain, self.place.q, self.place.base(moves)) @ self.mounted
        at_rest = ca.DM.zeros(self.chain.base_joints)
        variables = ca.vertcat(moves, self.place.q)
        return ReadOnDemand(lambda rep: ca.substitute(jacobian_of(moved, variables, rep), moves, at_rest))

    @cached_property
    def jacobian(self) -> ReadOnDemand[FloatArray]:
        """Jacobian in each representation."""
        return ReadOnDemand(lambda rep: self.evaluate(self.jacobian_expressions[rep]))

    @cached_property
    def derivative(self) -> ReadOnDemand[FloatArray]:
        """Derivative dJ^T/dq in each representation: entry [state, i, b, k] is dJ[k, b]/dq_i."""
        n = self.chain.dof

        def derivative(rep: Representation) -> FloatArray:
            # ca.vec stacks columns: entry [state, 6 b + k, i] is dJ[k, b]/dq_i.
            stacked = self.evaluate(ca.jacobian(ca.vec(self.jacobian_expressions[rep]), self.place.coordinates))
            # The derivative with respect to a single joint is zero; differentiation leaves only rounding.
            rounding = 64 * np.finfo(float).eps * np.abs(self.jacobian[rep]).max(axis=(1, 2))
            stacked[np.abs(stacked).max(axis=(1, 2)) <= rounding] = 0.0
            return stacked.reshape(-1, n, 6, n).transpose(0, 3, 1, 2)  # from [state, b, k, i]

        return ReadOnDemand(derivative)

    def evaluate(
        self, expression: ca.SX, symbols: Sequence[ca.SX] = (), columns: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """Return the values of an expression of the configuration and further symbols, in the longest numbers."""
        place = self.place
        in_place = ca.substitute(expression, place.moves, ca.DM.zeros(place.moves.shape[0]))  # the base has not moved
        of_place = [as_columns(each) for each in self.samples.of((Q, BASE_POSE, TOOL_POSE))]
        return evaluate_longer([place.q, place.base_pose, self._tool, *symbols], in_place, [*of_place, *columns])

    @cached_property
    def potential(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Wrench F = dU and covariant Hessian K in body axes, and joint Hessian, of a random potential U(p, R)."""
        U = random_potential(np.random.default_rng(self.seed + 1))
        p, R = self.pose_expression[:3, 3], self.pose_expression[:3, :3]
        # docs/theory.md (5) in body axes: the first two derivatives of U(p + R v, R exp([w])) at the twist (v, w) = 0.
        # I + [w] + [w]^2/2 has the same ones as exp([w]).
        twist = ca.SX.sym("x", 6)
        v, w_cross = twist[:3], ca.skew(twist[3:])
        moved = U(p + R @ v, R @ (ca.DM.eye(3) + w_cross + w_cross @ w_cross / 2))
        covariant, wrench = (ca.substitute(each, twist, ca.DM.zeros(6)) for each in ca.hessian(moved, twist))
        joint_hessian, _ = ca.hessian(U(p, R), self.place.coordinates)
        return self.evaluate(wrench)[..., 0], self.evaluate(covariant), self.evaluate(joint_hessian)

    def kinematic_stiffness(self, representation: Representation, wrench: FloatArray | None = None) -> FloatArray:
        """Return the kinematic stiffness: column i is dJ^T/dq_i F."""
        load = self.samples[WRENCH] if wrench is None else wrench
        derivative = self.derivative[representation]  # [state s, coordinate i, column b, row k]
        contracted: FloatArray = np.einsum("sibk,sk->sbi", derivative, load)
        return contracted

    def joint_stiffness(
        self, representation: Representation, *, corrected: bool, wrench: FloatArray | None = None
    ) -> FloatArray:
        """Return the joint stiffness, docs/theory.md (3) or without the correction (2), term by term.

        A ``wrench`` takes the place of the samples' one.
        """
        J = self.jacobian[representation]
        J_T = np.swapaxes(J, 1, 2)
        if not corrected:
            return self.kinematic_stiffness(representation, wrench) + J_T @ self.samples[GENERAL_STIFFNESS] @ J
        return load_stiffness(self, representation, wrench) + J_T @ symmetric(self.samples[TASK_STIFFNESS]) @ J


def load_stiffness(r: References, representation: Representation, wrench: FloatArray | None = None) -> FloatArray:
    """Return the joint stiffness of the wrench alone, without task stiffness: dJ^T/dq . F + J^T (Gamma F) J."""
    J, F = r.jacobian[representation], r.samples[WRENCH] if wrench is None else wrench
    J_T = np.swapaxes(J, 1, 2)
    stiffness: FloatArray = r.kinematic_stiffness(representation, F) + J_T @ gamma_F(representation, F) @ J
    if r.chain.floating:  # less the connection of the base's own twist, whose gradient is J_base^T F
        base_force = np.einsum("ski,sk->si", J[:, :, :6], F)
        stiffness[:, :6, :6] -= gamma_F("body", base_force)
    return stiffness


def random_potential(random: np.random.Generator) -> Callable[[ca.SX, ca.SX], ca.SX]:
    """Return U(p, R) = (p - c)^T S (p - c)/2 + T . R + (p - c)^T M vec(R), whose derivatives have all couplings."""
    root = random.normal(size=(3, 3)) * 100
    stiffness, centre = root @ root.T / 100, random.normal(size=3)
    turning, mixed = random.normal(size=(3, 3)) * 30, random.normal(size=(3, 9)) * 20

    def potential(p: ca.SX, R: ca.SX) -> ca.SX:
        away = p - centre
        return away.T @ ca.DM(stiffness) @ away / 2 + ca.dot(ca.DM(turning), R) + away.T @ ca.DM(mixed) @ ca.vec(R)

    return potential


def as_columns(stack: FloatArray) -> FloatArray:
    """Return a stack (states, ...) as (row-major entries, states)."""
    return stack.reshape(len(stack), -1).T
