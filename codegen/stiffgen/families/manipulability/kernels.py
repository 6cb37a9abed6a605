# SPDX-License-Identifier: MIT
"""Manipulability of a tip (Yoshikawa 1985) and its gradient with respect to the joint positions.

w = sqrt(det(J J^T)) is the product of the singular values of J, the Jacobian (6 x n) of the joints without a floating
base; with fewer than six joints, w = sqrt(det(J^T J)). J is the body Jacobian: the axes do not matter and, with six or
more joints, neither does the reference point.

Let the rows of M be those of J, or of J^T with fewer than six joints. Modified Gram-Schmidt orthogonalisation, M = C r
with a unit lower triangular C and orthogonal rows r_k of squared lengths d_k, gives w as the root of the product of
d_k. Close to a singularity it keeps the digits that det(J J^T) loses. The gradient follows from

    dw = sum of Y_lj dM_lj    Y = w C^-T D^-1 r, needed where M depends on q

At a singularity some r_k is zero. As a divisor d_k is at least 1e-37, so that w and the gradient are 0: w has its
minimum there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import kinematics, pose
from stiffgen.core.symbolic.arguments import Argument, Q, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.kinematics import Expressions, Section
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, StraightLine
from stiffgen.families.derivatives import adjoint
from stiffgen.families.derivatives.gradients import bar_name

_LEAST = 1e-37
"""Smallest divisor: less than the square of rounding, and a normal number in single precision."""


@dataclass(frozen=True)
class _Orthogonal:
    """Orthogonal rows r of a matrix M = C r, and w, the product of their lengths.

    Attributes:
        rows: r_k, (1 x n).
        squares: d_k = r_k . r_k, at least ``_LEAST``, since it divides.
        parts: entry (l, k) of C, below the diagonal: the part of r_k in row l of M.
        measure: w.
        sections: names of the intermediate quantities.

    """

    rows: Sequence[ca.SX]
    squares: Sequence[ca.SX]
    parts: dict[tuple[int, int], ca.SX]
    measure: ca.SX
    sections: tuple[Section, ...]

    @staticmethod
    def of(matrix: ca.SX) -> _Orthogonal:
        """Orthogonalise the rows: each takes its part out of all later ones (modified Gram-Schmidt)."""
        rows = list(ca.vertsplit(ca.densify(matrix)))  # those before k are orthogonal already
        squares, sections = list[ca.SX](), list[Section]()
        parts: dict[tuple[int, int], ca.SX] = {}
        product = ca.SX(1)
        for k in range(len(rows)):
            row = rows[k]
            square = ca.SX(ca.dot(row, row))
            product *= square
            squares.append(ca.fmax(square, _LEAST))
            section = Section(f"row {k}, orthogonal to those before it: r{k}, squared length d{k}; parts of later rows")
            section.values |= {f"r{k}_": row.T, f"d{k}": squares[k]}
            for later in range(k + 1, len(rows)):
                part = ca.dot(row, rows[later]) / squares[k]
                rows[later] = rows[later] - part * row
                parts[later, k] = part
                section.values[f"c{later}_{k}"] = part
            sections.append(section)
        return _Orthogonal(rows, squares, parts, ca.sqrt(product), tuple(sections))

    def cotangent(self) -> ca.SX:
        """Return Y = w C^-T D^-1 r, the gradient of w with respect to the entries of the matrix.

        The rows y_k of C^-T D^-1 r follow from C^T y = D^-1 r, the last one first: y_k = r_k/d_k - sum C_lk y_l, l > k.
        """
        solved: dict[int, ca.SX] = {}
        for k in reversed(range(len(self.rows))):
            row = self.rows[k]
            of_later = sum((self.parts[later, k] * solved[later] for later in solved), ca.SX.zeros(*row.shape))
            solved[k] = row / self.squares[k] - of_later
        return self.measure * ca.vertcat(*(solved[k] for k in sorted(solved)))


def _jacobian_of_coordinates(chain: Chain) -> tuple[ca.SX, ca.SX]:
    """Return the body Jacobian (6 x n) without the joints' multipliers, and the symbols of q."""
    configuration = [each.array(chain) for each in configuration_arguments(runtime_tool=chain.runtime_tool)]
    symbols = [ca.SX.sym(array.name, *array.shape) for array in configuration]
    of_joints = kinematics.joint_jacobian(chain, *symbols, representation="body").result
    jacobian = ca.SX.zeros(6, chain.dof)
    for k, joint in enumerate(chain.joints):
        jacobian[:, joint.coordinate] += of_joints[:, k]
    return jacobian, symbols[0]


def _pattern(chain: Chain, holds: Callable[[ca.SX, ca.SX], bool]) -> ca.DM:
    """Return a matrix (6 x n): 1 where a property of (entry of the Jacobian, q) holds, else 0."""
    jacobian, q = _jacobian_of_coordinates(chain)
    return ca.DM([[holds(jacobian[row, column], q) for column in range(chain.dof)] for row in range(6)])


def _columns_of_tip(chain: Chain) -> list[int]:
    """Return the coordinates of the tip's joints, which are columns of the Jacobian."""
    return sorted({joint.coordinate for joint in chain.joints[chain.base_joints :]})


def _as_rows(of_tip: ca.SX, columns: list[int]) -> ca.SX:
    """Return a matrix of the tip's ``columns`` as M, or M as that matrix: transposed for fewer than six joints."""
    return of_tip if len(columns) >= 6 else of_tip.T


def _orthogonal(chain: Chain, jacobian: ca.SX) -> _Orthogonal:
    """Return the orthogonal rows of M; entries that are always zero are structural zeros."""
    columns = _columns_of_tip(chain)
    is_nonzero = _pattern(chain, lambda entry, q: not entry.is_zero())
    return _Orthogonal.of(_as_rows((jacobian * is_nonzero)[:, columns], columns))


def _measure(chain: Chain, jacobian: ca.SX) -> Expressions:
    """Return w."""
    orthogonal = _orthogonal(chain, jacobian)
    return Expressions(orthogonal.measure, orthogonal.sections)


def _cotangent(chain: Chain, jacobian: ca.SX) -> Expressions:
    """Return Y in the shape of the Jacobian, row-major; zero where an entry does not depend on q."""
    orthogonal, columns = _orthogonal(chain, jacobian), _columns_of_tip(chain)
    result = ca.SX.zeros(*jacobian.shape)
    result[:, columns] = _as_rows(orthogonal.cotangent(), columns)
    reads_q = _pattern(chain, ca.depends_on)
    return Expressions(ca.vec(ca.densify(result * reads_q).T), orthogonal.sections)


def _jacobian(chain: Chain) -> tuple[Program, Array]:
    """Return the steps that compute the body Jacobian, with a column per coordinate, and its array."""
    result = Argument("J_of_coordinates" if chain.coupled else "J", (6, "n"), "", "")
    return pose.jacobian(chain, "body", result), result.array(chain)


def manipulability(chain: Chain, result: Argument) -> Program:
    """Return the program of w."""
    steps, J = _jacobian(chain)
    heading = "w: root of the product of all d"
    return *steps, StraightLine((result.array(chain),), _measure, (J,), heading=heading)


def manipulability_gradient(chain: Chain, result: Argument) -> Program:
    """Return the program of dw/dq: the vector-Jacobian product of J with the cotangent Y."""
    steps, J = _jacobian(chain)
    Y, q = Array("Y", J.shape), Q.array(chain)
    per_joint = 0 if chain.coupled else 1  # outputs with a column per joint: Y has one per coordinate
    cotangent = StraightLine((Y,), _cotangent, (J,), heading="Y = w C^-T D^-1 r", columns=per_joint)
    # The product's own forward steps stand before the cotangent, which reads J.
    whole_product = adjoint.reverse(chain, steps, arguments=[q], results=[J], cotangents=[Y])
    product = [step for step in whole_product if step not in steps]
    gradient = Operand(Array(bar_name(q.name), q.shape), "")
    total = Map("dw/dq", Over.ONCE, Operand(result.array(chain), ""), (gradient,), lambda value: value)
    return *steps, cotangent, *product, total


def manipulability_kernels(configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of Yoshikawa's measure; ``configuration`` is that of body representation."""
    measure = Argument("manipulability", (), "m^3", "w, zero at a singularity; other units with fewer than six joints")
    gradient = Argument("manipulability_gradient", ("q",), "m^3/rad", "dw/dq, zero where w is zero")
    jacobian = "J the body or hybrid Jacobian of the joints"
    return (
        Kernel(
            name="manipulability",
            group=None,
            arguments=configuration,
            results=(measure,),
            summary="Manipulability of the tip.",
            equation="w = sqrt(det(J J^T)), or sqrt(det(J^T J)) with fewer than six joints; "
            f"{jacobian} (Yoshikawa 1985)",
            program=partial(manipulability, result=measure),
            batch=True,
        ),
        Kernel(
            name="manipulability_gradient",
            group=None,
            arguments=configuration,
            results=(gradient,),
            summary="Gradient of the manipulability with respect to the joint positions.",
            equation="dw/dq_i = w tr(J^+ dJ/dq_i)",
            program=partial(manipulability_gradient, result=gradient),
            batch=True,
            is_gradient=True,
        ),
    )
