"""``casadi.Function`` objects of a chain's kernels, for optimal control and for checking."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca

from stiffgen.chain import Chain
from stiffgen.connection import REPRESENTATIONS
from stiffgen.kernels import Kernel, chain_kernels
from stiffgen.program import as_operand, evaluate


class StiffnessModel:
    """The kernels of a chain as dense ``casadi.Function`` objects under their names.

    ``model.forward_kinematics``, ``model.mass_matrix`` (unless the chain's masses were left out), and for each
    representation ``model.hybrid.jacobian``, ``model.hybrid.joint_stiffness`` and so on (``body``, ``spatial``,
    ``hybrid``). Arguments and results have the
    shapes of the kernel table, except that ``jacobian_transpose_derivative`` (n, n, 6), of more dimensions than
    CasADi has, comes as (n*n, 6): row i*n + b holds dJ[:, b]/dq_i.

    Args:
        chain: from :func:`stiffgen.load_chain`.

    """

    forward_kinematics: ca.Function
    mass_matrix: ca.Function
    body: SimpleNamespace
    spatial: SimpleNamespace
    hybrid: SimpleNamespace

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        for representation in REPRESENTATIONS:
            setattr(self, representation, SimpleNamespace())
        for kernel in chain_kernels(chain):
            owner = getattr(self, kernel.representation) if kernel.representation else self
            setattr(owner, kernel.name, casadi_function(chain, kernel))


def casadi_function(chain: Chain, kernel: Kernel) -> ca.Function:
    """One kernel as a dense ``casadi.Function``, inputs and output named as in the kernel table."""
    symbols: dict[str, ca.SX] = {}
    for argument in kernel.arguments:
        shape = argument.array(chain).shape
        symbols[argument.name] = ca.SX.sym(argument.name, *shape)
    result = kernel.result.array(chain)
    entries = evaluate(chain, kernel.program(chain), symbols)[result.name]
    shape = result.shape if len(result.shape) == 2 else (result.size // result.shape[-1], result.shape[-1])
    dense = ca.densify(as_operand(shape, entries))
    return ca.Function(kernel.qualified_name, list(symbols.values()), [dense], list(symbols), [kernel.result.name])
