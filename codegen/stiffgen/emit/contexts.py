# SPDX-License-Identifier: MIT
"""What the templates read: frozen records, made of the chain, the kernels' records and what was printed for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from stiffgen.emit.c import CFunction, Scope, VariantCode, suffix_of
from stiffgen.lower.graph import Operations
from stiffgen.lower.rounding import Stated
from stiffgen.lower.scalar import Scalar
from stiffgen.lower.variant import Variant
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kernels import PACKED, Kernel
from stiffgen.symbolic.model import matrix_shape
from stiffgen.symbolic.program import Array


@dataclass(frozen=True)
class Definition:
    """A C function: the comment over it, in lines, its prototype, and the lines in its braces."""

    comment: list[str]
    prototype: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Shaped:
    """An argument or result as C++ declares it: its name, and its extents, none for a number."""

    name: str
    extents: tuple[int, ...]


@dataclass(frozen=True)
class KernelPage:
    """A public function, in C and in Python.

    Attributes:
        definition: in C.
        name, group, tip, qualified_name: its names, as in the kernel's record; "" where it belongs to no group or tip.
        summary, equation, signature: in words and signs.
        inputs, outputs: names of arguments and results.
        arguments, results: the same with their shapes.
        protocol: name of the Python stub of functions with these arguments.
        ranks: numbers of dimensions of arguments and results.
        extents: C initialisers of their shapes.
        sizes: their numbers of entries.
        single: C has it for one configuration.
        batches: its C functions for many, names less the robot's.
        documentation: the comment over the C prototype, in lines.
        doxygen: the same over the C++ one.
        docstring: Python's, in lines.
        operations: how many it costs.

    """

    definition: Definition
    name: str
    group: str
    tip: str
    qualified_name: str
    summary: str
    equation: str
    signature: str
    inputs: list[str]
    outputs: list[str]
    arguments: list[Shaped]
    results: list[Shaped]
    protocol: str
    ranks: list[int]
    extents: list[str]
    sizes: list[int]
    single: bool
    batches: list[str]
    documentation: list[str]
    doxygen: list[str]
    docstring: list[str]
    operations: int


@dataclass(frozen=True)
class DifferentiablePage:
    """A function that has a vector-Jacobian product, for the wrappers of JAX, PyTorch and CasADi.

    Attributes:
        path: its namespaces and name, with dots.
        arguments: name and shape of each.
        results: their shapes.
        triangles: arguments of which the upper triangle alone is read.
        operands: names of arguments and results, with rows and columns of the matrix that CasADi has for each.
        pairs: of the derivative of every result by every argument, its rows and columns in CasADi.

    """

    path: str
    arguments: list[tuple[str, tuple[int, ...]]]
    results: list[tuple[int, ...]]
    triangles: list[str]
    operands: list[tuple[str, tuple[int, int]]]
    pairs: list[tuple[int, int]]

    @property
    def name(self) -> str:
        """Its name in C, less the robot's."""
        return self.path.replace(".", "_")


def differentiable_pages(chain: Chain, kernels: Sequence[Kernel]) -> list[DifferentiablePage]:
    """Those of the kernels that have one."""
    names = {kernel.qualified_name for kernel in kernels}
    pages = []
    for kernel in kernels:
        if f"{kernel.qualified_name}_vjp" not in names:
            continue
        arguments, results = ([each.array(chain) for each in side] for side in (kernel.arguments, kernel.results))
        pages.append(
            DifferentiablePage(
                path=".".join((*kernel.path, kernel.name)),
                arguments=[(argument.name, argument.shape) for argument in arguments],
                results=[result.shape for result in results],
                triangles=[argument.name for argument in kernel.arguments if argument.triangle],
                operands=[(each.name, matrix_shape(each.shape)) for each in (*arguments, *results)],
                pairs=[(result.size, argument.size) for result in results for argument in arguments],
            )
        )
    return pages


@dataclass(frozen=True)
class Group:
    """Kernels of a tip and a representation ("" each: of none)."""

    tip: str
    group: str
    kernels: list[KernelPage]


@dataclass(frozen=True)
class StoredResult:
    """A result of ``size`` numbers, of which so many are ``stored``.

    ``rows`` are those of a matrix of which the upper triangle is stored, else 0.
    """

    name: str
    size: int
    stored: int
    rows: int


@dataclass(frozen=True)
class BatchFunction:
    """A public function for many configurations: its prototype, and what it stores."""

    prototype: str
    results: list[StoredResult]


@dataclass(frozen=True)
class BatchPage:
    """A kernel's batches: the function for one vector of configurations, and the public ones that loop over these."""

    definition: Definition
    qualified_name: str
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    functions: list[BatchFunction]


@dataclass(frozen=True)
class ThreadPage:
    """A CUDA kernel: vectors and cotangents are each configuration's own, other matrices are shared by all.

    A varying matrix has a stride of its own, 0 for a shared one.

    Attributes:
        definition: of the function of one thread.
        kernel: prototype of the function that runs it on all configurations.
        prototype: of the launch function.
        qualified_name: the kernel's.
        own: arguments that every configuration has its own of.
        varying: arguments that it has, or that are shared by all.
        arrays: what the launch function hands to that function: names of arguments, their strides, and results.
        given: C texts of the arguments that the thread's function is called with.
        results: what it gives.
        documentation: the comment over the launch function's prototype, in lines.
        moved: numbers read and written a configuration.

    """

    definition: Definition
    kernel: str
    prototype: str
    qualified_name: str
    own: list[Array]
    varying: list[Array]
    arrays: list[str]
    given: list[str]
    results: list[StoredResult]
    documentation: list[str]
    moved: int


@dataclass(frozen=True)
class CudaPages:
    """What NAME.cu and NAME_cuda.h are made of."""

    variant: Variant
    scopes: tuple[Scope, ...]
    shared: list[Definition]
    kernels: list[ThreadPage]
    calls: frozenset[str]


def cuda_pages(chain: Chain, name: str, code: VariantCode) -> CudaPages:
    """The CUDA kernels that were printed for a variant."""
    kernels = [_thread(chain, name, code.variant, kernel, function) for kernel, function in code.kernels]
    return CudaPages(code.variant, code.scopes, shared_functions(code), kernels, code.calls)


def shared_functions(code: VariantCode) -> list[Definition]:
    """The internal functions that kernels share."""
    return [_shared(code.variant, scope, function) for scope, function in code.shared]


def _shared(variant: Variant, scope: Scope, function: CFunction) -> Definition:
    extent = scope.padded if variant.joint_lanes else scope.size
    parameters = [
        f"{variant.row} {array.name}[6][{extent}]" if array.name in function.columns
        else f"{'const ' if array in function.inputs else ''}{variant.number} {_declared(array)}"
        for array in (*function.inputs, *function.outputs)
    ]  # fmt: skip
    tip = f", tip {scope.title}" if scope.title else ""
    return Definition(
        comment=[*wrapped(f"{function.meaning}{tip}."), f"{_cost(function.operations)}."],
        prototype=_fill(f"{variant.qualifier} void {function.name}{variant.suffix}(", parameters) + ")",
        lines=function.lines,
    )


def kernel_page(
    chain: Chain, name: str, scalar: Scalar, kernel: Kernel, function: CFunction, bounds: Sequence[Stated]
) -> KernelPage:
    """A kernel that was printed for one configuration; ``name`` is the robot's, ``bounds`` those of its errors."""
    parameters = [f"const {scalar.name} {_declared(array)}" for array in function.inputs]
    parameters += [f"{scalar.name} {_declared(array)}" for array in function.outputs]
    prototype = _fill(f"void {name}_{kernel.qualified_name}(", parameters) + ")"
    arrays, outputs = (*function.inputs, *function.outputs), len(function.outputs)
    return KernelPage(
        definition=Definition(_explained(kernel, function), prototype, function.lines),
        name=kernel.name,
        group=kernel.group or "",
        tip=kernel.tip.name if kernel.tip else "",
        qualified_name=kernel.qualified_name,
        summary=kernel.summary,
        equation=kernel.equation,
        signature=kernel.signature(chain),
        inputs=[array.name for array in function.inputs],
        outputs=[array.name for array in function.outputs],
        arguments=[Shaped(array.name, array.shape) for array in function.inputs],
        results=[Shaped(array.name, array.shape) for array in function.outputs],
        protocol="_".join(["_Of", *(a.name for a in function.inputs), *([str(outputs)] if outputs > 1 else [])]),
        ranks=[len(array.shape) for array in arrays],
        extents=[_initialiser(array) for array in arrays],
        sizes=[array.size for array in arrays],
        single=True,
        batches=[f"{kernel.qualified_name}{batch.suffix}" for batch in kernel.batches],
        documentation=_documentation(chain, kernel, bounds),
        doxygen=_doxygen(chain, kernel),
        docstring=_docstring(chain, kernel),
        operations=function.operations.total,
    )


def packed_pages(chain: Chain, kernels: Sequence[Kernel], pages: Sequence[KernelPage]) -> list[KernelPage]:
    """The functions of Python's namespace ``packed``: of kernels and their pages those that have a packed batch."""
    made = []
    for kernel, page in zip(kernels, pages, strict=True):
        if not kernel.packed:
            continue
        packed = replace(kernel, results=kernel.packed.results)
        results = [result.array(chain) for result in packed.results]
        count = len(kernel.arguments)
        made.append(
            replace(
                page,
                name=kernel.qualified_name,
                group="packed",
                tip="",
                qualified_name=f"{kernel.qualified_name}{PACKED}",
                signature=packed.signature(chain),
                ranks=[*page.ranks[:count], *(len(array.shape) for array in results)],
                extents=[*page.extents[:count], *map(_initialiser, results)],
                sizes=[*page.sizes[:count], *(array.size for array in results)],
                single=False,
                batches=[f"{kernel.qualified_name}{kernel.packed.suffix}"],
                docstring=_docstring(chain, packed),
            )
        )
    return made


def _initialiser(array: Array) -> str:
    """A C initialiser of an array's shape."""
    return "{" + ", ".join(map(str, array.shape or (1,))) + "}"


def batch_page(chain: Chain, name: str, variant: Variant, kernel: Kernel, function: CFunction) -> BatchPage:
    """A kernel that was printed for vectors of configurations; ``name`` is the robot's."""
    number, parameters = variant.scalar.name, ["size_t count"]
    for array in function.inputs:
        parameters += [f"const {number} *{array.name}", f"ptrdiff_t {array.name}_step"]
    parameters += [f"{number} *{array.name}" for array in function.outputs]
    within = [f"const {variant.number} {_declared(array)}" for array in function.inputs]
    within += [f"{variant.number} {_declared(array)}" for array in function.outputs]
    one_vector = _fill(f"{variant.qualifier} void {kernel.qualified_name}{suffix_of(variant)}(", within) + ")"
    return BatchPage(
        definition=Definition(_explained(kernel, function), one_vector, function.lines),
        qualified_name=kernel.qualified_name,
        inputs=function.inputs,
        outputs=function.outputs,
        functions=[
            BatchFunction(
                _fill(f"void {name}_{kernel.qualified_name}{batch.suffix}(", parameters) + ")",
                [_stored(chain, *each) for each in zip(kernel.results, batch.results, strict=True)],
            )
            for batch in kernel.batches
        ],
    )


def _stored(chain: Chain, result: Argument, stored: Argument) -> StoredResult:
    """A result, and what is stored of it."""
    whole, kept = result.array(chain), stored.array(chain)
    return StoredResult(whole.name, whole.size, kept.size, whole.shape[0] if kept.shape != whole.shape else 0)


def _thread(chain: Chain, name: str, variant: Variant, kernel: Kernel, function: CFunction) -> ThreadPage:
    number = variant.number
    own = [
        array
        for array, argument in zip(function.inputs, kernel.arguments, strict=True)
        if len(array.shape) == 1 or argument.own
    ]
    taken = zip(kernel.arguments, function.inputs, strict=True)
    varying = [array for argument, array in taken if argument.varying]
    declared = [f"const {number} {_declared(array)}" for array in function.inputs]
    declared += [f"{number} {_declared(array)}" for array in function.outputs]
    one = _fill(f"{variant.qualifier} void {kernel.qualified_name}{suffix_of(variant)}(", declared) + ")"
    given, arrays = [], []
    for array in function.inputs:
        given.append(f"const {number} *{array.name}")
        arrays.append(array.name)
        if array in varying:
            given.append(f"size_t {array.name}_stride")
            arrays.append(f"{array.name}_stride")
    given += [f"{number} *{array.name}" for array in function.outputs]
    arrays += [array.name for array in function.outputs]
    results = [_stored(chain, result, result.packed()) for result in kernel.results]
    each = ["size_t count", "size_t stride", *(text.replace("*", "*__restrict__ ") for text in given)]
    launch = ["size_t count", "size_t stride", *given, "void *stream"]
    return ThreadPage(
        definition=Definition(_explained(kernel, function), one, function.lines),
        kernel=_fill(f"KERNEL {kernel.qualified_name}_kernel(", each) + ")",
        prototype=_fill(f"int {name}_{kernel.qualified_name}_cuda(", launch) + ")",
        qualified_name=kernel.qualified_name,
        own=own,
        varying=varying,
        arrays=arrays,
        given=[f"{a.name}_of_one" if a in own or a in varying else a.name for a in function.inputs],
        results=results,
        documentation=_thread_documentation(chain, kernel),
        moved=sum(result.stored for result in results) + sum(array.size for array in own),
    )


def groups_of(kernels: Iterable[KernelPage]) -> list[Group]:
    """Kernels by tip and representation, a tip's own ones before those of its representations."""
    members: dict[tuple[str, str], list[KernelPage]] = {}
    for kernel in kernels:
        members.setdefault((kernel.tip, kernel.group), []).append(kernel)
    return [Group(tip, group, each) for (tip, group), each in members.items()]


def overview(groups: Sequence[Group]) -> list[str]:
    """The functions for a reader, those of groups that have the same ones once: call, shape and meaning."""
    calls_of = {".".join(filter(None, (group.tip, group.group))): _calls(group.kernels) for group in groups}
    lines: list[str] = []
    for calls in dict.fromkeys(calls_of.values()):
        places = [place for place, each in calls_of.items() if each == calls]
        if places != [""]:
            lines.append(", ".join(place or "here" for place in places))
        lines += [line if places == [""] else f"    {line}" for line in calls]
    return lines


def _calls(kernels: list[KernelPage]) -> tuple[str, ...]:
    """Two lines a function; words on the representation are left to the groups' names."""
    lines: list[str] = []
    for kernel in kernels:
        shapes = kernel.signature.partition("->")[2].replace(",", ", ").replace("),", "),")
        lines.append(f"{kernel.name}({', '.join(kernel.inputs)}) -> {shapes}")
        summary = kernel.summary.replace(f"in {kernel.group} representation", "in the representation named above")
        lines.append(f"    {summary}")
    return tuple(lines)


@dataclass(frozen=True)
class Section:
    """A part of NAME.c: its title, and the names of the functions in it, in lines that fit a comment."""

    title: str
    functions: list[str]


def sections_of(single: VariantCode, batch: VariantCode) -> dict[str, Section]:
    """The table of contents of NAME.c; the template puts a banner with the title over each part."""

    def section(title: str, names: Sequence[str]) -> Section:
        return Section(title, wrapped(", ".join(names), width=98) if names else [])

    shared = [function.name for _, function in single.shared]
    kernels = [kernel.qualified_name for kernel, _ in single.kernels]
    batches = [function.name + batch.variant.suffix for _, function in batch.shared]
    batches += [f"{kernel.qualified_name}{each.suffix}" for kernel, _ in batch.kernels for each in kernel.batches]
    found = {
        "robot": section("Arithmetic, and the robot's sizes, names and limits", []),
        "loops": section("Lanes, and fixed loops over them", []),
        "shared": section("What several kernels share", shared),
        "kernels": section("Kernels", kernels),
        "batches": section("Batches: the same with lanes of configurations in place of numbers", batches),
        "check": section("Self-check of the compiler's arithmetic", []),
    }
    optional = {"shared": shared, "batches": batch.kernels}
    kept = {key: each for key, each in found.items() if optional.get(key, True)}
    return {
        key: Section(f"{number}. {each.title}", each.functions) for number, (key, each) in enumerate(kept.items(), 1)
    }


def tool_lines(chain: Chain) -> list[str]:
    """What header and README say about the tool on the tip link, in lines; none without a tool."""
    tool = chain.tool
    if tool is None:
        return []

    def numbers(values: Sequence[float]) -> str:
        return " ".join(f"{value:.6g}" for value in values)

    text = ""
    if not chain.runtime_tool:
        text = f"The tool's frame takes the tip's place: xyz {numbers(tool.xyz)} m, rpy {numbers(tool.rpy)} rad. "
    if not chain.masses:
        text += "Its mass is left out, as all masses are."
    elif tool.mass == 0:
        text += "It has no mass: the mass matrix is that of the arm without it."
    else:
        text += f"Its mass is {tool.mass:.6g} kg, its centre of mass {numbers(tool.com)} m"
        if any(tool.inertia):
            text += f", its inertia about that {numbers(tool.inertia)} kg m^2 (ixx ixy ixz iyy iyz izz)"
        text += "; in the tip link's frame."
        if not any(tool.inertia):
            text += " No inertia was given: the mass matrix takes it as a point mass."
    return wrapped(f"A tool is mounted on the tip link. {text}")


@dataclass(frozen=True)
class Example:
    """What the README's examples call, and with what: C values in ``poses``, Python text in ``arguments``."""

    posture: tuple[float, ...]
    jacobian: str
    jacobian_path: tuple[str, ...]
    stiffness: str
    poses: tuple[tuple[str, tuple[float, ...]], ...]
    arguments: tuple[tuple[str, str], ...]


def example_of(chain: Chain) -> Example:
    """The examples of a chain."""
    several = len(chain.tips) > 1
    path = (*([chain.tips[0].name] if several else []), "hybrid", "jacobian")
    identity = tuple(float(k % 5 == 0) for k in range(16))
    wrench, stiffness = "np.array([0, 0, -10, 0, 0, 0])", "np.diag([800, 800, 800, 50, 50, 50])"
    values = {"tool_pose": "np.eye(4)", "wrench": wrench, "task_stiffness": stiffness}
    if several:
        many = {"tool_pose": "tool_poses", "wrench": "wrenches", "task_stiffness": "task_stiffnesses"}
        values = {many[key]: f"np.stack({len(chain.tips)} * [{value}])" for key, value in values.items()}
    asked = ("base_pose", chain.floating), ("tool_pose", chain.runtime_tool)
    given = list(values.items())[0 if chain.runtime_tool else 1 :]
    return Example(
        posture=(0.1, 0.2, 0.3)[: len(chain.coordinates)],
        jacobian="_".join(path),
        jacobian_path=path,
        stiffness="hybrid.joint_stiffness_total" if several else "hybrid.joint_stiffness",
        poses=tuple((pose, identity) for pose, is_given in asked if is_given),
        arguments=((("base_pose", "np.eye(4)"),) if chain.floating else ()) + tuple(given),
    )


def _thread_documentation(chain: Chain, kernel: Kernel) -> list[str]:
    """The comment over a launch function's prototype."""
    lines = [kernel.summary, *wrapped(kernel.equation), *(wrapped(kernel.note) if kernel.note else []), ""]
    for argument in (*kernel.arguments, *kernel.results):
        shape = argument.array(chain).shape
        text = _extents(shape)
        if argument in kernel.results:
            text = (
                f"{argument.packed().array(chain).size} a configuration: "
                + ("upper triangle of " if argument.symmetric else "")
                + text
            )
        elif argument.varying:
            text += f" a configuration, {argument.name}_stride apart; with {argument.name}_stride 0, shared"
        else:
            text += " a configuration" if len(shape) == 1 or argument.own else ", shared"
        lines += wrapped(f"{argument.name} ({text}) [{argument.unit}]: {argument.meaning}", indent="    ")
    return lines


def _explained(kernel: Kernel, function: CFunction) -> list[str]:
    """The comment over a kernel's definition: what it computes, by which equation, and what that costs."""
    return [kernel.summary, *wrapped(kernel.equation), f"{_cost(function.operations)}."]


def _cost(operations: Operations) -> str:
    return f"{operations.add} additions, {operations.multiply} multiplications, {operations.sincos} sines and cosines"


def _declared(array: Array) -> str:
    return f"{array.name}[{array.size}]"


def _fill(opening: str, parameters: list[str], width: int = 110) -> str:
    lines = [opening]
    for index, parameter in enumerate(parameters):
        last = index == len(parameters) - 1
        piece = parameter if last else f"{parameter}, "
        if len(lines[-1]) + len(piece) > width:
            lines[-1] = lines[-1].rstrip()
            lines.append(" " * 4 + piece)
        else:
            lines[-1] += piece
    return "\n".join(lines)


def wrapped(text: str, width: int = 104, indent: str = "") -> list[str]:
    """Words in lines of at most ``width`` characters; all but the first begin with the indent."""
    lines: list[str] = []
    current = ""
    for word in text.split():
        if current and len(current) + 1 + len(word) > width:
            lines.append(current)
            current = f"{indent}{word}"
        else:
            current = f"{current} {word}" if current else word
    return [*lines, current]


def _explained_arguments(kernel: Kernel) -> tuple[Argument, ...]:
    """The arguments that a kernel's documentation explains: of a product, which has a result for each other one, the
    cotangents.
    """
    if not kernel.product_of:
        return kernel.arguments
    return kernel.arguments[len(kernel.results) :]


def _as_before(kernel: Kernel, width: int = 104) -> list[str]:
    """Where the other arguments of a product are explained, in lines."""
    others = ", ".join(each.name for each in kernel.arguments if each not in _explained_arguments(kernel))
    return wrapped(f"{others}: as {kernel.product_of} takes them", width, indent="    ") if kernel.product_of else []


def _documentation(chain: Chain, kernel: Kernel, bounds: Sequence[Stated]) -> list[str]:
    """The comment over a C prototype."""
    lines = [kernel.summary, *wrapped(kernel.equation)]
    if kernel.note:
        lines += wrapped(kernel.note)
    lines += ["", *_as_before(kernel)]
    for argument in (*_explained_arguments(kernel), *kernel.results):
        lines += wrapped(_described(chain, argument), indent="    ")
    if bounds:
        lines += wrapped(f"Rounding: {', '.join(each.text for each in bounds)}.")
    return lines


def _doxygen(chain: Chain, kernel: Kernel) -> list[str]:
    """The comment over a C++ function."""
    lines = [f"@brief {kernel.summary}", "", *wrapped(kernel.equation)]
    if kernel.note:
        lines += wrapped(kernel.note)
    lines += ["", *_as_before(kernel)]
    for direction, arguments in (("in", _explained_arguments(kernel)), ("out", kernel.results)):
        for argument in arguments:
            lines += wrapped(f"@param[{direction}] {_described(chain, argument)}", indent="    ")
    return lines


def _extents(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape or (1,)))


def _described(chain: Chain, argument: Argument) -> str:
    shape = _extents(argument.array(chain).shape)
    return f"{argument.name} ({shape}) [{argument.unit}]: {argument.meaning}"


def _docstring(chain: Chain, kernel: Kernel) -> list[str]:
    lines = [kernel.summary, "", *wrapped(kernel.equation, 88), ""]
    if kernel.note:
        lines += [*wrapped(kernel.note, 88), ""]
    for title, arguments in (("Parameters", _explained_arguments(kernel)), ("Returns", kernel.results)):
        lines += [title, "-" * len(title), *(_as_before(kernel, 88) if title == "Parameters" else [])]
        for argument in arguments:
            shape = ", ".join(("...", *map(str, argument.array(chain).shape)))
            lines.append(f"{argument.name} : ({shape}) [{argument.unit}]")
            lines += [f"    {line}" for line in wrapped(argument.meaning, 84)]
        lines.append("")
    return lines[:-1]
