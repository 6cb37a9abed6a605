# SPDX-License-Identifier: MIT
"""Programs of the kernels in motor coordinates: a program of the tree, then one step that closes the loops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import VELOCITY, Argument, Q
from stiffgen.core.symbolic.kinematics import Expressions, Kind, Section
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, Step, entries_of
from stiffgen.core.symbolic.steps import CloseLoops, Map, StraightLine, SumJoints
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.loops.closure import Closure, hinges, sines_and_cosines
from stiffgen.families.masks import zero_or_nan

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
    columns: Array | None = None,
) -> Program:
    """Return ``tree`` and the step that turns its gradient and Hessian into those of the motors.

    ``parts`` has one letter per result: "G" dU/da, "T" -dU/da, "K" d2U/da2, "J" the columns J of the joints as those
    of the motors, J G. ``sign`` is -1 if the array ``gradient`` holds -dU/dq. Where ``tree`` sums an array over joints,
    the step reads the array of joints and sums it itself (:func:`_of_joints`).
    """
    tree, gradient_read = _of_joints(tree, gradient)
    read = {"gradient": gradient_read}  # arrays of the tree that the step reads
    if hessian:
        tree, read["hessian"] = _of_joints(tree, hessian)
    if columns:
        read["columns"] = columns
    tree, turns = _with_turns(chain, tree)

    def expressions(chain: Chain, q: ca.SX, *inputs: ca.SX) -> Expressions:
        """Return the results of the motors, stacked; ``inputs`` are the arrays read, then sines and cosines."""
        of_tree = dict(zip(read, inputs, strict=False))
        closure = Closure(chain, q, *inputs[len(read) :])
        dU_dq = sign * _summed_vector(chain, of_tree["gradient"], of_joints=gradient_read != gradient)
        multipliers = closure.multipliers(dU_dq)

        def stiffness() -> ca.SX:
            of_joints = read["hessian"] != hessian
            d2U_dq2 = _summed_matrix(chain, of_tree["hessian"], of_joints=of_joints)
            return _congruence(closure, d2U_dq2 - closure.stiffness(multipliers))

        of_motors: dict[str, Callable[[], ca.SX]] = {  # functions, since each builds what only its part needs
            "G": lambda: closure.gradient(dU_dq, multipliers),
            "T": lambda: -closure.gradient(dU_dq, multipliers),
            "K": stiffness,
            "J": lambda: _summed_columns(chain, of_tree["columns"]) @ closure.motion(),
        }
        rows = (ca.vec(ca.densify(of_motors[part]()).T) for part in parts)
        return _expressions(closure, ca.vertcat(*rows))

    names = {
        "G": "dU/da = dU/dq_a - C_a^T lambda",
        "T": "-dU/da = -(dU/dq_a - C_a^T lambda)",
        "K": "d2U/da2 = G^T (d2U/dq2 - sum_k lambda_k d2c_k/dq2) G",
        "J": "J G",
    }
    heading = "; ".join(names[part] for part in parts)
    outputs, inputs = tuple(each.array(chain) for each in results), (Q.array(chain), *read.values(), *turns)
    return *tree, StraightLine(outputs, expressions, inputs, heading=heading)


def _of_joints(tree: Program, array: Array) -> tuple[Program, Array]:
    """Return ``tree`` without the sum of an array over joints, and the array of joints; else both as they are.

    Coordinates that no joint moves are zeros of the sum, and the reduction leaves them out. It reads the upper triangle
    of symmetric matrices alone.
    """
    sums = [step for step in tree if isinstance(step, SumJoints) and step.output == array]
    source = sums[0].source if sums else array

    def triangle(step: Step) -> Step:
        if isinstance(step, Map) and step.output.array == source and step.over in (Over.UPPER, Over.ON_THE_WAY):
            return replace(step, mirror=False)
        return step

    return tuple(triangle(step) for step in tree if step not in sums), source


def _with_turns(chain: Chain, tree: Program) -> tuple[Program, tuple[Array, ...]]:
    """Return ``tree`` with the sines and cosines of the hinges, and their arrays; none if no step computes columns.

    The step that computes the columns of the tip's Jacobian writes them, too, so that no sine is computed twice. Its
    statements stand within the kernel: a call of a function costs 40 instructions more.
    """
    count, q = len(hinges(chain)), Q.array(chain)
    steps_of_columns = [step for step in tree if isinstance(step, StraightLine) and step.columns and step.moves]
    if not (steps_of_columns and count):
        return tree, ()
    (of_columns,) = steps_of_columns
    turns = Array("loop_sines", (count,)), Array("loop_cosines", (count,))

    def turns_alone(chain: Chain, q: ca.SX) -> Expressions:
        return Expressions(ca.vertcat(*sines_and_cosines(chain, q)), ())

    def together(chain: Chain, *arguments: ca.SX) -> Expressions:
        whole = of_columns.expressions(chain, *arguments)
        of_turns = turns_alone(chain, arguments[of_columns.arguments.index(q)])
        result = ca.vertcat(*entries_of(whole.result), of_turns.result)
        return Expressions(result, whole.sections, (*whole.kinds, *(2 * count * (Kind.ROTATION,))))

    step_of_turns = StraightLine(turns, turns_alone, (q,), heading="sines and cosines of the hinges in loops")
    both = replace(
        of_columns,
        outputs=(*of_columns.outputs, *turns),
        expressions=together,
        name="",
        apart=(of_columns, step_of_turns),
    )
    return tuple(both if each is of_columns else each for each in tree), turns


def _summed_vector(chain: Chain, values: ca.SX, *, of_joints: bool) -> ca.SX:
    """Return a vector of the coordinates; that of joints is summed over the joints of each coordinate."""
    if not of_joints:
        return values
    result = ca.SX(chain.dof, 1)
    for k, joint in enumerate(chain.joints):
        result[joint.coordinate] += joint.multiplier * values[k]
    return result


def _summed_columns(chain: Chain, values: ca.SX) -> ca.SX:
    """Return the columns of the coordinates from those of the joints."""
    result = ca.SX(values.shape[0], chain.dof)
    for k, joint in enumerate(chain.joints):
        result[:, joint.coordinate] += joint.multiplier * values[:, k]
    return result


def _summed_matrix(chain: Chain, values: ca.SX, *, of_joints: bool) -> ca.SX:
    """Return a symmetric matrix of the coordinates from the upper triangle of that of coordinates or joints."""
    if not of_joints:
        return symmetric_from_upper(values)
    result = ca.SX(chain.dof, chain.dof)
    for i, first in enumerate(chain.joints):
        for j, second in enumerate(chain.joints[i:], start=i):
            value = first.multiplier * second.multiplier * values[i, j]
            result[first.coordinate, second.coordinate] += value
            if i != j:
                result[second.coordinate, first.coordinate] += value
    return result


def wrench_gradient(chain: Chain, wrench: Array, output: Array) -> Program:
    """Return the steps of J^T F from hybrid columns J that an earlier step writes."""
    m = len(chain.joints)
    of_joints = Array("gradient_of_joints", (m,)) if chain.coupled else output
    operands = Operand(Array("J", (6, m)), "j"), Operand(wrench, "")
    products = Map("dU/dq_j = J_j . F", Over.JOINTS, Operand(of_joints, "j"), operands, ca.dot)
    return (products, SumJoints(of_joints, output)) if chain.coupled else (products,)


def mass_matrix(chain: Chain, tree: Program, mass: Array, result: Argument) -> Program:
    """Return ``tree`` and the step G^T M G."""
    tree, source = _of_joints(tree, mass)

    def expressions(chain: Chain, q: ca.SX, values: ca.SX) -> Expressions:
        closure = Closure(chain, q)
        return _expressions(closure, _congruence(closure, _summed_matrix(chain, values, of_joints=source != mass)))

    step = StraightLine((result.array(chain),), expressions, (Q.array(chain), source), heading="G^T M G")
    return *tree, step


def bias_forces(
    chain: Chain, tree: Callable[[Array], Program], forces: Array, velocity: Argument, result: Argument
) -> Program:
    """Return the program of G^T (M dG/dt da + h): rates and accelerations of the tree, its forces, their reduction.

    ``tree`` returns the steps that compute ``forces`` from the tree's rates and an array of its accelerations.
    """
    n, motors = chain.dof, chain.motors
    passive = [k for k in range(n) if k not in motors]  # coordinates that the closed loops move
    rates, acceleration = VELOCITY.array(chain), Array("acceleration", (n,))
    G_p = Array("G", (len(passive), len(motors)))
    steps, source = _of_joints(tree(acceleration), forces)

    def motion(chain: Chain, q: ca.SX, velocity: ca.SX) -> Expressions:
        """Return rates of all coordinates, their accelerations at constant rates of the motors, and G_p."""
        closure = Closure(chain, q)
        G = closure.motion()
        rates = G @ velocity
        accelerations = closure.passive_rates(closure.acceleration(rates))
        stacked = ca.vertcat(ca.densify(rates), accelerations, ca.vec(ca.densify(G[passive, :].T)))
        return _expressions(closure, stacked)

    def reduced(chain: Chain, G_p: ca.SX, values: ca.SX) -> Expressions:
        total = _summed_vector(chain, values, of_joints=source != forces)
        return Expressions(ca.densify(total[list(motors)] + G_p.T @ total[passive]), ())

    heading = "rates G da and accelerations dG/dt da of the tree; passive rows of G"
    first = StraightLine((rates, acceleration, G_p), motion, (Q.array(chain), velocity.array(chain)), heading=heading)
    last = StraightLine((result.array(chain),), reduced, (G_p, source), heading="G^T (M dG/dt da + h)")
    return first, *steps, last


def close(chain: Chain, actuated: Argument, start: Argument, result: Argument) -> Program:
    """Return the program of Newton's method for the passive joints: a fixed number of steps with bounded length.

    The motors move from their start to their positions in ``TRACKING`` equal parts, so that the passive joints stay on
    the branch of the start. The first ``TRACKING - 1`` steps aim at these parts, all others at the motors' positions.
    """
    motors, begin = actuated.array(chain), start.array(chain)
    states = [Array(f"q{k}", begin.shape, "y") for k in range(1, STEPS)]
    parts = [Array(f"motors{k}", motors.shape, "m") for k in range(1, TRACKING)]

    def spread(chain: Chain, actuated: ca.SX, start: ca.SX) -> Expressions:
        """Return the motors' positions after 1, 2, ... of the equal parts of their way."""
        from_ = ca.vertcat(*(start[joint] for joint in chain.actuated))
        moved = (from_ + (actuated - from_) * (k / TRACKING) for k in range(1, TRACKING))
        return Expressions(ca.densify(ca.vertcat(*moved)), ())

    def newton(chain: Chain, actuated: ca.SX, last: ca.SX) -> Expressions:
        """Move the passive joints by one step, shortened to ``LARGEST_STEP``; the next step places the motors anew."""
        q = _placed(chain, actuated, last)
        closure = Closure(chain, q)
        step = _newton_step(chain, closure)
        scale = 1 / ca.fmax(1, ca.sqrt(ca.sumsqr(step)) / LARGEST_STEP)
        moved = (q[k] if k in chain.actuated else q[k] + scale * step[k] for k in range(q.numel()))
        return _expressions(closure, ca.vertcat(*moved))

    def checked(chain: Chain, actuated: ca.SX, last: ca.SX) -> Expressions:
        """Make the last step; NaN unless it is short and the loops were closed before it."""
        q = _placed(chain, actuated, last)
        closure = Closure(chain, q)
        step = _newton_step(chain, closure)
        is_closed = (ca.sumsqr(step) <= LAST_STEP**2) * (closure.squared_gap() <= GAP**2)
        return _expressions(closure, q + step + zero_or_nan(is_closed))

    meaning = "One step of Newton's method for the passive joints"
    targets = [*parts, *(len(states) - len(parts)) * [motors]]
    steps = [
        StraightLine((after,), newton, (target, before), "newton_step", meaning=meaning)
        for target, before, after in zip(targets, (begin, *states), states, strict=False)
    ]
    first = StraightLine(tuple(parts), spread, (motors, begin), heading="the motors on their way")
    last = CloseLoops((result.array(chain),), checked, (motors, states[-1]), heading="the last step; NaN unless closed")
    return first, *steps, last


def _newton_step(chain: Chain, closure: Closure) -> ca.SX:
    """Return -C_p^-1 c among the entries of q, zero for the motors: after this step c is zero to first order."""
    return closure.passive_rates(closure.residual())[chain.base_joints :]


def _placed(chain: Chain, actuated: ca.SX, q: ca.SX) -> ca.SX:
    """Return joint positions with other positions of the motors."""
    values = [q[k] for k in range(q.numel())]
    for k, joint in enumerate(chain.actuated):
        values[joint] = actuated[k]
    return ca.vertcat(*values)


def _congruence(closure: Closure, matrix: ca.SX) -> ca.SX:
    """Return G^T matrix G of a symmetric matrix, symmetric."""
    G = closure.motion()
    return ca.triu2symm(ca.triu(ca.densify(G.T @ (matrix @ G))))
