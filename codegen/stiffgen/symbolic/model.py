# SPDX-License-Identifier: MIT
"""``casadi.Function`` objects of a chain's kernels, for optimal control and for checking."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kernels import Kernel, chain_kernels
from stiffgen.symbolic.potentials import Potential, SpringOptions
from stiffgen.symbolic.program import as_operand, evaluate
from stiffgen.symbolic.springs import Placement


class StiffnessModel:
    """Kernels of a chain as dense ``casadi.Function`` objects under their names.

    ``model.forward_kinematics``, ``model.mass_matrix`` (unless the chain's masses were left out), and for each
    representation ``model.hybrid.jacobian``, ``model.hybrid.joint_stiffness`` and so on (``body``, ``spatial``,
    ``hybrid``); ``model.spring.torque``, ``model.posture.torque``, ``model.limits.torque`` and their siblings; with
    several tips ``model.left_hand.hybrid.jacobian`` and ``model.hybrid.joint_stiffness_total``.
    Arguments and results have the shapes of the kernel table, except that what has more dimensions than CasADi comes
    folded: ``jacobian_transpose_derivative`` (n, n, 6) as (n*n, 6), row i*n + b holding dJ[:, b]/dq_i.

    Args:
        chain: from :func:`stiffgen.load_chain`.
        springs: springs beyond the default one ("rotation_vector", "quaternion", "coupled").
        placement: axes and centre of stiffness.
        potentials: functions U(p, R, parameters) of your own (:mod:`stiffgen.symbolic.potentials`); the group has the
            function's name.
        derivatives: every function has its vector-Jacobian product beside it, ``model.hybrid.joint_stiffness_vjp``.

    Raises:
        PotentialError: a spring or potential is refused.

    """

    forward_kinematics: ca.Function
    mass_matrix: ca.Function
    body: SimpleNamespace
    spatial: SimpleNamespace
    hybrid: SimpleNamespace
    spring: SimpleNamespace
    posture: SimpleNamespace
    limits: SimpleNamespace

    def __init__(
        self,
        chain: Chain,
        *,
        springs: Sequence[str] = (),
        placement: Placement | None = None,
        potentials: Sequence[Callable[..., Any]] = (),
        derivatives: bool = False,
    ) -> None:
        self.chain = chain
        own = tuple(Potential(function) for function in potentials)
        options = SpringOptions(tuple(springs), placement or Placement(), own, derivatives)
        for kernel in chain_kernels(chain, options):
            owner: object = self
            for name in kernel.path:
                if not hasattr(owner, name):
                    setattr(owner, name, SimpleNamespace())
                owner = getattr(owner, name)
            setattr(owner, kernel.name, casadi_function(chain, kernel))


def casadi_function(chain: Chain, kernel: Kernel) -> ca.Function:
    """Return a kernel as a dense ``casadi.Function``, inputs and outputs named as in the kernel table."""
    symbols: dict[str, ca.SX] = {}
    for argument in kernel.arguments:
        shape = argument.array(chain).shape
        symbols[argument.name] = ca.SX.sym(argument.name, *folded(shape))
    arrays = evaluate(kernel.scope(chain), kernel.steps(chain), symbols)
    results = [result.array(chain) for result in kernel.results]
    dense = [ca.densify(as_operand(folded(result.shape), arrays[result.name])) for result in results]
    names = [result.name for result in results]
    return ca.Function(kernel.qualified_name, list(symbols.values()), dense, list(symbols), names)


def matrix_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return rows and columns of CasADi's matrix for an array."""
    rows, columns = (*folded(shape), 1, 1)[:2]
    return rows, columns


def folded(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return a shape in at most two dimensions, rows of the last one kept together."""
    return shape if len(shape) <= 2 else (math.prod(shape[:-1]), shape[-1])
