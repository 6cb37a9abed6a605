# SPDX-License-Identifier: MIT
"""``casadi.Function`` objects of a chain's kernels, for optimal control and for verification."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import ALL, KernelOptions, Potential
from stiffgen.core.symbolic.kernel import Kernel, absent_functions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.placement import Placement
from stiffgen.core.symbolic.program import as_operand, evaluate


class Functions(SimpleNamespace):
    """Functions of a group or tip; a name that the group lacks on purpose is refused with the reason."""

    __slots__ = ("_path", "_reasons")

    def __init__(self, path: str, reasons: dict[str, str]) -> None:
        super().__init__()
        self._path, self._reasons = path, reasons

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        reason = self._reasons.get(f"{self._path}.{name}")
        raise AttributeError(f"{self._path} has no function '{name}'{f': {reason}' if reason else ''}")


class StiffnessModel:
    """Kernels of a chain as dense ``casadi.Function`` objects under their names.

    Its attributes are, for example,

    * ``model.forward_kinematics``, ``model.mass_matrix`` (for a chain with masses);
    * ``model.hybrid.jacobian``, ``model.hybrid.joint_stiffness``, also of ``body`` and ``spatial``;
    * ``model.spring.torque``, ``model.posture.torque``, ``model.limits.torque``;
    * with a force-torque sensor ``model.sensor.tip_wrench``;
    * with closed loops ``model.close``, ``model.motors.joint_stiffness``;
    * with ``pairs=["left_hand:right_hand"]`` ``model.pair.joint_stiffness``;
    * with several tips ``model.left_hand.hybrid.jacobian`` and ``model.hybrid.joint_stiffness_total``;
    * with ``kernels="all,compliance"`` ``model.hybrid.tip_compliance``, ``model.hybrid.stability``.

    Arguments and results have the shapes of the kernel table. CasADi has two dimensions only, so that
    ``jacobian_transpose_derivative`` (n, n, 6) is folded to (n*n, 6): row i*n + b holds dJ[:, b]/dq_i.

    Args:
        chain: chain from :func:`stiffgen.load_chain`.
        springs: springs in addition to the default spring ("rotation_vector", "quaternion", "coupled").
        placement: axes and centre of stiffness.
        potentials: your own functions U(p, R, parameters) (:mod:`stiffgen.families.springs.potentials`); a group has
            the name of its function.
        derivatives: add the vector-Jacobian product of every function, as ``model.hybrid.joint_stiffness_vjp``.
        pairs: pairs of tips "A:B" with a spring between them, as ``model.pair.joint_stiffness``.
        kernels: groups or functions, as for :func:`stiffgen.generate`: "all,compliance" adds the tip's compliance,
            "all,tangents" bounds for implicit steps.

    Raises:
        PotentialError: a spring or potential is not valid.
        ChainError: the robot has no such group or function.

    """

    forward_kinematics: ca.Function
    mass_matrix: ca.Function
    body: SimpleNamespace
    spatial: SimpleNamespace
    hybrid: SimpleNamespace
    spring: SimpleNamespace
    posture: SimpleNamespace
    limits: SimpleNamespace
    sensor: SimpleNamespace
    motors: SimpleNamespace
    close: ca.Function

    def __init__(
        self,
        chain: Chain,
        *,
        springs: Sequence[str] = (),
        placement: Placement | None = None,
        potentials: Sequence[Callable[..., Any]] = (),
        pairs: Sequence[str] = (),
        derivatives: bool = False,
        kernels: str | Sequence[str] = ALL,
    ) -> None:
        """Derive the chosen functions, and set each at its path, such as hybrid.joint_stiffness."""
        self.chain = chain
        options = KernelOptions(
            springs=springs,
            placement=placement or Placement(),
            potentials=tuple(map(Potential, potentials)),
            pairs=pairs,
            derivatives=derivatives,
            kernels=kernels,
        )
        table = chain_kernels(chain, options)
        reasons = absent_functions(table)
        for kernel in table:
            owner: object = self  # the group that has the function, made on the way
            for depth, name in enumerate(kernel.path, start=1):
                if not hasattr(owner, name):
                    setattr(owner, name, Functions(".".join(kernel.path[:depth]), reasons))
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
    """Return the rows and columns of the CasADi matrix that holds an array."""
    rows, columns = (*folded(shape), 1, 1)[:2]
    return rows, columns


def folded(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return a shape folded to at most two dimensions: the last dimension stays, the others are joined."""
    return shape if len(shape) <= 2 else (math.prod(shape[:-1]), shape[-1])
