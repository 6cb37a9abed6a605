# SPDX-License-Identifier: MIT
"""Kernels in motor coordinates, for robots with closed loops: the group ``motors``, and ``close``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import casadi as ca

from stiffgen.core.family import Asked, asked
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments, pose
from stiffgen.core.symbolic import stiffness_kernels as stiffness
from stiffgen.core.symbolic.arguments import Argument, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.core.symbolic.quantities import Normal, symmetric
from stiffgen.families.loops import programs as motor_programs
from stiffgen.families.loops.closure import Closure
from stiffgen.families.loops.draws import at_start, near_start

GROUP = "motors"
CLOSED = "q must close the loops (function close); NaN where the passive joints do not follow from the motors."
ORDER = "entries in the order of q"
_MULTIPLIERS = Argument(
    "multipliers", ("equations",), "N, N m", "forces (moments) that hold the loops closed: lambda, one per equation"
)
GRADIENT = Argument(
    "gradient", ("n",), "N m or N", "dU/dq of all joints", symbol="gq", per_configuration=True,
    draw=Normal(), largest="none",
)  # fmt: skip
HESSIAN = Argument(
    "hessian", ("n", "n"), "N m/rad", "d2U/dq2 of all joints; symmetric part is used", symbol="Hq",
    symmetric_part=True, per_configuration=True, draw=symmetric, largest="none",
)  # fmt: skip
MOTOR_VELOCITY = Argument(
    "motor_velocity", ("a",), "rad/s or m/s", f"rates of the motors, {ORDER}", symbol="da",
    per_configuration=True, draw=Normal(), largest="none",
    floating_meaning=f"twist of the base link (linear, angular) in its own axes, then rates of the motors, {ORDER}",
)  # fmt: skip
ACTUATED = Argument(
    "actuated", ("actuated",), "rad or m", f"positions of the motors, {ORDER}", symbol="a", per_configuration=True,
    draw=near_start, largest="none", turns=True,
)  # fmt: skip
START = Argument(
    "start", ("q",), "rad or m", "closed joint positions from which the motors move to theirs",
    symbol="start", per_configuration=True, draw=at_start, largest="none", turns=True,
)  # fmt: skip
MOTOR_TORQUE = Argument("torque", ("a",), "N m or N", f"-dU/da of the motors, {ORDER}")
MOTOR_GRADIENT = Argument("motor_gradient", ("a",), "N m or N", f"dU/da of the motors, {ORDER}")
MOTOR_STIFFNESS = Argument(
    "joint_stiffness", ("a", "a"), "N m/rad", "d2U/da2 of the motors, bitwise symmetric", symmetric=True
)
FORMULA = "d2U/da2 = G^T (d2U/dq2 - sum_k lambda_k d2c_k/dq2) G, lambda = C_p^-T dU/dp"
OF_TREE = {
    name: Argument(f"{name}_of_tree", shape, "", "", symmetric=len(shape) == 2)
    for name, shape in (("gradient", ("n",)), ("torque", ("n",)), ("joint_stiffness", ("n", "n")))
}


def motor_kernels(of: Asked) -> tuple[Kernel, ...]:
    """Return the kernels in motor coordinates; none for a robot without closed loops."""
    chain = of.chain
    if not chain.loops:
        return ()
    kernels = [*_of_loops(), *asked("motors, joints", of)]
    for tip in chain.tips:
        of_tip = [*_of_wrench(chain), *asked("motors, tip", of)]
        kernels += [replace(kernel, tip=tip if len(chain.tips) > 1 else None) for kernel in of_tip]
    if chain.masses:
        kernels += asked("motors, masses", of)
    return tuple(kernels)


def motor_kernel(
    name: str,
    inputs: tuple[Argument, ...],
    results: tuple[Argument, ...],
    summary: str,
    equation: str,
    program: Callable[[Chain], Program],
    note: str = "",
) -> Kernel:
    """Return a kernel of the group ``motors``, with the note that q must close the loops."""
    note = " ".join(filter(None, (note, CLOSED)))
    return Kernel(
        name=name,
        group=GROUP,
        arguments=inputs,
        results=results,
        summary=summary,
        equation=equation,
        program=program,
        note=note,
        batch=True,
    )


def _of_loops() -> tuple[Kernel, ...]:
    """Return the kernels that follow from the loops alone. a: coordinates of the motors; p: of the passive joints."""
    residual = Argument("residual", ("equations",), "m, rad", "c(q) of the independent equations, 0 if closed")
    jacobian = Argument("jacobian", ("n", "a"), "rad or m per rad or m", "G = dq/da, rows of the motors are those of 1")
    condition = Argument("condition", (), "1", "largest condition number of the passive joints' equations, 1 at best")

    def closure_kernel(result: Argument, summary: str, equation: str, value: Callable[[Closure], ca.SX]) -> Kernel:
        program = partial(motor_programs.of_closure, result=result, value=value, heading=equation)
        return motor_kernel(
            result.name, inputs=(arguments.Q,), results=(result,), summary=summary, equation=equation, program=program
        )

    return (
        _close(),
        replace(  # its note stands alone: the residual is right where loops are open, too
            closure_kernel(residual, "Equations of the closed loops.", "c(q)", Closure.residual),
            note="One per independent equation: distances of the two ends, rotations between them for welds.",
        ),
        closure_kernel(
            jacobian,
            "Rates of all joints at unit rates of the motors.",
            "G = [1; -C_p^-1 C_a], C = dc/dq",
            Closure.motion,
        ),
        closure_kernel(
            condition,
            "Condition number of the closed loops: how near the motors are to a singularity.",
            "|C| |C_p^-1| - (size - 1), norms of Frobenius, lengths in units of the hinges' levers",
            Closure.condition,
        ),
        motor_kernel(
            "multipliers",
            inputs=(arguments.Q, GRADIENT),
            results=(_MULTIPLIERS,),
            summary="Forces that hold the closed loops together under a load of the joints.",
            equation="lambda = C_p^-T dU/dp",
            program=partial(motor_programs.multipliers, result=_MULTIPLIERS, gradient=GRADIENT),
        ),
        motor_kernel(
            "from_joints",
            inputs=(arguments.Q, GRADIENT, HESSIAN),
            results=(MOTOR_GRADIENT, MOTOR_STIFFNESS),
            summary="Gradient and stiffness of the motors from those of any energy of the joints.",
            equation=f"dU/da = G^T dU/dq; {FORMULA}",
            program=lambda chain: motor_programs.reduction(
                chain, (), GRADIENT.array(chain), HESSIAN.array(chain), (MOTOR_GRADIENT, MOTOR_STIFFNESS), "GK"
            ),
        ),
    )


def _close() -> Kernel:
    """Return the kernel that closes the loops."""
    closed = Argument("closed", ("q",), "rad or m", "joint positions that close the loops; NaN if they do not")
    return Kernel(
        name="close",
        group=None,
        arguments=(ACTUATED, START),
        results=(closed,),
        summary="Joint positions of closed loops from those of the motors.",
        equation=f"Newton's method for the passive joints, {motor_programs.STEPS} steps of at most "
        f"{motor_programs.LARGEST_STEP} (rad, m)",
        program=partial(motor_programs.close, actuated=ACTUATED, start=START, result=closed),
        note=f"NaN unless the last step is at most {motor_programs.LAST_STEP:g} (rad, m). A linkage has several "
        "branches: the start decides. Take the last configuration in a control loop.",
        batch=True,
    )


def _of_wrench(chain: Chain) -> tuple[Kernel, ...]:
    """Return the counterparts of J^T F and of ``hybrid.joint_stiffness``."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
    wrench, task = arguments.wrench("hybrid"), arguments.task_stiffness("hybrid", symmetric_part=True)
    columns = Argument("J", (6, "n"), "", "")

    def torque_program(chain: Chain) -> Program:
        gradient = OF_TREE["gradient"].array(chain)
        tree = (
            *pose.jacobian(chain, "hybrid", columns)[:1],
            *motor_programs.wrench_gradient(chain, wrench.array(chain), gradient),
        )
        return motor_programs.reduction(chain, tree, gradient, None, (MOTOR_TORQUE,), "T")

    def stiffness_program(chain: Chain) -> Program:
        gradient, hessian = OF_TREE["gradient"].array(chain), OF_TREE["joint_stiffness"]
        tree = stiffness.joint_stiffness(chain, "hybrid", hessian, wrench, task)
        tree += motor_programs.wrench_gradient(chain, wrench.array(chain), gradient)
        return motor_programs.reduction(chain, tree, gradient, hessian.array(chain), (MOTOR_STIFFNESS,), "K")

    return (
        motor_kernel(
            "torque",
            inputs=(*configuration, wrench),
            results=(MOTOR_TORQUE,),
            summary="Torque that a spring with this wrench exerts on the motors.",
            equation="-dU/da = -G^T J^T F",
            program=torque_program,
        ),
        motor_kernel(
            "joint_stiffness",
            inputs=(*configuration, wrench, task),
            results=(MOTOR_STIFFNESS,),
            summary="Joint stiffness of the motors under a wrench and a task stiffness.",
            equation=f"{FORMULA}, d2U/dq2 = dJ^T/dq . F + J^T (K + Gamma F) J",
            program=stiffness_program,
        ),
    )


def from_torque(
    chain: Chain, tree: Program, hessian: Argument | None, results: tuple[Argument, ...], parts: str
) -> Program:
    """Return the reduction of a program that writes -dU/dq as torque of the tree."""
    torque = OF_TREE["torque"].array(chain)
    of_tree = hessian.array(chain) if hessian else None
    return motor_programs.reduction(chain, tree, torque, of_tree, results, parts, sign=-1)
