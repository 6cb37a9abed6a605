# SPDX-License-Identifier: MIT
"""Kernel table: the only list of generated functions, from which stiffgen makes every output.

A new kernel is one record: name, arguments with shapes and units, results, summary, equation and program. Header,
source, Python module, stubs, documentation tables, ``casadi.Function`` objects, benchmarks and the parametrised tests
follow from the record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from stiffgen.errors import ChainError, PotentialError, listed, printable
from stiffgen.names import CPP_NAMES
from stiffgen.robot.chain import Chain, Tip
from stiffgen.symbolic import arguments, joint_potentials, manipulability, programs, quantities
from stiffgen.symbolic.arguments import POSE, Argument, configuration_arguments
from stiffgen.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.symbolic.direction_gradient import stiffness_direction_gradient
from stiffgen.symbolic.dynamics_kernels import dynamics_kernels
from stiffgen.symbolic.joint_potentials import JOINT_POTENTIALS, JointPotential
from stiffgen.symbolic.joint_potentials import Part as JointPart
from stiffgen.symbolic.kernel import PACKED, Kernel
from stiffgen.symbolic.motor_kernels import GROUP, motor_kernels
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.products import products
from stiffgen.symbolic.program import Program
from stiffgen.symbolic.springs import TRACE, Spring
from stiffgen.symbolic.steps import ArgumentSlice, Sum, Term

__all__ = [
    "KERNELS",
    "MAX_BATCH_JOINTS",
    "PACKED",
    "RESERVED_NAMES",
    "Kernel",
    "chain_kernels",
]

_Steps = Callable[[Chain], Program]


_TWIST_FRAME = {
    "body": "velocity of the tip's origin and angular velocity, both in tip axes (Pinocchio: LOCAL)",
    "spatial": "velocity of the point passing the {reference}'s origin and angular velocity, both in {reference} axes "
    "(Pinocchio: WORLD)",
    "hybrid": "velocity of the tip's origin and angular velocity, both in {reference} axes "
    "(Pinocchio: LOCAL_WORLD_ALIGNED)",
}
_SPATIAL_NOTE = (
    "The spatial connection differs from the body and hybrid one: the same task stiffness and wrench, moved to the "
    "{reference}'s origin, give a different joint stiffness."
)


def _jacobian_kernels(rep: Representation, configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of the Jacobian and of its derivative in one representation."""
    jacobian = Argument.referred(
        "jacobian", (6, "n"), "m, rad per rad or m", f"column i: twist of joint i, {_TWIST_FRAME[rep]}",
        blocks=quantities.TWISTS,
    )  # fmt: skip
    derivative = Argument(
        "jacobian_transpose_derivative", ("n", "n", 6), "per rad or m",
        "block i is dJ^T/dq_i: entry [i, b, k] = dJ[k, b]/dq_i",
    )  # fmt: skip
    return (
        Kernel(
            "jacobian", rep, configuration, (jacobian,),
            f"Jacobian in {rep} representation.",
            "xi = J dq/dt, twist linear first",
            partial(programs.jacobian, representation=rep, result=jacobian),
            batch=True,
        ),
        Kernel(
            "jacobian_transpose_derivative", rep, configuration, (derivative,),
            "Derivative of the transposed Jacobian with respect to each joint position.",
            "dJ^T/dq, in closed form from Lie brackets",
            partial(programs.jacobian_derivative, representation=rep, result=derivative),
        ),
    )  # fmt: skip


def _stiffness_kernels(rep: Representation, configuration: tuple[Argument, ...], reference: str) -> tuple[Kernel, ...]:
    """Return the kernels of the stiffness in one representation; ``reference`` names the frame of the moments."""
    wrench = arguments.wrench(rep)
    upper = arguments.task_stiffness(rep, triangle=True)
    full = arguments.task_stiffness(rep, triangle=False)
    spatial = _SPATIAL_NOTE.format(reference=reference) if rep == "spatial" else ""
    kinematic = Argument("kinematic_stiffness", ("n", "n"), "N m/rad", "column i is dJ^T/dq_i F; not symmetric")
    correction = Argument(
        "connection_correction", (6, 6), "N, N m", "(Gamma F)_ij = sum_k Gamma^k_ij F_k, added to the task stiffness",
        blocks=quantities.STIFFNESS,
    )  # fmt: skip
    joint = Argument("joint_stiffness", ("n", "n"), "N m/rad", "bitwise symmetric", symmetric=True)
    uncorrected = Argument("joint_stiffness_uncorrected", ("n", "n"), "N m/rad", "not symmetric under a moment")
    return (
        Kernel(
            "kinematic_stiffness", rep, (*configuration, wrench), (kinematic,),
            "Kinematic stiffness: derivative of the joint torques of a constant wrench with respect to q.",
            "Kkin = dJ^T/dq . F (Lachner, Nah, Hogan 2025, central equation, first term)",
            partial(programs.kinematic_stiffness, representation=rep, result=kinematic, wrench=wrench),
        ),
        Kernel(
            "connection_correction", rep, (wrench,), (correction,),
            "Christoffel-symbol correction of the task stiffness.",
            "Gamma F (Lachner, Nah, Hogan 2025, central equation and appendix)",
            partial(programs.connection_correction, representation=rep, result=correction, wrench=wrench),
            spatial,
        ),
        Kernel(
            "joint_stiffness", rep, (*configuration, wrench, upper), (joint,),
            "Symmetric joint stiffness with the correction by the connection.",
            "Kq = dJ^T/dq . F + J^T (K + Gamma F) J (Lachner, Nah, Hogan 2025, central equation)",
            partial(programs.joint_stiffness, representation=rep, result=joint, wrench=wrench, task_stiffness=upper),
            spatial,
            batch=True,
        ),
        Kernel(
            "joint_stiffness_uncorrected", rep, (*configuration, wrench, full), (uncorrected,),
            "Conventional joint stiffness, without the correction; for comparison.",
            "dJ^T/dq . F + J^T K J",
            partial(programs.joint_stiffness_uncorrected, representation=rep, result=uncorrected, wrench=wrench,
                task_stiffness=full,
            ),
        ),
    )  # fmt: skip


def _manipulability_kernels(configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of Yoshikawa's measure; ``configuration`` is that of body representation."""
    measure = Argument("manipulability", (), "m^3", "w, zero at a singularity; other units with fewer than six joints")
    gradient = Argument("manipulability_gradient", ("q",), "m^3/rad", "dw/dq, zero where w is zero")
    jacobian = "J the body or hybrid Jacobian of the joints"
    return (
        Kernel(
            "manipulability", None, configuration, (measure,),
            "Manipulability of the tip.",
            f"w = sqrt(det(J J^T)), or sqrt(det(J^T J)) with fewer than six joints; {jacobian} (Yoshikawa 1985)",
            partial(manipulability.manipulability, result=measure),
            batch=True,
        ),
        Kernel(
            "manipulability_gradient", None, configuration, (gradient,),
            "Gradient of the manipulability with respect to the joint positions.",
            "dw/dq_i = w tr(J^+ dJ/dq_i)",
            partial(manipulability.manipulability_gradient, result=gradient),
            batch=True,
            is_gradient=True,
        ),
    )  # fmt: skip


DIRECTION = Argument(
    "direction", ("n",), "1", "v, held", symbol="v", per_configuration=True, draw=quantities.Normal(), largest="none"
)


def _direction_gradient_kernel(configuration: tuple[Argument, ...]) -> Kernel:
    """Return the kernel of the gradient of the hybrid joint stiffness along a direction."""
    F, K = arguments.wrench("hybrid"), arguments.task_stiffness("hybrid", triangle=True)
    result = Argument(
        "stiffness_direction_gradient",
        ("n",),
        "N m/rad^2",
        "gradient of v^T Kq v with respect to q",
        floating_meaning="gradient of v^T Kq v: covector of the base link's twist in its own axes, then the joints'",
    )
    program = partial(stiffness_direction_gradient, wrench=F, task_stiffness=K, direction=DIRECTION, result=result)
    return Kernel(
        "stiffness_direction_gradient", "hybrid", (*configuration, F, K, DIRECTION), (result,),
        "Gradient of the joint stiffness along a direction; wrench, task stiffness and direction are held.",
        "d(v^T Kq v)/dq; with a unit eigenvector v of Kq, the gradient of its eigenvalue",
        partial(program, representation="hybrid"),
        batch=True,
        is_gradient=True,
    )  # fmt: skip


_ENERGY = Argument("energy", (), "J", "energy U of the spring, 0 at the equilibrium")
_SPRING_WRENCH = Argument.referred(
    "wrench", (6,), "N, N m",
    "F = dU, (force, moment) that balances the spring at the tip, in {reference} axes, moment about the tip's origin",
    blocks=quantities.WRENCH,
)  # fmt: skip
_SPRING_TASK_STIFFNESS = Argument.referred(
    "task_stiffness", (6, 6), "N/m, N, N m",
    "covariant Hessian of U on twists (linear, angular), {reference} axes at the tip's origin; bitwise symmetric",
    symmetric=True, blocks=quantities.STIFFNESS,
)  # fmt: skip
_SPRING_TORQUE = Argument("torque", ("n",), "N m or N", "-dU/dq: torque that the spring exerts on the joints")
_SPRING_JOINT_STIFFNESS = Argument(
    "joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2 = -d torque/dq, bitwise symmetric", symmetric=True
)


def _spring_kernels(spring: Spring, configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels that follow from one energy; one of them returns torque and tangent in one call."""
    energy, torque, joint = _ENERGY, _SPRING_TORQUE, _SPRING_JOINT_STIFFNESS
    terms, joint_terms = programs.spring_terms, programs.spring_joint_terms
    hessian = "Kq = dJ^T/dq . F + J^T (K + Gamma F) J with F = dU and K the covariant Hessian"

    def kernel(
        name: str, results: tuple[Argument, ...], summary: str, equation: str, program: _Steps, part_of: str = ""
    ) -> Kernel:
        arguments = (*configuration, *spring.parameters)
        return Kernel(
            name,
            spring.name,
            arguments,
            results,
            summary,
            equation,
            program,
            spring.domain,
            batch=True,
            part_of=part_of,
        )

    return (
        kernel(
            "energy", (energy,), "Energy of the spring between the tip and the equilibrium.", spring.equation,
            partial(terms, spring=spring, results=(energy,), parts="U"),
        ),
        kernel(
            "wrench", (_SPRING_WRENCH,), "Wrench of the spring: gradient of its energy.", "F = dU",
            partial(terms, spring=spring, results=(_SPRING_WRENCH,), parts="F"),
        ),
        kernel(
            "task_stiffness", (_SPRING_TASK_STIFFNESS,),
            "Task stiffness of the spring: covariant Hessian of its energy.",
            "K_ij = d2/dx_i dx_j U(p + v, exp([w]) R) at x = (v, w) = 0",
            partial(terms, spring=spring, results=(_SPRING_TASK_STIFFNESS,), parts="K"),
        ),
        kernel(
            "torque", (torque,), "Joint torque of the spring.", "-dU/dq = -J^T F with F = dU",
            partial(joint_terms, spring=spring, torque=torque),
        ),
        kernel(
            "joint_stiffness", (joint,), "Joint stiffness of the spring: the exact tangent of its torque.",
            f"d2U/dq2 = {hessian} (Lachner, Nah, Hogan 2025)",
            partial(joint_terms, spring=spring, joint_stiffness=joint),
            part_of="linearization",
        ),
        kernel(
            "linearization", (energy, torque, joint),
            "Energy, torque and joint stiffness of the spring in one call.",
            f"U, -dU/dq = -J^T F, d2U/dq2 = {hessian}",
            partial(joint_terms, spring=spring, energy=energy, torque=torque, joint_stiffness=joint),
        ),
    )  # fmt: skip


def _tip_kernels(
    tip: Tip | None, springs: tuple[Spring, ...], *, runtime_tool: bool, floating: bool = False
) -> tuple[Kernel, ...]:
    configuration = configuration_arguments(runtime_tool=runtime_tool, floating=floating)
    reference = "world" if floating else "base"
    seen_from_tip = configuration_arguments(runtime_tool=runtime_tool)
    pose = Kernel(
        "forward_kinematics", None, configuration, (POSE,),
        f"Pose of the tip in the {reference} frame.",
        "product of joint poses",
        programs.forward_kinematics,
    )  # fmt: skip
    kernels = [
        pose,
        *_manipulability_kernels(seen_from_tip),
    ]
    for rep in REPRESENTATIONS:
        seen = seen_from_tip if rep == "body" else configuration
        kernels += [*_jacobian_kernels(rep, seen), *_stiffness_kernels(rep, seen, reference)]
    kernels.append(_direction_gradient_kernel(configuration))
    for spring in springs:
        kernels += _spring_kernels(spring, configuration)
    note = "'Tip' means the frame of the tool at tool_pose." if runtime_tool else ""
    return tuple(replace(kernel, tip=tip, note=" ".join(filter(None, (kernel.note, note)))) for kernel in kernels)


def _total_program(chain: Chain, of: Kernel, inputs: tuple[Argument, ...], results: tuple[Argument, ...]) -> Program:
    """Return the sum of a kernel's results over the tips.

    Every argument outside the configuration holds one value per tip.
    """
    arrays = [(argument.array(chain), argument.of_configuration) for argument in inputs]
    terms = []
    for index, tip in enumerate(chain.tips):
        kernel = replace(of, tip=tip)
        parameters = [argument.array(chain) for argument in kernel.arguments]
        slices = (ArgumentSlice(array, None if shared else index) for array, shared in arrays)
        pairs = tuple(zip(parameters, slices, strict=True))
        terms.append(Term(kernel.qualified_name, kernel.scope(chain), kernel.steps(chain), pairs))
    outputs = tuple(result.array(chain) for result in results)
    return (Sum(outputs, tuple(result.name for result in of.results), tuple(terms)),)


def _total(chain: Chain, of: Kernel, summary: str, note: str, spring: Spring | None = None) -> Kernel:
    """Return the kernel that sums the results of a kernel over the tips; ``spring`` is the kernel's, if any."""
    names = [tip.name for tip in chain.tips]
    inputs = tuple(each if each.of_configuration else each.of_all_tips(names) for each in of.arguments)
    results = tuple(
        replace(
            result,
            name=f"{result.name}_total",
            meaning="sum over the tips" + (", bitwise symmetric" if result.symmetric else ""),
        )
        for result in of.results
    )
    by_tips = partial(_total_program, of=of, inputs=inputs, results=results)
    one_pass: Callable[[Chain], Program]
    if spring:
        parts = {result.name: total for result, total in zip(of.results, results, strict=True)}
        one_pass = partial(programs.spring_total, spring=spring, inputs=inputs, results=parts)
    else:
        representation = next(each for each in REPRESENTATIONS if each == of.group)
        (result,) = results
        one_pass = partial(programs.joint_stiffness_total, representation=representation, result=result, inputs=inputs)
    equation = f"sum over the tips of {of.equation}"
    return Kernel(
        f"{of.name}_total", of.group, inputs, results, summary, equation, one_pass, note, batch=True, by_tips=by_tips
    )


def _total_kernels(chain: Chain, springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    contacts = (
        "Symmetric joint stiffness of the contacts at all tips, added up.",
        "For a tip without contact, pass zero wrench and task stiffness.",
    )
    of_springs = ("{summary} Sum over the springs at all tips.", "For a tip without a spring, pass zero stiffnesses.")
    totals = []
    for kernel in _tip_kernels(None, springs, runtime_tool=chain.runtime_tool, floating=chain.floating):
        if kernel.group in REPRESENTATIONS:
            if kernel.name == "joint_stiffness":
                totals.append(_total(chain, kernel, *contacts))
        elif kernel.group and kernel.name in ("energy", "torque", "joint_stiffness", "linearization"):
            spring = next(each for each in springs if each.name == kernel.group)
            totals.append(_total(chain, kernel, of_springs[0].format(summary=kernel.summary), of_springs[1], spring))
    return tuple(totals)


def _joint_potential_kernels(potential: JointPotential) -> tuple[Kernel, ...]:
    energy = Argument("energy", (), "J", "energy U of the potential")
    torque = Argument("torque", ("n",), "N m or N", "-dU/dq: torque that the potential exerts on the joints")
    joint = Argument(
        "joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2 = -d torque/dq, diagonal", symmetric=True
    )  # fmt: skip

    def kernel(result: Argument, summary: str, equation: str, part: JointPart) -> Kernel:
        program = partial(joint_potentials.program, potential=potential, part=part, result=result)
        inputs = (arguments.Q, *potential.parameters)
        return Kernel(
            part, potential.name, inputs, (result,), f"{summary} {potential.title}.", equation, program,
            potential.domain, batch=True,
        )  # fmt: skip

    return (
        kernel(energy, "Energy of", potential.equation, "energy"),
        kernel(torque, "Joint torque of", f"-dU/dq, {potential.equation}", "torque"),
        kernel(joint, "Joint stiffness of", f"d2U/dq2, {potential.equation}", "joint_stiffness"),
    )


_OF_JOINTS = tuple(kernel for potential in JOINT_POTENTIALS for kernel in _joint_potential_kernels(potential))


def _serial(
    springs: tuple[Spring, ...] = (TRACE,), *, runtime_tool: bool = False, masses: bool = True, floating: bool = False
) -> tuple[Kernel, ...]:
    first, *others = _tip_kernels(None, springs, runtime_tool=runtime_tool, floating=floating)
    dynamics = dynamics_kernels(runtime_tool=runtime_tool, floating=floating) if masses else ()
    return (first, *dynamics, *others, *_OF_JOINTS)


KERNELS: tuple[Kernel, ...] = _serial()
"""Kernels of a chain with one tip, in the order of printing."""

RESERVED_NAMES = frozenset(kernel.group or kernel.name for kernel in KERNELS) | {PACKED.lstrip("_"), GROUP, "close"}
"""Names in a robot's module that are forbidden for tips and potentials."""

_ARGUMENT_NAMES = frozenset(
    argument.name
    for kernel in KERNELS
    for argument in (*kernel.arguments, *kernel.results, arguments.BASE_POSE, arguments.TOOL_POSE)
)
_FORBIDDEN_NAMES = RESERVED_NAMES | _ARGUMENT_NAMES | {kernel.name for kernel in KERNELS} | {"impedance", *CPP_NAMES}
"""Names that are forbidden for potentials."""


def _check_names(springs: tuple[Spring, ...]) -> None:
    """Raise PotentialError if a user's potential has a name of the kernel table."""
    for spring in springs:
        if spring.name in _FORBIDDEN_NAMES:
            raise PotentialError(
                f"potential {spring.name}: the name is taken by stiffgen's own functions; give it another"
            )


MAX_BATCH_JOINTS = 24
"""Largest number of moving joints with batch functions, which would double a C source of nearly a megabyte."""


def chain_kernels(chain: Chain, options: SpringOptions | None = None) -> tuple[Kernel, ...]:
    """Return the kernels of a chain in the order of printing; ``options`` adds springs to the default.

    A chain without masses has no kernels of dynamics. With several tips, each tip has its own kernels, and totals add
    up the joint stiffnesses of all contacts and the springs at all tips.
    """
    options = options or SpringOptions()
    springs = options.springs()
    _check_names(springs[len(springs) - len(options.potentials) :])
    kernels = _select((*_all_kernels(chain, springs), *motor_kernels(chain, springs)), options.groups)
    if chain.loops:  # vectors of joints also hold coordinates, of which a path to a tip has more than joints
        kernels = tuple(replace(each, of_masses=True) if _of_coordinates(each) else each for each in kernels)
    if chain.floating:
        kernels = tuple(map(_on_floating_base, kernels))
    if options.derivatives:
        kernels = (*kernels, *products(kernels))
    if options.batches and len(chain.joints) <= MAX_BATCH_JOINTS:
        return kernels
    return tuple(replace(kernel, batch=False) for kernel in kernels)


def _of_coordinates(kernel: Kernel) -> bool:
    """Return whether a kernel, or the kernel of the tree behind it, loops over the coordinates."""
    names = [potential.name for potential in JOINT_POTENTIALS]
    of_motors = [f"{name}_{part}" for name in names for part in ("torque", "joint_stiffness")]
    return kernel.group in names or (kernel.group == GROUP and kernel.name in of_motors)


def _select(kernels: tuple[Kernel, ...], groups: tuple[str, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of some groups, always with the tips' poses; without groups return all kernels.

    Raises:
        ChainError: the robot has no such group or function.

    """
    known = dict.fromkeys(choice for kernel in kernels for choice in kernel.choices)
    unknown = [group for group in groups if group not in known]
    if unknown:
        raise ChainError(
            f"--kernels {printable(unknown[0])}: this robot has no such group or function; groups are "
            f"{listed(list(dict.fromkeys(kernel.choices[0] for kernel in kernels)))}, a function is "
            "GROUP.NAME; of dynamics, its name alone"
        )
    if not groups:
        return kernels
    return tuple(
        kernel for kernel in kernels if kernel.name == "forward_kinematics" or set(kernel.choices) & set(groups)
    )


def _on_floating_base(kernel: Kernel) -> Kernel:
    """Return a kernel whose arguments and results have their meanings for a floating base."""
    return replace(
        kernel,
        arguments=tuple(argument.on_floating_base() for argument in kernel.arguments),
        results=tuple(result.on_floating_base() for result in kernel.results),
    )


def _all_kernels(chain: Chain, springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    if len(chain.tips) == 1:
        return _serial(springs, runtime_tool=chain.runtime_tool, masses=chain.masses, floating=chain.floating)
    options = {"runtime_tool": chain.runtime_tool, "floating": chain.floating}
    per_tip = [kernel for tip in chain.tips for kernel in _tip_kernels(tip, springs, **options)]
    of_masses = dynamics_kernels(chain.tips, **options) if chain.masses else ()
    return (*of_masses, *per_tip, *_total_kernels(chain, springs), *_OF_JOINTS)
