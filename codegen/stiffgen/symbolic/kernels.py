"""The Kernel table: the only list of what is computed. Every output of stiffgen is made from it.

Adding a kernel is one record: name, arguments with shapes and units, result, one-line meaning, equation, and the
program that computes it. Header, source, Python module, stubs, documentation tables, ``casadi.Function`` objects,
benchmarks and the parametrised tests follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca

from stiffgen.robot.chain import Chain, Tip
from stiffgen.symbolic import dynamics, kinematics, stiffness
from stiffgen.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.symbolic.program import Array, Gather, Map, Operand, Over, Part, Program, Recursion, Sum, Term

Extent = int | str
"""A fixed extent, or "n", the number of coordinates."""


@dataclass(frozen=True)
class Argument:
    """An argument or result of a kernel: name, row-major shape, unit and meaning.

    ``symmetric`` says of a result that it is a symmetric matrix, to the last bit.
    """

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    symmetric: bool = False

    def array(self, chain: Chain) -> Array:
        """The argument as an array of the chain's sizes."""
        return Array(self.name, tuple(chain.dof if extent == "n" else int(extent) for extent in self.shape))


@dataclass(frozen=True)
class Kernel:
    """One function of every generated robot.

    ``representation`` is None for what does not depend on it, ``tip`` for what belongs to no single tip of several
    (and for the functions of an only tip). ``equation`` names what the kernel evaluates and its source; ``note`` says
    what a caller must know beyond shapes and units.
    """

    name: str
    representation: Representation | None
    arguments: tuple[Argument, ...]
    result: Argument
    summary: str
    equation: str
    program: Callable[[Chain], Program]
    note: str = ""
    tip: Tip | None = None
    batch: bool = False
    """Whether C has it for many configurations in one call, too: NAME_..._batch."""

    @property
    def qualified_name(self) -> str:
        """``hybrid_joint_stiffness``, ``left_hand_hybrid_joint_stiffness`` or the bare name."""
        tip = self.tip.name if self.tip else None
        return "_".join(part for part in (tip, self.representation, self.name) if part)

    def scope(self, chain: Chain) -> Chain:
        """The chain that the kernel's program is about: the branch to its tip, or the whole."""
        return chain.branch(self.tip) if self.tip else chain

    def steps(self, chain: Chain) -> Program:
        """The program for a chain, to be run on its :meth:`scope`."""
        return self.program(self.scope(chain))

    def signature(self, chain: Chain) -> str:
        """Shapes as a NumPy generalised-ufunc signature, "(7),(6)->(7,7)"."""
        shapes = [argument.array(chain).shape for argument in (*self.arguments, self.result)]
        inside = ["(" + ",".join(map(str, shape)) + ")" for shape in shapes]
        return ",".join(inside[:-1]) + "->" + inside[-1]


_Q = Argument("q", ("n",), "rad or m", "joint positions, base to tip")
_TOOL_POSE = Argument(
    "tool_pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tool in the tip's frame; R must be a rotation"
)
_WRENCH_FRAME = {
    "body": "in tip axes, moment about the tip's origin",
    "spatial": "in base axes, moment about the base's origin",
    "hybrid": "in base axes, moment about the tip's origin",
}
_STIFFNESS_FRAME = {
    "body": "tip axes at the tip's origin",
    "spatial": "base axes at the base's origin",
    "hybrid": "base axes at the tip's origin",
}
_TWIST_FRAME = {
    "body": "velocity of the tip's origin and angular velocity, both in tip axes (Pinocchio: LOCAL)",
    "spatial": "velocity of the point passing the base's origin and angular velocity, both in base axes "
    "(Pinocchio: WORLD)",
    "hybrid": "velocity of the tip's origin and angular velocity, both in base axes (Pinocchio: LOCAL_WORLD_ALIGNED)",
}
_SPATIAL_NOTE = (
    "The spatial connection is not the body and hybrid one: the same task stiffness and wrench, moved to the base's "
    "origin, give another joint stiffness."
)


def _wrench(representation: Representation) -> Argument:
    return Argument(
        "wrench",
        (6,),
        "N, N m",
        f"(force, moment) that the environment applies to the robot, {_WRENCH_FRAME[representation]}",
    )


def _task_stiffness(representation: Representation, reading: str) -> Argument:
    return Argument(
        "task_stiffness",
        (6, 6),
        "N/m, N, N m",
        f"stiffness on twists (linear, angular), {_STIFFNESS_FRAME[representation]}; {reading}",
    )


def _posture(chain: Chain) -> tuple[Array, ...]:
    """What pose recursions take: q, and the tool's pose where it is known at run time only."""
    arguments = (_Q, _TOOL_POSE) if chain.runtime_tool else (_Q,)
    return tuple(argument.array(chain) for argument in arguments)


def _columns(chain: Chain, representation: Representation, name: str = "J") -> tuple[Recursion, Array]:
    array = Array(name, (6, len(chain.joints)))
    expressions = partial(kinematics.joint_jacobian, representation=representation)
    heading = "Jacobian columns: rows 0..2 linear, 3..5 angular"
    return Recursion((array,), expressions, _posture(chain), f"{representation}_columns", heading), array


def _over_joints(chain: Chain, result: Argument, steps: Callable[[Array], Program], *, mirror: bool = False) -> Program:
    """Let ``steps`` write a result [i, j] for pairs of joints, then gather into coordinates where joints mimic."""
    target = result.array(chain)
    if not chain.coupled:
        return steps(target)
    m = len(chain.joints)
    joints = Array(f"{target.name}_of_joints", (m, m, *target.shape[2:]))
    return (*steps(joints), Gather(joints, target, mirror=mirror))


def _pairs(left: Array, right: Array, over: Over, target: Array, comment: str, *, mirror: bool = False) -> Map:
    return Map(comment, over, Operand(target, "ij"), (Operand(left, "i"), Operand(right, "j")), ca.dot, mirror)


def _forward_kinematics(chain: Chain) -> Program:
    pose = _POSE.array(chain)
    return (Recursion((pose,), kinematics.forward_kinematics, _posture(chain), heading="pose of the tip"),)


def _jacobian(chain: Chain, representation: Representation, result: Argument) -> Program:
    target = result.array(chain)
    if not chain.coupled:
        return (_columns(chain, representation, target.name)[0],)
    recursion, J = _columns(chain, representation)
    return recursion, Gather(J, target, columns=True)


def _jacobian_derivative(chain: Chain, representation: Representation, result: Argument) -> Program:
    def steps(target: Array) -> Program:
        recursion, J = _columns(chain, representation)
        diagonal_outward = stiffness.diagonal_is_outward(representation)

        def half(over: Over, outward: bool) -> Map:
            def body(moving: ca.SX, column: ca.SX) -> ca.SX:
                return kinematics.jacobian_column_derivative(representation, column, moving, by_is_outward=outward)

            side = "beyond" if outward else "before"
            return Map(
                f"dJ_j/dq_i for the joints i {side} joint j",
                over,
                Operand(target, "ij"),
                (Operand(J, "i"), Operand(J, "j")),
                body,
            )

        outer: Over = "i>=j" if diagonal_outward else "i>j"
        inner: Over = "i<j" if diagonal_outward else "i<=j"
        return recursion, half(inner, False), half(outer, True)

    return _over_joints(chain, result, steps)


def _two_sided(
    J: Array,
    target: Array,
    representation: Representation,
    covector: Callable[..., ca.SX],
    operands: tuple[Operand, ...],
    names: tuple[str, str, str],
) -> Program:
    """target_ij = J_i . u_j with one covector u_j for the joints j beyond i and one for those before."""
    symbol, left_hand_side, formula = names
    diagonal_outward = stiffness.diagonal_is_outward(representation)
    beyond: Over = "i<=j" if diagonal_outward else "i<j"
    before: Over = "i>j" if diagonal_outward else "i>=j"
    maps: list[Map] = []
    for side, over, outward in (("beyond", beyond, True), ("before", before, False)):
        u = Array(f"{symbol}_{side}", J.shape)
        comment = f"{symbol}_j = {formula}, for the joints j {side} joint i"
        body = partial(covector, representation, outward=outward)
        maps.append(Map(comment, "j", Operand(u, "j"), (Operand(J, "j"), *operands), body))
        maps.append(_pairs(J, u, over, target, f"{left_hand_side}_ij = J_i . {symbol}_j for {over}"))
    return tuple(maps)


def _kinematic_stiffness(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    def steps(target: Array) -> Program:
        recursion, J = _columns(chain, representation)
        operands = (Operand(wrench.array(chain), ""),)
        names = ("z", "Kkin", "gradient of (dJ_i/dq_j) . F by J_i")
        covector = stiffness.kinematic_covector
        return (recursion, *_two_sided(J, target, representation, covector, operands, names))

    return _over_joints(chain, result, steps)


def _joint_stiffness_uncorrected(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    def steps(target: Array) -> Program:
        recursion, J = _columns(chain, representation)
        y = Array("y", J.shape)
        matrix = Operand(task_stiffness.array(chain), "")
        product = Map("y_j = K J_j", "j", Operand(y, "j"), (matrix, Operand(J, "j")), ca.mtimes)
        operands = (Operand(wrench.array(chain), ""), Operand(y, "j"))
        names = ("u", "Kq", "y_j + gradient of (dJ_i/dq_j) . F by J_i")
        covector = stiffness.uncorrected_covector
        return (recursion, product, *_two_sided(J, target, representation, covector, operands, names))

    return _over_joints(chain, result, steps)


def _joint_stiffness(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    def steps(target: Array) -> Program:
        recursion, J = _columns(chain, representation)
        A, u = Array("A", (6, 6)), Array("u", J.shape)
        force = Operand(wrench.array(chain), "")
        half: Over = "i<=j" if stiffness.diagonal_is_outward(representation) else "i>=j"
        return (
            recursion,
            Map(
                "A = K + Gamma F, reading the upper triangle of K",
                "",
                Operand(A, ""),
                (force, Operand(task_stiffness.array(chain), "")),
                partial(stiffness.corrected_task_stiffness, representation),
            ),
            Map(
                "u_j = A J_j" + (" + gradient of (dJ_i/dq_j) . F by J_i" if representation == "hybrid" else ""),
                "j",
                Operand(u, "j"),
                (Operand(J, "j"), force, Operand(A, "")),
                partial(stiffness.stiffness_covector, representation),
            ),
            _pairs(J, u, half, target, f"Kq_ij = J_i . u_j for {half}, mirrored", mirror=True),
        )

    return _over_joints(chain, result, steps, mirror=True)


def _connection_correction(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    return (
        Map(
            "Gamma F",
            "",
            Operand(result.array(chain), ""),
            (Operand(wrench.array(chain), ""),),
            partial(stiffness.gamma_F, representation),
        ),
    )


MAX_UNROLLED_MASS_JOINTS = 12
"""Up to here a mass matrix without loops has fewer statements than one with loops."""


def _mass_matrix(chain: Chain, result: Argument) -> Program:
    m = len(chain.joints)
    # Sums over sliding joints can overflow: only the loops' results are guarded against infinity.
    if m <= MAX_UNROLLED_MASS_JOINTS and not chain.coupled and not any(joint.prismatic for joint in chain.joints):
        flat = Array(result.name, (m * m,))
        heading = "M_ij = J_i . h_j: the turn about joint i's axis, seen from its link"
        return (Recursion((flat,), dynamics.mass_matrix, (_Q.array(chain),), heading=heading),)

    def steps(target: Array) -> Program:
        J, h = Array("J", (6, m)), Array("h", (6, m))
        heading = "Jacobian columns J and the momenta h that they cause"
        recursion = Recursion((J, h), dynamics.columns_and_momenta, (_Q.array(chain),), heading=heading)
        if all(joint.parent == index - 1 for index, joint in enumerate(chain.joints)):
            return recursion, _pairs(J, h, "i<=j", target, "M_ij = J_i . h_j for i<=j, mirrored", mirror=True)
        nothing = Map(
            "joints of different branches: 0", "i<=j", Operand(target, "ij"), (), lambda: ca.SX(0), mirror=True
        )
        over: Over = "i on the way to j"
        return recursion, nothing, _pairs(J, h, over, target, f"M_ij = J_i . h_j for {over}, mirrored", mirror=True)

    return _over_joints(chain, result, steps, mirror=True)


def _representation_kernels(rep: Representation, posture: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    wrench = _wrench(rep)
    upper = _task_stiffness(rep, "symmetric, only the upper triangle is read")
    full = _task_stiffness(rep, "all 36 entries are read")
    spatial = _SPATIAL_NOTE if rep == "spatial" else ""
    jacobian = Argument("jacobian", (6, "n"), "m, rad per rad or m", f"column i: twist of joint i, {_TWIST_FRAME[rep]}")
    derivative = Argument(
        "jacobian_transpose_derivative",
        ("n", "n", 6),
        "per rad or m",
        "block i is dJ^T/dq_i: entry [i, b, k] = dJ[k, b]/dq_i",
    )
    kinematic = Argument("kinematic_stiffness", ("n", "n"), "N m/rad", "column i is dJ^T/dq_i F; not symmetric")
    correction = Argument(
        "connection_correction", (6, 6), "N, N m", "(Gamma F)_ij = sum_k Gamma^k_ij F_k, added to the task stiffness"
    )
    joint = Argument("joint_stiffness", ("n", "n"), "N m/rad", "bitwise symmetric", symmetric=True)
    uncorrected = Argument("joint_stiffness_uncorrected", ("n", "n"), "N m/rad", "not symmetric under a moment")
    return (
        Kernel(
            "jacobian", rep, posture, jacobian,
            f"Jacobian in {rep} representation.",
            "xi = J dq/dt, twist linear first",
            partial(_jacobian, representation=rep, result=jacobian),
            batch=True,
        ),
        Kernel(
            "jacobian_transpose_derivative", rep, posture, derivative,
            "Derivative of the transposed Jacobian by every joint position.",
            "dJ^T/dq, closed form through Lie brackets",
            partial(_jacobian_derivative, representation=rep, result=derivative),
        ),
        Kernel(
            "kinematic_stiffness", rep, (*posture, wrench), kinematic,
            "Kinematic stiffness: how the joint torques of a constant wrench change with posture.",
            "Kkin = dJ^T/dq . F (Lachner, Nah, Hogan 2025, central equation, first term)",
            partial(_kinematic_stiffness, representation=rep, result=kinematic, wrench=wrench),
        ),
        Kernel(
            "connection_correction", rep, (wrench,), correction,
            "Christoffel-symbol correction of the task stiffness.",
            "Gamma F (Lachner, Nah, Hogan 2025, central equation and appendix)",
            partial(_connection_correction, representation=rep, result=correction, wrench=wrench),
            spatial,
        ),
        Kernel(
            "joint_stiffness", rep, (*posture, wrench, upper), joint,
            "Symmetric joint stiffness with the connection's correction.",
            "Kq = dJ^T/dq . F + J^T (K + Gamma F) J (Lachner, Nah, Hogan 2025, central equation)",
            partial(_joint_stiffness, representation=rep, result=joint, wrench=wrench, task_stiffness=upper),
            spatial,
            batch=True,
        ),
        Kernel(
            "joint_stiffness_uncorrected", rep, (*posture, wrench, full), uncorrected,
            "Conventional joint stiffness, without the correction; for comparison.",
            "dJ^T/dq . F + J^T K J",
            partial(
                _joint_stiffness_uncorrected, representation=rep, result=uncorrected, wrench=wrench,
                task_stiffness=full,
            ),
        ),
    )  # fmt: skip


_POSE = Argument("pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tip in the base frame")
_MASS = Argument(
    "mass_matrix", ("n", "n"), "kg m^2", "symmetric, positive definite where every joint moves a mass", symmetric=True
)


def _tip_kernels(tip: Tip | None, *, runtime_tool: bool) -> tuple[Kernel, ...]:
    posture = (_Q, _TOOL_POSE) if runtime_tool else (_Q,)
    pose = Kernel(
        "forward_kinematics", None, posture, _POSE,
        "Pose of the tip in the base frame.",
        "product of joint poses",
        _forward_kinematics,
    )  # fmt: skip
    kernels = (pose, *(kernel for rep in REPRESENTATIONS for kernel in _representation_kernels(rep, posture)))
    note = "With a tool pose, 'tip' is the tool's frame." if runtime_tool else ""
    return tuple(replace(kernel, tip=tip, note=" ".join(filter(None, (kernel.note, note)))) for kernel in kernels)


def _joint_stiffness_total(chain: Chain, representation: Representation, arguments: tuple[Argument, ...]) -> Program:
    """Sum of the joint stiffness of every tip; each argument but q holds one block a tip."""
    q, *per_tip = (argument.array(chain) for argument in arguments)
    terms = []
    for index, tip in enumerate(chain.tips):
        kernel = next(
            kernel
            for kernel in _tip_kernels(tip, runtime_tool=chain.runtime_tool)
            if (kernel.representation, kernel.name) == (representation, "joint_stiffness")
        )
        own = [argument.array(chain) for argument in kernel.arguments]
        parts = (Part(q, None), *(Part(array, index) for array in per_tip))
        function, scope = kernel.qualified_name, kernel.scope(chain)
        terms.append(Term(function, scope, kernel.steps(chain), tuple(zip(own, parts, strict=True))))
    target = _TOTAL.array(chain)
    return (Sum(target, "joint_stiffness", tuple(terms)),)


_TOTAL = Argument(
    "joint_stiffness_total", ("n", "n"), "N m/rad", "sum over the tips, bitwise symmetric", symmetric=True
)


def _total_kernels(chain: Chain) -> tuple[Kernel, ...]:
    count = len(chain.tips)
    order = "one a tip, in the order " + ", ".join(tip.name for tip in chain.tips)
    kernels = []
    for rep in REPRESENTATIONS:
        wrench, stiffness_of_tip = _wrench(rep), _task_stiffness(rep, "symmetric, only the upper triangles are read")
        poses = (replace(_TOOL_POSE, name="tool_poses", shape=(count, 4, 4), meaning=f"{order}: {_TOOL_POSE.meaning}"),)
        arguments = (
            _Q,
            *(poses if chain.runtime_tool else ()),
            replace(wrench, name="wrenches", shape=(count, 6), meaning=f"{order}: {wrench.meaning}"),
            replace(
                stiffness_of_tip,
                name="task_stiffnesses",
                shape=(count, 6, 6),
                meaning=f"{order}: {stiffness_of_tip.meaning}",
            ),
        )
        kernels.append(
            Kernel(
                "joint_stiffness_total",
                rep,
                arguments,
                _TOTAL,
                "Symmetric joint stiffness of contacts at all tips together.",
                "sum over the tips of Kq = dJ^T/dq . F + J^T (K + Gamma F) J",
                partial(_joint_stiffness_total, representation=rep, arguments=arguments),
                "A tip without contact: wrench and task stiffness zero.",
            )
        )
    return tuple(kernels)


_MASS_MATRIX = Kernel(
    "mass_matrix", None, (_Q,), _MASS,
    "Joint-space mass matrix.",
    "M_ij = J_i . I^c_j J_j, composite bodies (Featherstone 2008)",
    partial(_mass_matrix, result=_MASS),
    "Links beyond the chain move with it, their own joints held at zero; rotor inertias are not in a URDF.",
    batch=True,
)  # fmt: skip


def _serial(*, runtime_tool: bool = False, masses: bool = True) -> tuple[Kernel, ...]:
    first, *others = _tip_kernels(None, runtime_tool=runtime_tool)
    return (first, *((_MASS_MATRIX,) if masses else ()), *others)


KERNELS: tuple[Kernel, ...] = _serial()
"""The kernels of a chain with one tip, in the order in which they are printed."""


MAX_BATCH_JOINTS = 24
"""Chains with more moving joints have no batch functions, which would double a C source of nearly a megabyte."""


def chain_kernels(chain: Chain) -> tuple[Kernel, ...]:
    """The kernels that a chain has, in the order in which they are printed.

    The mass matrix is left out where the chain's masses were. With several tips, each has its own pose and
    representation kernels, and the joint stiffness of all contacts together is added.
    """
    kernels = _all_kernels(chain)
    if len(chain.joints) <= MAX_BATCH_JOINTS:
        return kernels
    return tuple(replace(kernel, batch=False) for kernel in kernels)


def _all_kernels(chain: Chain) -> tuple[Kernel, ...]:
    if len(chain.tips) == 1:
        return _serial(runtime_tool=chain.runtime_tool, masses=chain.masses)
    per_tip = [kernel for tip in chain.tips for kernel in _tip_kernels(tip, runtime_tool=chain.runtime_tool)]
    return (*((_MASS_MATRIX,) if chain.masses else ()), *per_tip, *_total_kernels(chain))
