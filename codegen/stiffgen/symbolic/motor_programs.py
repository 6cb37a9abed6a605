# SPDX-License-Identifier: MIT
"""Programs of the kernels in motor coordinates: a program of the tree, then one step that closes the loops."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import VELOCITY, Argument, Q
from stiffgen.symbolic.closure import Closure
from stiffgen.symbolic.kinematics import Expressions, Section
from stiffgen.symbolic.program import Array, Operand, Over, Program
from stiffgen.symbolic.steps import ClosedLoops, Map, StraightLine, SumJoints
from stiffgen.symbolic.stiffness import symmetric_from_upper

STEPS = 16
"""Number of Newton's steps of ``close``."""
TRACKING = 8
"""Number of equal parts in which the motors move from the start to their positions, one Newton's step each."""
LARGEST_STEP = 0.5
"""Largest step of the passive coordinates, as a root of the sum of their squares [rad, m]."""
LAST_STEP = 1e-8
"""Largest last step of a closed configuration [rad, m]: each step squares the error, so that rounding is left."""
GAP = 1e-4
"""Largest distance of the ends of a closed loop with all equations [m, rad]: files round points and axes."""


def _expressions(closure: Closure, result: ca.SX) -> Expressions:
    """Return the result with the equations' Jacobian as a named section."""
    names = {}
    for number, (loop, row) in enumerate(closure.rows):
        for k in range(closure.n):
            value = closure.jacobian[number, k]
            if not value.is_zero():
                names[f"C{loop}_{row}_{k}"] = value
    title = "C = dc/dq: loop, equation, coordinate"
    return Expressions(ca.densify(result), (Section(title, names),))


def of_closure(chain: Chain, result: Argument, value: Callable[[Closure], ca.SX], heading: str) -> Program:
    """Return the program of a quantity that follows from q alone."""

    def expressions(chain: Chain, q: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        return _expressions(closure, value(closure))

    return (StraightLine((result.array(chain),), expressions, (Q.array(chain),), heading=heading),)


def multipliers(chain: Chain, result: Argument, gradient: Argument) -> Program:
    """Return the program of the multipliers of a given gradient."""

    def expressions(chain: Chain, q: ca.SX, gradient: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        return _expressions(closure, closure.multipliers(gradient))

    arguments = Q.array(chain), gradient.array(chain)
    heading = "lambda = C_p^-T dU/dp"
    return (StraightLine((result.array(chain),), expressions, arguments, heading=heading),)


def reduction(
    chain: Chain,
    tree: Program,
    gradient: Array,
    hessian: Array | None,
    results: Sequence[Argument],
    parts: str,
    *,
    sign: int = 1,
    moved_only: bool = False,
) -> Program:
    """Return ``tree`` and the step that turns its gradient and Hessian into those of the motors.

    ``parts`` has one letter per result: "G" dU/da, "T" -dU/da, "K" d2U/da2. ``sign`` is -1 if the array ``gradient``
    holds -dU/dq. With ``moved_only``, U depends on the coordinates of the chain's joints alone.
    """

    def expressions(chain: Chain, q: ca.SX, *values: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        moved = {joint.coordinate for joint in chain.joints} if moved_only else set(range(chain.dof))
        gradient = ca.vertcat(*(sign * values[0][k] if k in moved else ca.SX(0) for k in range(chain.dof)))
        forces = closure.multipliers(gradient)
        of_motors = {"G": lambda: closure.gradient(gradient, forces), "T": lambda: -closure.gradient(gradient, forces)}
        of_motors["K"] = lambda: _congruence(closure, _upper(values[1], moved) - closure.stiffness(forces))
        return _expressions(closure, ca.vertcat(*(ca.vec(of_motors[part]().T) for part in parts)))

    names = {"G": "dU/da = dU/dq_a - C_a^T lambda", "T": "-dU/da = -(dU/dq_a - C_a^T lambda)"}
    names["K"] = "d2U/da2 = G^T (d2U/dq2 - sum_k lambda_k d2c_k/dq2) G"
    heading = "; ".join(names[part] for part in parts)
    inputs = (Q.array(chain), gradient, *((hessian,) if hessian else ()))
    return *tree, StraightLine(tuple(each.array(chain) for each in results), expressions, inputs, heading=heading)


def wrench_gradient(chain: Chain, wrench: Array, output: Array) -> Program:
    """Return the steps of J^T F from hybrid columns J that an earlier step writes."""
    m = len(chain.joints)
    of_joints = Array("gradient_of_joints", (m,)) if chain.coupled else output
    operands = Operand(Array("J", (6, m)), "j"), Operand(wrench, "")
    products = Map("dU/dq_j = J_j . F", Over.JOINTS, Operand(of_joints, "j"), operands, ca.dot)
    return (products, SumJoints(of_joints, output)) if chain.coupled else (products,)


def mass_matrix(chain: Chain, tree: Program, mass: Array, result: Argument) -> Program:
    """Return ``tree`` and the step G^T M G."""

    def expressions(chain: Chain, q: ca.SX, mass: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        return _expressions(closure, _congruence(closure, symmetric_from_upper(mass)))

    step = StraightLine((result.array(chain),), expressions, (Q.array(chain), mass), heading="G^T M G")
    return *tree, step


def bias_forces(chain: Chain, tree: Program, velocity: Argument, result: Argument) -> Program:
    """Return the program of G^T (M dG/dt da + h): rates and accelerations of the tree, ``tree``, and their reduction.

    ``tree`` computes the arrays "forces" and "mass_matrix_of_tree" from the tree's rates.
    """
    n = chain.dof
    rates, acceleration = VELOCITY.array(chain), Array("acceleration", (n,))
    forces, matrix = Array("forces", (n,)), Array("mass_matrix_of_tree", (n, n))

    def motion(chain: Chain, q: ca.SX, velocity: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        rates = closure.motion() @ velocity
        passive = closure.passive_rates(closure.acceleration(rates))
        return _expressions(closure, ca.vertcat(ca.densify(rates), passive))

    def reduced(chain: Chain, q: ca.SX, acceleration: ca.SX, forces: ca.SX, mass: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        total = symmetric_from_upper(mass) @ acceleration + forces
        return _expressions(closure, closure.gradient(total, closure.multipliers(total)))

    q = Q.array(chain)
    heading = "rates G da and accelerations dG/dt da of the tree"
    first = StraightLine((rates, acceleration), motion, (q, velocity.array(chain)), heading=heading)
    arguments = q, acceleration, forces, matrix
    last = StraightLine((result.array(chain),), reduced, arguments, heading="G^T (M dG/dt da + h)")
    return first, *tree, last


def close(chain: Chain, actuated: Argument, start: Argument, result: Argument) -> Program:
    """Return the program of Newton's method for the passive joints: a fixed number of steps with bounded length.

    The motors move from their start to their positions in ``TRACKING`` equal parts, so that the passive joints stay on
    the branch of the start.
    """
    motors, begin = actuated.array(chain), start.array(chain)
    states = [Array(f"q{k}", begin.shape, "y") for k in range(1, STEPS)]
    parts = [Array(f"motors{k}", motors.shape, "m") for k in range(1, TRACKING)]

    def spread(chain: Chain, actuated: ca.SX, start: ca.SX) -> Expressions:
        before = ca.vertcat(*(start[joint] for joint in chain.actuated))
        moved = (before + (actuated - before) * (k / TRACKING) for k in range(1, TRACKING))
        return Expressions(ca.densify(ca.vertcat(*moved)), ())

    def newton(chain: Chain, actuated: ca.SX, q: ca.SX) -> Expressions:
        q = _placed(chain, actuated, q)
        closure = Closure(chain, q)
        step = closure.passive_rates(closure.residual())[chain.base_joints :]
        scale = 1 / ca.fmax(1, ca.sqrt(ca.sumsqr(step)) / LARGEST_STEP)
        moved = (q[k] if k in chain.actuated else q[k] + scale * step[k] for k in range(q.numel()))
        return _expressions(closure, ca.vertcat(*moved))

    def checked(chain: Chain, actuated: ca.SX, q: ca.SX) -> Expressions:
        q = _placed(chain, actuated, q)
        closure = Closure(chain, q)
        step = closure.passive_rates(closure.residual())[chain.base_joints :]
        is_closed = (ca.sumsqr(step) <= LAST_STEP**2) * (closure.squared_gap() <= GAP**2)
        return _expressions(closure, q + step + ca.sqrt(is_closed - 1))

    meaning = "One step of Newton's method for the passive joints"
    targets = [*parts, *(len(states) - len(parts)) * [motors]]
    steps = [
        StraightLine((after,), newton, (target, before), "newton_step", meaning=meaning)
        for target, before, after in zip(targets, (begin, *states), states, strict=False)
    ]
    first = StraightLine(tuple(parts), spread, (motors, begin), heading="the motors on their way")
    last = ClosedLoops(
        (result.array(chain),), checked, (motors, states[-1]), heading="the last step; NaN unless closed"
    )
    return first, *steps, last


def _placed(chain: Chain, actuated: ca.SX, q: ca.SX) -> ca.SX:
    """Return joint positions with other positions of the motors."""
    values = [q[k] for k in range(q.numel())]
    for k, joint in enumerate(chain.actuated):
        values[joint] = actuated[k]
    return ca.vertcat(*values)


def _upper(matrix: ca.SX, moved: set[int]) -> ca.SX:
    """Return a symmetric matrix from its upper triangle; rows and columns of other coordinates are not stored."""
    whole, result = symmetric_from_upper(matrix), ca.SX(*matrix.shape)
    for i in moved:
        for j in moved:
            result[i, j] = whole[i, j]
    return result


def _congruence(closure: Closure, matrix: ca.SX) -> ca.SX:
    """Return G^T matrix G of a symmetric matrix, symmetric."""
    G = closure.motion()
    return ca.triu2symm(ca.triu(ca.densify(G.T @ (matrix @ G))))
