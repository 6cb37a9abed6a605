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

from collections.abc import Sequence
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
    """Orthogonal rows of a matrix, their squared lengths as divisors, C below the diagonal (``parts``), and w."""

    rows: Sequence[ca.SX]
    squares: Sequence[ca.SX]
    parts: dict[tuple[int, int], ca.SX]
    measure: ca.SX
    sections: tuple[Section, ...]

    @staticmethod
    def of(matrix: ca.SX) -> _Orthogonal:
        """Orthogonalise the rows: each takes its part out of all later ones (modified Gram-Schmidt)."""
        rows, squares, parts, sections = list(ca.vertsplit(ca.densify(matrix))), list[ca.SX](), {}, list[Section]()
        product = ca.SX(1)
        for k, row in enumerate(rows):
            square = ca.SX(ca.dot(row, row))
            product *= square
            squares.append(ca.fmax(square, _LEAST))
            section = Section(f"row {k}, orthogonal to those before it: r{k}, squared length d{k}; parts of later rows")
            section.values |= {f"r{k}_": row.T, f"d{k}": squares[k]}
            for later in range(k + 1, len(rows)):
                part = parts[later, k] = ca.dot(row, rows[later]) / squares[k]
                section.values[f"c{later}_{k}"] = part
                rows[later] = rows[later] - part * row
            sections.append(section)
        return _Orthogonal(rows, squares, parts, ca.sqrt(product), tuple(sections))

    def cotangent(self) -> ca.SX:
        """Return Y, the gradient of w with respect to the entries of the matrix."""
        rows: dict[int, ca.SX] = {}
        for k in reversed(range(len(self.rows))):
            others = (self.parts[later, k] * rows[later] for later in rows)
            rows[k] = self.rows[k] / self.squares[k] - sum(others, ca.SX.zeros(1, self.rows[k].shape[1]))
        return self.measure * ca.vertcat(*(rows[k] for k in sorted(rows)))


def _patterns(chain: Chain) -> tuple[ca.DM, ca.DM]:
    """Return ones where an entry of the Jacobian is not always zero, and where it depends on q; else zeros."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool)
    q, *tool = (ca.SX.sym(a.name, *a.shape) for a in (argument.array(chain) for argument in configuration))
    columns = kinematics.joint_jacobian(chain, q, *tool, representation="body").result
    by_coordinates = ca.SX.zeros(6, chain.dof)
    for k, joint in enumerate(chain.joints):
        by_coordinates[:, joint.coordinate] += columns[:, k]
    entries = [[by_coordinates[row, column] for column in range(chain.dof)] for row in range(6)]
    nonzero = [[not entry.is_zero() for entry in row] for row in entries]
    return ca.DM(nonzero), ca.DM([[ca.depends_on(entry, q) for entry in row] for row in entries])


def _orthogonal(chain: Chain, jacobian: ca.SX) -> tuple[_Orthogonal, list[int]]:
    """Return the orthogonal rows and the columns of the Jacobian: coordinates of the tip's joints."""
    columns = sorted({joint.coordinate for joint in chain.joints[chain.base_joints :]})
    of_tip = (jacobian * _patterns(chain)[0])[:, columns]
    return _Orthogonal.of(of_tip if len(columns) >= 6 else of_tip.T), columns


def _measure(chain: Chain, jacobian: ca.SX) -> Expressions:
    """Return w."""
    orthogonal, _ = _orthogonal(chain, jacobian)
    return Expressions(orthogonal.measure, orthogonal.sections)


def _cotangent(chain: Chain, jacobian: ca.SX) -> Expressions:
    """Return Y in the shape of the Jacobian, row-major; zero where an entry does not depend on q."""
    orthogonal, columns = _orthogonal(chain, jacobian)
    of_tip, result = orthogonal.cotangent(), ca.SX.zeros(*jacobian.shape)
    result[:, columns] = of_tip if len(columns) >= 6 else of_tip.T
    return Expressions(ca.vec(ca.densify(result * _patterns(chain)[1]).T), orthogonal.sections)


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
    cotangent = StraightLine((Y,), _cotangent, (J,), heading="Y = w C^-T D^-1 r", columns=0 if chain.coupled else 1)
    product = [step for step in adjoint.reverse(chain, steps, [q], [J], [Y]) if step not in steps]
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
            "manipulability", None, configuration, (measure,),
            "Manipulability of the tip.",
            f"w = sqrt(det(J J^T)), or sqrt(det(J^T J)) with fewer than six joints; {jacobian} (Yoshikawa 1985)",
            partial(manipulability, result=measure),
            batch=True,
        ),
        Kernel(
            "manipulability_gradient", None, configuration, (gradient,),
            "Gradient of the manipulability with respect to the joint positions.",
            "dw/dq_i = w tr(J^+ dJ/dq_i)",
            partial(manipulability_gradient, result=gradient),
            batch=True,
            is_gradient=True,
        ),
    )  # fmt: skip
