# SPDX-License-Identifier: MIT
"""Record of a kernel: one function of every generated robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.program import Program
from stiffgen.core.symbolic.symmetric_part import with_symmetric_parts


@dataclass(frozen=True)
class Batch:
    """C function for many configurations in one call: suffix of the name, and results."""

    suffix: str
    results: tuple[Argument, ...]


@dataclass(frozen=True)
class Span:
    """Stretch of a robot between two tips, on which a kernel runs.

    Attributes:
        name: prefix of the kernels' internal functions, which no tip has.
        title: phrase for their comments.
        of: function of the robot that returns the chain of the stretch, with the robot's coordinates.

    """

    name: str
    title: str
    of: Callable[[Chain], Chain]


PACKED = "_packed"
"""Suffix of functions that store symmetric results as their upper triangles."""


@dataclass(frozen=True)
class Kernel:
    """Function of every generated robot.

    Attributes:
        name: name within the group.
        group: namespace, a representation or a spring; None for kernels of neither.
        arguments: inputs, in the order of the C function.
        results: outputs, in the order of the C function.
        summary: first sentence of the documentation.
        equation: formula that the kernel evaluates, with its source.
        program: steps of the kernel for one chain.
        note: information that a caller needs beyond shapes and units.
        tip: tip of the function; None for a robot with one tip, and for functions that concern several tips.

    """

    # More than twelve fields: a new function of a robot is one record of this table.
    name: str
    group: str | None
    arguments: tuple[Argument, ...]
    results: tuple[Argument, ...]
    summary: str
    equation: str
    program: Callable[[Chain], Program]
    note: str = ""
    tip: Tip | None = None
    batch: bool = False
    """Whether C also has a function for many configurations in one call: :attr:`batches`."""
    part_of: str = ""
    """Name of a larger kernel of the group with the same arguments, whose results include this kernel's.

    The larger kernel costs hardly more, so that one vector-Jacobian product serves both.
    """
    product_of: str = ""
    """Name of the kernel of the group whose vector-Jacobian product this is, with its arguments and cotangents."""
    by_tips: Callable[[Chain], Program] | None = None
    """Program of a total as a sum over the tips, differentiated tip by tip; ``program`` needs one pass."""
    is_gradient: bool = False
    """Whether the kernel is a gradient already: --derivatives adds no vector-Jacobian product."""
    on_request: str = ""
    """Word of --kernels that adds the kernel; empty for a kernel of every robot."""
    of_coordinates: bool = False
    """Whether the kernel, or that of the tree behind it, loops over the coordinates."""
    absent: tuple[tuple[str, str], ...] = ()
    """Names that the group lacks on purpose, each with the reason and what takes its place."""
    of_masses: bool = False
    """Whether the kernel needs all moving joints, including side joints, which move masses but no tip."""
    span: Span | None = None
    """Stretch between two tips on which the kernel runs; None for a kernel of a tip or of the robot."""

    def __post_init__(self) -> None:
        """Raise StiffgenError if an argument's record is not complete."""
        for argument in self.arguments:
            argument.check_complete(self.qualified_name)

    @property
    def function(self) -> str:
        """``hybrid_joint_stiffness``: group and name, without the tip."""
        return "_".join(part for part in (self.group, self.name) if part)

    @property
    def qualified_name(self) -> str:
        """``hybrid_joint_stiffness``, ``left_hand_hybrid_joint_stiffness`` or the bare name."""
        return "_".join((*((self.tip.name,) if self.tip else ()), self.function))

    @property
    def path(self) -> tuple[str, ...]:
        """Namespaces that hold the function in Python: tip and group, where the kernel has them."""
        return tuple(filter(None, (self.tip.name if self.tip else None, self.group)))

    @property
    def choices(self) -> tuple[str, str]:
        """Words of --kernels that select the kernel: GROUP ("dynamics" without a group) and GROUP.NAME.

        A kernel on request has the word of its family in place of the group.
        """
        name = ".".join(filter(None, (self.group, self.name.removesuffix("_total"))))
        return self.on_request or self.group or "dynamics", name

    @property
    def result(self) -> Argument:
        """Result of a kernel with one result."""
        (result,) = self.results
        return result

    @property
    def packed(self) -> Batch | None:
        """Batch NAME_..._packed_batch; None without a batch or a symmetric result."""
        if not self.batch or not any(result.symmetric for result in self.results):
            return None
        return Batch(f"{PACKED}_batch", tuple(result.packed() for result in self.results))

    @property
    def batches(self) -> tuple[Batch, ...]:
        """Batches of the kernel: NAME_..._batch and :attr:`packed`, where they exist."""
        if not self.batch:
            return ()
        return Batch("_batch", self.results), *((self.packed,) if self.packed else ())

    def scope(self, chain: Chain) -> Chain:
        """Return the part that the program needs: branch to the tip, paths to all tips, a span, or all joints."""
        if self.span:
            return self.span.of(chain)
        if self.of_masses:
            return chain
        return chain.branch(self.tip) if self.tip else chain.without_side_joints()

    def scope_name(self, chain: Chain) -> str:
        """Return the name of the scope: of the tip or span, "tree" for all joints with side joints, else ""."""
        if self.span:
            return self.span.name
        if self.of_masses and len(chain.without_side_joints().joints) < len(chain.joints):
            return "tree"
        return self.tip.name if self.tip else ""

    def steps(self, chain: Chain) -> Program:
        """Return the program for a chain, which runs on the chain's :meth:`scope`, with arguments' symmetric parts."""
        arguments = [argument.array(chain) for argument in self.arguments]
        return with_symmetric_parts(self.program(self.scope(chain)), arguments)

    @property
    def place(self) -> str:
        """Tip link or span of the kernel, for comments; "" for a kernel of the robot."""
        return self.span.title if self.span else self.tip.link if self.tip else ""

    def signature(self, chain: Chain) -> str:
        """Return the shapes as a signature of a NumPy generalised ufunc, "(7),(6)->(7,7)"."""
        inputs, outputs = (
            ",".join("(" + ",".join(map(str, argument.array(chain).shape)) + ")" for argument in arrays)
            for arrays in (self.arguments, self.results)
        )
        return f"{inputs}->{outputs}"


def absent_functions(kernels: Iterable[Kernel]) -> dict[str, str]:
    """Return the functions that groups of these kernels lack on purpose, by path in Python, each with the reason."""
    return {".".join((*each.path, name)): reason for each in kernels for name, reason in each.absent}
