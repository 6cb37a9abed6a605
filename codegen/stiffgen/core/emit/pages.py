# SPDX-License-Identifier: MIT
"""Pages: frozen records that the templates of several backends read, made from the kernels and their printed C."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from stiffgen.core.emit.c import CFunction, Scope, VariantCode
from stiffgen.core.emit.texts import cost, declared, definition_comment, documentation, prototype, wrapped
from stiffgen.core.lower.ranges import Stated
from stiffgen.core.lower.scalar import Scalar
from stiffgen.core.lower.variant import Variant
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import PACKED, Kernel
from stiffgen.core.symbolic.model import matrix_shape
from stiffgen.core.symbolic.program import Array


@dataclass(frozen=True)
class Definition:
    """A C function: the comment above it, in lines, its prototype, and the lines in its braces."""

    comment: list[str]
    prototype: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class KernelPage:
    """A public function, in C, C++ and Python.

    Attributes:
        kernel: its record.
        signature: shapes of arguments and results, as NumPy writes them.
        arguments, results: arrays with the robot's sizes.
        definition: the function in C.
        documentation: comment above the C prototype, in lines.
        operations: number of additions, multiplications, sines and cosines.
        packed: whether symmetric results are upper triangles: a batch in C, a function of its own in Python.

    """

    kernel: Kernel
    signature: str
    arguments: tuple[Array, ...]
    results: tuple[Array, ...]
    definition: Definition
    documentation: list[str]
    operations: int
    packed: bool = False

    @property
    def name(self) -> str:
        """Name in its group."""
        return self.kernel.qualified_name if self.packed else self.kernel.name

    @property
    def group(self) -> str:
        """Representation, spring, potential; "" for none."""
        return "packed" if self.packed else self.kernel.group or ""

    @property
    def tip(self) -> str:
        """Name of one tip of several; "" for none."""
        return "" if self.packed or not self.kernel.tip else self.kernel.tip.name

    @property
    def qualified_name(self) -> str:
        """Name in C, less the robot's."""
        return self.kernel.qualified_name + (PACKED if self.packed else "")

    @property
    def batches(self) -> list[str]:
        """C functions for many configurations, names less the robot's."""
        batches = (self.kernel.packed,) if self.packed else self.kernel.batches
        return [f"{self.kernel.qualified_name}{batch.suffix}" for batch in batches if batch]

    @property
    def inputs(self) -> list[str]:
        """Names of the arguments."""
        return [array.name for array in self.arguments]

    @property
    def outputs(self) -> list[str]:
        """Names of the results."""
        return [array.name for array in self.results]

    @property
    def ranks(self) -> list[int]:
        """Numbers of dimensions of arguments and results."""
        return [len(array.shape) for array in (*self.arguments, *self.results)]

    @property
    def sizes(self) -> list[int]:
        """Numbers of entries of arguments and results."""
        return [array.size for array in (*self.arguments, *self.results)]


@dataclass(frozen=True)
class WrappedPage:
    """A function for the wrappers of JAX, PyTorch and CasADi.

    Attributes:
        path: namespaces and name, with dots.
        is_gradient: whether the function is a gradient already, without a vector-Jacobian product.
        arguments: name and shape of each argument.
        results: shape of each result.
        operands: names of arguments and results, with rows and columns of CasADi's matrix for each.
        pairs: rows and columns of the derivative of each result with respect to each argument.

    """

    path: str
    is_gradient: bool
    arguments: list[tuple[str, tuple[int, ...]]]
    results: list[tuple[int, ...]]
    operands: list[tuple[str, tuple[int, int]]]
    pairs: list[tuple[int, int]]

    @property
    def name(self) -> str:
        """Name in C, less the robot's."""
        return self.path.replace(".", "_")


def wrapped_pages(chain: Chain, kernels: Sequence[Kernel]) -> list[WrappedPage]:
    """Return every function but the vector-Jacobian products, which the wrappers call; none without products."""
    if not any(kernel.product_of for kernel in kernels):
        return []
    pages = []
    for kernel in kernels:
        if kernel.product_of:
            continue
        arguments, results = ([each.array(chain) for each in side] for side in (kernel.arguments, kernel.results))
        pages.append(
            WrappedPage(
                path=".".join((*kernel.path, kernel.name)),
                is_gradient=kernel.is_gradient,
                arguments=[(argument.name, argument.shape) for argument in arguments],
                results=[result.shape for result in results],
                operands=[(each.name, matrix_shape(each.shape)) for each in (*arguments, *results)],
                pairs=[(result.size, argument.size) for result in results for argument in arguments],
            )
        )
    return pages


@dataclass(frozen=True)
class KernelGroup:
    """Functions of one tip and one group; ``tip`` and ``group`` are empty where the functions belong to none."""

    tip: str
    group: str
    kernels: list[KernelPage]


def shared_functions(code: VariantCode) -> list[Definition]:
    """Return the internal functions that kernels share."""
    return [_shared(code.variant, scope, function) for scope, function in code.shared]


def _shared(variant: Variant, scope: Scope, function: CFunction) -> Definition:
    """Describe an internal function; columns of joints are passed as 6 rows, in vectors or in numbers."""
    extent = scope.padded if variant.joint_lanes else scope.size
    parameters = [
        f"{variant.row} {array.name}[6][{extent}]" if array.name in function.columns
        else f"{'const ' if array in function.inputs else ''}{variant.number} {declared(array)}"
        for array in (*function.inputs, *function.outputs)
    ]  # fmt: skip
    meaning, tip = function.meaning.removesuffix("."), f", tip {scope.title}" if scope.title else ""
    return Definition(
        comment=[*wrapped(f"{meaning}{tip}."), f"{cost(function.operations)}."],
        prototype=prototype(f"{variant.qualifier} void {function.name}{variant.suffix}(", parameters),
        lines=function.lines,
    )


def kernel_page(
    chain: Chain, name: str, scalar: Scalar, kernel: Kernel, function: CFunction, bounds: Sequence[Stated] = ()
) -> KernelPage:
    """Describe a kernel that was printed for one configuration; ``name`` is the robot's."""
    parameters = [f"const {scalar.name} {declared(array)}" for array in function.inputs]
    parameters += [f"{scalar.name} {declared(array)}" for array in function.outputs]
    return KernelPage(
        kernel=kernel,
        signature=kernel.signature(chain),
        arguments=function.inputs,
        results=function.outputs,
        definition=Definition(
            definition_comment(kernel, function),
            prototype(f"void {name}_{kernel.qualified_name}(", parameters),
            function.lines,
        ),
        documentation=documentation(chain, kernel, bounds),
        operations=function.operations.total,
    )


def groups_of(kernels: Iterable[KernelPage]) -> list[KernelGroup]:
    """Sort functions by tip and group; those of a tip come before those of its groups."""
    members: dict[tuple[str, str], list[KernelPage]] = {}
    for kernel in kernels:
        members.setdefault((kernel.tip, kernel.group), []).append(kernel)
    return [KernelGroup(tip, group, each) for (tip, group), each in members.items()]


def tool_lines(chain: Chain) -> list[str]:
    """Return the description of the tool on the tip link, in lines; none without a tool."""
    tool = chain.tool
    if tool is None:
        return []

    def numbers(values: Sequence[float]) -> str:
        return " ".join(f"{value:.6g}" for value in values)

    text = ""
    if not chain.runtime_tool:
        text = f"The tool's frame replaces the tip's: xyz {numbers(tool.xyz)} m, rpy {numbers(tool.rpy)} rad. "
    if not chain.masses:
        text += "Its mass is ignored, as all masses are."
    elif tool.mass == 0:
        text += "It has no mass: the mass matrix is that of the bare arm."
    else:
        text += f"Its mass is {tool.mass:.6g} kg, its centre of mass {numbers(tool.com)} m"
        if any(tool.inertia):
            text += f", its inertia about that {numbers(tool.inertia)} kg m^2 (ixx ixy ixz iyy iyz izz)"
        text += "; in the tip link's frame."
        if not any(tool.inertia):
            text += " Without an inertia it is a point mass in the mass matrix."
    return wrapped(f"A tool is mounted on the tip link. {text}")
