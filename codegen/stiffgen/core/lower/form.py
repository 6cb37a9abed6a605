# SPDX-License-Identifier: MIT
"""The lowered form of a kernel: statements and loops over arrays, with one :class:`Storage` record for each array.

A printer walks the items of a :class:`Function` in order. Everything that it needs to know about an array (where it
lives, how it is laid out, which entries are zero) is in the array's record. Rounding bounds
(:mod:`stiffgen.families.rounding`) are computed from the same items.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import casadi as ca

from stiffgen.core.lower.graph import Graph, Operations, build_graph
from stiffgen.core.lower.scalar import Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Kind
from stiffgen.core.symbolic.program import Array, Operand, Over, Step


@dataclass(frozen=True)
class Scope:
    """The chain of a set of functions, and the prefix of internal names about this chain."""

    chain: Chain
    prefix: str
    scalar: Scalar
    title: str = ""
    """Tip link, fit for a comment; "" where the chain is the robot."""

    @property
    def size(self) -> str:
        """C name of the number of moving joints."""
        return f"{self.prefix}M" if self.chain.coupled else "N"

    @property
    def blocks(self) -> str:
        """C name of the number of vectors used per row over joints."""
        return f"{self.prefix}BLOCKS"

    @property
    def padded(self) -> str:
        """C name of the number of vectors allocated per row over joints."""
        return f"{self.prefix}PADDED"

    @property
    def padded_size(self) -> int:
        """Numbers allocated per row over joints."""
        return self.scalar.filled(len(self.chain.joints))


class Place(Enum):
    """Place of an array: parameter or local."""

    ARGUMENT = "parameter, read only"
    RESULT = "parameter that is written"
    LOCAL = "local of the function"

    @property
    def is_parameter(self) -> bool:
        """Whether the caller passes the array."""
        return self is not Place.LOCAL


class Layout(Enum):
    """Order of the entries of an array in memory."""

    FLAT = "row-major, one index"
    SHAPED = "row-major, one index per dimension"
    LANES = "a row of vectors of joints for each entry of a column"
    WEIGHTS = "weights of the pairs (i, j), in the array itself or its companion"
    WEIGHTS_TRANSPOSED = "weights of the pairs (j, i), in the companion"
    WEIGHT_ROWS = "weights, a row of vectors of joints j for each joint i and entry"


@dataclass(eq=False)
class Storage:
    """Properties of one array of a function.

    Attributes:
        array: name and shape in the program.
        place: parameter or local.
        layout: memory layout.
        local: name and shape of the local copy or alias under which expressions read an argument.
        zeros: entries that are zero whatever the arguments; they are neither stored nor read.
        zero_rows: ``zeros`` counts whole rows over joints.
        by_joints: some expression reads the array joint by joint.
        whole: a helper or function reads the array: zeros are stored, too.
        filled: a loop has stored whole rows.
        overflows: a result that may be infinite after its last store.
        elsewhere: the entries, where the array itself is not stored.
        companion: rows of vectors with a copy of the array, or (weights) the stored transpose.

    """

    array: Array
    place: Place = Place.LOCAL
    layout: Layout = Layout.SHAPED
    local: Array | None = None
    zeros: set[int] = field(default_factory=set)
    zero_rows: bool = False
    by_joints: bool = False
    whole: bool = False
    filled: bool = False
    overflows: bool = False
    elsewhere: tuple[Access | Local, ...] = ()
    companion: Storage | None = None

    @property
    def is_result(self) -> bool:
        """Whether the caller gets the array."""
        return self.place is Place.RESULT

    @property
    def named(self) -> Array:
        """Name and shape under which expressions read the array."""
        return self.local or self.array

    def known_zeros(self) -> set[int]:
        """Return the row-major entries that are zero whatever the arguments."""
        if not self.zero_rows:
            return set(self.zeros)
        columns = self.array.shape[1]
        return {row * columns + column for row in self.zeros for column in range(columns)}


@dataclass(frozen=True)
class Access:
    """One entry of an array: the ``entry``-th that an operand touches.

    ``wide``: all vector lanes of the entry at once. ``as_passed``: an argument itself, not its copy. ``guard`` is the
    name of a local with NaN in place of infinity.
    """

    storage: Storage
    operand: Operand
    entry: int
    wide: bool = False
    as_passed: bool = False
    guard: str = ""


@dataclass(frozen=True)
class Local:
    """A local number, or element ``index`` of a local array; ``operand`` and ``entry`` as in :class:`Access`."""

    name: str
    index: int | str | None = None
    operand: Operand | None = None
    entry: int = 0


Entry = Access | Local


@dataclass(frozen=True)
class Output:
    """An operation whose value is stored in each of the ``places``."""

    places: tuple[Entry, ...]
    number: int


@dataclass(frozen=True)
class LoweredSection:
    """Operations that the code shows under names of their own, below a comment; ``shared``: those used repeatedly."""

    comment: str
    members: tuple[tuple[str, int], ...]
    shared: bool = False


@dataclass(frozen=True)
class Body:
    """Statements: a graph of operations on entries of arrays, and where its outputs go.

    Attributes:
        graph: operations.
        inputs: entry behind each input of the graph.
        outputs: results, in the order in which they are stored.
        sections: intermediate results with names.
        kinds: kind of each operation of which something is known.
        heading: comment over the outputs.
        define: number of outputs, the first ones, that become locals unless they have a name already.
        wide_outputs: whether outputs are entries of rows or vectors.
        accumulate: whether outputs are added to what is there.
        poison: name of the local that makes NaN of what depends on choices; "" without choices.

    """

    graph: Graph
    inputs: tuple[Access, ...]
    outputs: tuple[Output, ...]
    sections: tuple[LoweredSection, ...] = ()
    kinds: tuple[tuple[int, Kind], ...] = ()
    heading: str = ""
    define: int = 0
    wide_outputs: bool = False
    accumulate: bool = False
    poison: str = ""

    @property
    def reads(self) -> set[int]:
        """Numbers of the inputs that the statements read; the poison reads all entries of the kernel's arguments."""
        uses = self.graph.uses([output.number for output in self.outputs])
        read = {int(self.graph.keys[number][1]) for number in uses if self.graph.keys[number][0] == "input"}
        passed = {k for k, access in enumerate(self.inputs) if access.storage.place is not Place.LOCAL}
        return read | passed if self.poison else read


def make_body(
    inputs: Sequence[tuple[ca.SX, Access]],
    outputs: Sequence[tuple[tuple[Entry, ...], ca.SX]],
    sections: Sequence[tuple[str, Sequence[tuple[str, ca.SX, Kind]], bool]] = (),
    kinds: Sequence[Kind] = (),
    *,
    poison: str = "poison",
    heading: str = "",
    define: int = 0,
    wide_outputs: bool = False,
    accumulate: bool = False,
) -> Body:
    """Return the body of expressions in scalar symbols.

    Args:
        inputs: symbols, and the entries behind them.
        outputs: places, and the expressions to be stored there.
        sections: comments, the named values below them, in order of computation, and whether only shared ones count.
        kinds: kinds of the outputs, where something is known of them.
        poison: name of the local that makes NaN of what depends on choices.
        heading: see :class:`Body`, as the others.
        define: number of outputs that become locals.
        wide_outputs: whether outputs are entries of rows.
        accumulate: whether outputs are added.

    """
    symbols = ca.vertcat(*(symbol for symbol, _ in inputs)) if inputs else ca.SX(0, 1)
    named = [member for _, members, _ in sections for member in members]
    everything = ca.densify(ca.vertcat(*(value for _, value in outputs), *(value for _, value, _ in named)))
    graph, numbers = build_graph(ca.Function("f", [symbols], [everything]))
    # The graph's outputs are those of the body, then the named values of all sections, in order.
    results, of_named = numbers[: len(outputs)], numbers[len(outputs) :]
    known = [*zip(results, kinds, strict=False), *zip(of_named, (kind for *_, kind in named), strict=True)]
    lowered_sections, start = list[LoweredSection](), 0
    for title, members, only_shared in sections:
        own = zip(members, of_named[start : start + len(members)], strict=True)
        lowered_sections.append(LoweredSection(title, tuple((name, number) for (name, *_), number in own), only_shared))
        start += len(members)
    return Body(
        graph=graph,
        inputs=tuple(access for _, access in inputs),
        outputs=tuple(Output(places, number) for (places, _), number in zip(outputs, results, strict=True)),
        sections=tuple(lowered_sections),
        kinds=tuple((number, kind) for number, kind in known if kind is not Kind.NUMBER),
        heading=heading,
        define=define,
        wide_outputs=wide_outputs,
        accumulate=accumulate,
        poison=poison if graph.chooses(results) else "",
    )


class Count(Enum):
    """A number in the arguments of helpers that has a name in the code."""

    JOINTS = "moving joints"
    COORDINATES = "coordinates"
    USED = "vectors used per row over joints"
    ALLOCATED = "vectors allocated per row over joints"
    USED_NUMBERS = "numbers used per row over joints"
    ALLOCATED_NUMBERS = "numbers allocated per row over joints"


class Table(Enum):
    """A constant table about the chain, by its name in the code."""

    COORDINATES = "coordinate_of"
    MULTIPLIERS = "multiplier_of"
    PARENTS = "parent_of"


@dataclass(frozen=True)
class Pointer:
    """The numbers of an array, in a helper's arguments.

    ``row``: from this row on. ``entry``: from this entry on. ``as_read``: under the name under which expressions read
    an argument. ``plain``: vectors of joints seen as numbers.
    """

    storage: Storage
    row: int | None = None
    entry: int | None = None
    as_read: bool = False
    plain: bool = False


HelperArgument = int | str | Count | Table | Pointer


@dataclass(frozen=True)
class Call:
    """Call of a helper, a fixed loop of the templates."""

    helper: str
    arguments: tuple[HelperArgument, ...]


@dataclass(frozen=True)
class Helpers:
    """Calls of helpers that carry out a ``step`` (None: only copies); ``ordered``: sums have one order everywhere."""

    calls: tuple[Call, ...]
    comment: str = ""
    step: Step | None = None
    cost: Operations = field(default_factory=Operations)
    ordered: bool = True


@dataclass(frozen=True)
class Unused:
    """An argument that nothing reads."""

    storage: Storage


@dataclass(frozen=True)
class Statements:
    """Straight-line code.

    Attributes:
        body: statements.
        step_outputs: arrays that the statements fill.
        guards: accesses that get a guarded copy before the statements.
        unused: entries of arrays of which the statements read nothing.
        rows: arrays in rows of vectors that the first outputs fill.
        braces: whether the statements have a scope of their own.

    """

    body: Body
    step_outputs: tuple[Array, ...] = ()
    guards: tuple[Access, ...] = ()
    unused: tuple[Entry, ...] = ()
    rows: tuple[Storage, ...] = ()
    braces: bool = False


class LoopForm(Enum):
    """Kind of loop that computes a map: what it runs over, and whether in vectors."""

    ONCE = "no loop"
    VECTOR = "over vectors of joints, into an array of one number per joint"
    ROWS = "over rows i, and over vectors of joints j"
    JOINTS = "over joints or coordinates j"
    BRANCH = "over joints j, and from each towards the base"
    PAIRS = "over joints i, and over joints j"


@dataclass(frozen=True)
class Loop:
    """Body that runs for every element of an index set; ``first``: no earlier loop stores whole rows of the output."""

    comment: str
    form: LoopForm
    over: Over
    output: Storage
    operand: Operand
    body: Body
    mirror: bool = False
    first: bool = False


@dataclass(frozen=True)
class SparseChange:
    """A square matrix that gets a few entries of its own; the others are those of ``start``, or zero."""

    comment: str
    output: Storage
    start: Storage | None
    body: Body
    copies: bool


@dataclass(frozen=True)
class ColumnSums:
    """Sums over i of a body, for every joint j; ``rows`` of the output are summed, ``zeros`` are cleared."""

    comment: str
    over: Over
    output: Storage
    body: Body
    rows: tuple[int, ...]
    zeros: tuple[int, ...]
    pairs: int


@dataclass(frozen=True)
class TotalSums:
    """Sums of a body over joints; ``parts``: each output with the entries that the sums fill, and those cleared."""

    comment: str
    over: Over
    body: Body
    parts: tuple[tuple[Storage, tuple[int, ...], tuple[int, ...]], ...]


@dataclass(frozen=True)
class Invoke:
    """Call of an internal function that fills ``arrays`` of the program; ``blank``: an empty line stands before."""

    function: Function
    arguments: tuple[Storage, ...]
    outputs: tuple[Storage, ...]
    arrays: tuple[Array, ...]
    blank: bool = False


@dataclass(frozen=True)
class InvokeKernel:
    """Call of another kernel with slices of the arguments.

    Attributes:
        name: kernel.
        function: lowered kernel.
        arguments: array of each of the kernel's arguments, array that is passed (None: zeros), first entry.
        outputs: for each result the array that gets it, and the first entry.
        added: sums that get an output after the call.
        zeros: number of zeros to pass for arguments without an array.

    """

    name: str
    function: Function
    arguments: tuple[tuple[Array, Storage | None, int | None], ...]
    outputs: tuple[tuple[Storage, int | None], ...]
    added: tuple[Storage | None, ...]
    zeros: int


Item = Helpers | Unused | Statements | Loop | SparseChange | ColumnSums | TotalSums | Invoke | InvokeKernel


class Declared(Enum):
    """Kind of a declaration."""

    ARRAY = "an array in its layout"
    ALIGNED = "an array over pairs, aligned for vectors"
    VIEW = "vectors of joints, read joint by joint"
    ALIAS = "an argument under its short name"
    ZEROS = "zeros for arguments that are left out"


@dataclass(frozen=True)
class Declaration:
    """Declaration of a local; ``layout`` as in :class:`Storage`."""

    kind: Declared
    array: Array
    layout: Layout = Layout.FLAT
    local: Array | None = None


@dataclass
class Function:
    """A lowered kernel, or internal function of several kernels.

    ``columns``: names of the parameters that are columns of joints.
    """

    name: str
    scope: Scope
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    declarations: list[Declaration] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    meaning: str = ""
    columns: frozenset[str] = frozenset()

    def declare(self, declaration: Declaration) -> None:
        """Add a declaration unless it is there."""
        if declaration not in self.declarations:
            self.declarations.append(declaration)
