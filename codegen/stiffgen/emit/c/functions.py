# SPDX-License-Identifier: MIT
"""Kernel table -> C functions, as statements.

Every kernel is printed for one configuration; what runs over joints runs over lanes of joints there
(templates/lanes.c).
Kernels with a batch are printed once more with every number replaced by lanes of configurations, and, where CUDA is
asked for, with plain numbers: one configuration a thread.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import casadi as ca

from stiffgen.emit.c.statements import Named, Printed, grouped, print_statements, wrap_list
from stiffgen.lower.graph import Operations
from stiffgen.lower.scalar import Scalar
from stiffgen.lower.variant import Variant
from stiffgen.names import c_comment, comment
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kernels import Kernel, chain_kernels
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.program import Array, Operand, Over, Program, Step, as_operand
from stiffgen.symbolic.steps import (
    Gather,
    Map,
    Reduce,
    Scan,
    Shared,
    SparseSum,
    StraightLine,
    Sum,
    SumJoints,
    Term,
    Weights,
)


@dataclass(frozen=True)
class CFunction:
    """A C function: name without prefix, parameters, the lines in its braces, operations, and the helpers it calls."""

    name: str
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    lines: tuple[str, ...]
    operations: Operations
    calls: frozenset[str]
    meaning: str = ""
    columns: frozenset[str] = frozenset()
    """Names of what are columns of joints, of an internal function."""


@dataclass(frozen=True)
class Scope:
    """The chain that functions are about, and the prefix of what is internal to it."""

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
        """C name of the number of lanes that hold a row over joints."""
        return f"{self.prefix}BLOCKS"

    @property
    def padded(self) -> str:
        """C name of the number of lanes that a row over joints has."""
        return f"{self.prefix}PADDED"

    @property
    def padded_size(self) -> int:
        """Numbers in these lanes."""
        return self.scalar.filled(len(self.chain.joints))


@dataclass(frozen=True)
class VariantCode:
    """What was printed for a target: a function a kernel, and the internal functions that these share."""

    variant: Variant
    scopes: tuple[Scope, ...]
    shared: tuple[tuple[Scope, CFunction], ...]
    kernels: tuple[tuple[Kernel, CFunction], ...]

    @property
    def calls(self) -> frozenset[str]:
        """The helpers in C (templates) that the functions call."""
        return frozenset().union(*(function.calls for _, function in (*self.shared, *self.kernels)))


def print_kernels(chain: Chain, name: str, variant: Variant, options: SpringOptions) -> VariantCode:
    """Print the kernels of a chain for a target; ``name`` is the prefix of public functions."""
    return _VariantPrinter(chain, name, variant, options).code()


class _VariantPrinter:
    def __init__(self, chain: Chain, name: str, variant: Variant, options: SpringOptions) -> None:
        self.options = options
        self.chain = chain
        self.name = name
        self.variant = variant
        self.scopes: dict[str, Scope] = {}
        self.shared: dict[str, tuple[Scope, CFunction]] = {}
        self.finished: dict[str, Operations] = {}  # public functions printed so far

    def code(self) -> VariantCode:
        table = [
            kernel for kernel in chain_kernels(self.chain, self.options) if kernel.batch or not self.variant.batches
        ]
        kernels = tuple((kernel, self.kernel(kernel)) for kernel in table)
        return VariantCode(self.variant, tuple(self.scopes.values()), tuple(self.shared.values()), kernels)

    def kernel(self, kernel: Kernel) -> CFunction:
        name = kernel.scope_name(self.chain)
        prefix, title = f"{name}_" if name else "", comment(kernel.tip.link) if kernel.tip else ""
        scope = self.scopes.setdefault(prefix, Scope(kernel.scope(self.chain), prefix, self.variant.scalar, title))
        program = kernel.steps(self.chain)
        inputs = tuple(argument.array(self.chain) for argument in kernel.arguments)
        results = tuple(result.array(self.chain) for result in kernel.results)
        printer = _ProgramPrinter(self, scope, inputs, results)
        printer.program(program)
        function = printer.function(kernel.qualified_name)
        self.finished[function.name] = function.operations
        return function

    def shared_steps(self, scope: Scope, step: Shared) -> CFunction:
        """The internal function of steps that several kernels have in common, printed once."""
        name = scope.prefix + step.name
        if name not in self.shared:
            printer = _ProgramPrinter(self, scope, step.parameters, (step.result,))
            columns = frozenset(array.name for array in step.parameters if _is_columns(scope, array))
            printer.internal(step.steps, columns)
            self.shared[name] = scope, replace(printer.function(name), meaning=step.meaning, columns=columns)
        return self.shared[name][1]

    def shared_block(self, scope: Scope, step: StraightLine) -> CFunction:
        """The internal function of a shared block, printed once however many kernels call it."""
        name = scope.prefix + step.name
        if name not in self.shared:
            targets = (*(Array("J", t.shape) for t in step.outputs[: step.columns]), *step.outputs[step.columns :])
            block = self.block(scope, step, targets)
            function = CFunction(
                name,
                step.arguments,
                targets,
                tuple(block.lines),
                block.operations,
                block.calls,
                step.meaning,
                frozenset(target.name for target in targets[: step.columns]),
            )
            self.shared[name] = scope, function
        return self.shared[name][1]

    def block(
        self,
        scope: Scope,
        step: StraightLine,
        targets: tuple[Array, ...],
        local: Mapping[str, Sequence[str]] = MappingProxyType({}),
        private: Container[str] = (),
        zeros: dict[str, set[int]] | None = None,
        temporaries: int = 0,
        known: set[str] | None = None,
    ) -> Printed:
        """Statements of a block, filling the ``targets`` (arrays of the step's targets' shapes).

        Arguments named in ``local`` are arrays that earlier steps of the same kernel wrote, with the C text of their
        entries. What is always zero in the targets named in ``private`` is not stored, and noted in ``zeros``, where
        earlier steps have noted theirs. ``temporaries`` is the number of the first
        unnamed local, ``known`` the guarded locals that earlier blocks have defined.
        """
        chain = scope.chain
        # What enters linearly is guarded: a sliding joint's coordinate, a pose, a stiffness. Sines turn infinity into
        # NaN, and what earlier steps wrote comes from guarded numbers.
        base = chain.base_joints
        joints = chain.joints[base:]
        sliding = {joint.coordinate - base for joint in joints if joint.prismatic}
        given: list[ca.SX] = []
        inputs: list[tuple[ca.SX, str]] = []
        guards: dict[int, tuple[str, str]] = {}  # local name and source of the inputs that are guarded
        entries_of: dict[str, range] = {}
        for array in step.arguments:
            known_zeros = (zeros or {}).get(array.name, ())
            symbols = [ca.SX(0) if k in known_zeros else ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
            entries_of[array.name] = range(len(inputs), len(inputs) + array.size - len(known_zeros))
            for k, symbol in enumerate(symbols):
                if k in known_zeros:
                    continue
                text = local[array.name][k] if array.name in local else f"{array.name}[{k}]"
                if array.name not in local and (array.name != "q" or k in sliding):
                    between = "_" if max(array.shape, default=0) > 10 else ""  # 1, 11 and 11, 1
                    local_name = array.symbol + between.join(map(str, _indices(array, k)))
                    guards[len(inputs)] = local_name, text
                    text = local_name
                inputs.append((symbol, text))
            given.append(as_operand(array.shape, symbols))
        expressions = step.expressions(chain, *given)
        dense = ca.densify(expressions.result)
        entries = [dense[r, c] for r in range(dense.shape[0]) for c in range(dense.shape[1])]
        named = [Named(c_comment(section.title), _scalars(section.values)) for section in expressions.sections]
        m = len(chain.joints)
        columns = targets[: step.columns]
        by_rows = columns if self.variant.joint_lanes else ()
        outputs: list[tuple[str, ca.SX]] = []
        start = 0
        for target in targets:
            own, start = entries[start : start + target.size], start + target.size
            if target in by_rows:
                places = [f"{target.name}{r}_{c}" for r in range(6) for c in range(m)]
            elif target in columns:
                places = [element(target, k) for k in range(target.size)]
            else:
                places = [f"{target.name}[{k}]" for k in range(target.size)]
            skipped = set()
            if zeros is not None and target.name in private and target not in columns:
                skipped = zeros[target.name] = {k for k, value in enumerate(own) if value.is_zero()}
            outputs += [(place, own[k]) for k, place in enumerate(places) if k not in skipped]
        printed = print_statements(
            inputs,
            outputs,
            named,
            heading=step.heading,
            variant=self.variant,
            wide=() if self.variant.joint_lanes else {text for _, text in inputs},
            wide_outputs=not self.variant.joint_lanes,
            define=6 * m * len(by_rows),
            temporaries=temporaries,
            poison="poison" if known is None or "poison" not in known else "poison_of_gradients",
        )
        lines, values = list(printed.lines), list(printed.values)
        for target in by_rows:
            lines += _rows(scope, target, values[: target.size])
            values = values[target.size :]
        guarded = [guards[number] for number in sorted(printed.reads) if number in guards]
        if known is not None:
            guarded = [(name, source) for name, source in guarded if name not in known]
            known |= {printed.poison, *(name for name, _ in guarded)}
        number, guard = self.variant.number, self.variant.guard
        opening = [f"const {number} {name} = {guard}({source});" for name, source in guarded]
        opening += [
            f"(void){local[name][0].partition('[')[0] if name in local else name};"
            for name, numbers in entries_of.items()
            if printed.reads.isdisjoint(numbers) and (numbers or name not in local)
        ]
        return replace(
            printed,
            lines=[*opening, *lines],
            operations=printed.operations + Operations(add=len(guarded), multiply=len(guarded)),
            calls=printed.calls | ({guard} if guarded else set()) | ({"put_rows"} if by_rows else set()),
        )


def _rows(scope: Scope, target: Array, texts: list[str]) -> list[str]:
    """Put numbers, row by row, into an array of lanes: a compiler gathers them without a detour through memory."""
    count, m = target.shape
    lines = ["", f"const lanes rows_of_{target.name}[{count}][{scope.padded}] = {{"]
    for k in range(count):
        lines += _indented(wrap_list("{" + ", ".join(grouped(texts[m * k : m * (k + 1)], scope.scalar)) + "},"), 1)
    return [*lines, "};", f"put_rows(rows_of_{target.name}[0], {count}, {scope.padded}, {target.name}[0]);"]


def suffix_of(variant: Variant) -> str:
    """What the name of a kernel's function has behind it: nothing where it is public."""
    return (variant.suffix or "_thread") if variant.batches else ""


def element(array: Array, k: int) -> str:
    """C text of the k-th entry of a local array."""
    return array.name + "".join(f"[{index}]" for index in _indices(array, k))


def _indices(array: Array, k: int) -> list[int]:
    indices = []
    for extent in reversed(array.shape):
        k, index = divmod(k, extent)
        indices.append(index)
    return indices[::-1]


def _scalars(values: dict[str, ca.SX]) -> list[tuple[str, ca.SX]]:
    result = []
    for name, value in values.items():
        rows, columns = value.shape
        for r in range(rows):
            for c in range(columns):
                tag = "" if rows == columns == 1 else f"{r}" if columns == 1 else f"{r}{c}"
                result.append((name + tag, value[r, c]))
    return result


_RANGES = {
    Over.UPPER: ("j = i", "j < {size}", "i", "{size}"),
    Over.STRICTLY_UPPER: ("j = i + 1", "j < {size}", "i + 1", "{size}"),
    Over.LOWER: ("j = 0", "j <= i", "0", "i + 1"),
    Over.STRICTLY_LOWER: ("j = 0", "j < i", "0", "i"),
    Over.BASE: ("j = 0", "j < {base}", "0", "{base}"),
}
"""Loop over j in row i: start, condition, first, one past the last."""


def _is_columns(scope: Scope, array: Array) -> bool:
    return array.shape == (6, len(scope.chain.joints))


_ROWS = Over.JOINTS, Over.COORDINATES
"""What a map over rows in lanes runs over."""


class _ProgramPrinter:
    """Collects the declarations and statements of one function: of a kernel, or of what several kernels share."""

    def __init__(
        self, printer: _VariantPrinter, scope: Scope, inputs: tuple[Array, ...], results: tuple[Array, ...]
    ) -> None:
        self.printer = printer
        self.variant = printer.variant
        self.calls: set[str] = set()
        self.scope = scope
        self.inputs = inputs
        self.results = results
        self.columns: frozenset[str] = frozenset()  # inputs that other functions of this program have written
        self.declarations: list[str] = []
        self.lines: list[str] = []
        self.operations = Operations()
        self.zero_rows: dict[str, set[int]] = {}
        self.of_joints: set[str] = set()  # arrays with a column a joint, of which zero_rows has rows, not entries
        self.renamed: dict[str, Array] = {}
        self.filled: set[str] = set()
        self.lane_arrays: set[str] = set()
        self.flat: set[str] = set()
        self.unguarded: set[str] = set()  # results that may overflow, not stored through put_row or put_entries
        self.temporaries = 0
        self.scoped = False
        self.guards: set[str] = set()  # guarded copies of arguments' entries
        self.packed: dict[str, Array] = {}  # what of plain arrays is copied to lanes of joints
        self.weights: dict[str, tuple[str, bool]] = {}  # of weights: the array that has them, and whether transposed
        self.by_joints: set[str] = set()  # arrays that are read joint by joint
        self.read_whole: set[str] = set()  # arrays that helpers read: what is always zero in them is stored, too
        self.entries: dict[str, list[str]] = {}  # of arrays that are not stored: the C texts of their entries

    def program(self, program: Program) -> None:
        """Print a kernel's program."""
        self._arguments(program)
        for step in program:
            self._step(step)

    def internal(self, program: Program, columns: frozenset[str]) -> None:
        """Print steps that kernels call: what they are given was guarded, and columns of joints are lanes."""
        self._readers(program)
        self.columns = columns
        if self.variant.joint_lanes:
            self.lane_arrays |= columns
        self.flat |= {array.name for array in self.inputs if array.name not in columns}
        for step in program:
            self._step(step)

    def _readers(self, program: Program) -> list[Map | Gather | Reduce]:
        """Note how arrays are read; the maps among the steps."""
        whole = [step.whole() if isinstance(step, SparseSum) else step for step in program]
        maps = [step for step in whole if isinstance(step, (Map, Gather, Reduce))]
        self.by_joints = {operand.array.name for step in maps for operand in step.operands if operand.at}
        self.read_whole = {array.name for step in program for array in _handed_on(step)}
        return maps

    def _arguments(self, program: Program) -> None:
        """Give the arguments of the program's maps their short names, as copies in which infinity has become NaN.

        Kernels that end in sums over pairs need no copies: no sum and no product brings a number that is not finite
        back among the finite ones, so that guarding the sums is enough (put_row).
        """
        maps = self._readers(program)
        pairs = any(isinstance(step, Gather) or (isinstance(step, Map) and step.over.is_pairs) for step in maps)
        guarded = self.variant.joint_lanes and not pairs
        read = {
            operand.array.name
            for step in maps
            for operand in step.operands
            if operand.at != "j" or not self.variant.joint_lanes  # else copied to lanes
        }
        # Statements that take sines and name frames do so in braces of their own, where there are several.
        blocks = [step for step in program if isinstance(step, StraightLine) and not step.name]
        self.scoped = len(blocks) > 1 and any(array.name == "q" for step in blocks for array in step.arguments)
        used = {array.name for step in program for array in step.reads}
        for array in self.inputs:
            if array.name not in used:
                self.lines.append(f"(void){array.name};")
            if array.name not in read:
                continue
            short = self.renamed[array.name] = Array(array.symbol, array.shape or (1,))
            if not guarded:
                if short.name != array.name:
                    self._alias(array, short)
                continue
            self._declare(short, "")
            self.operations = self.operations + Operations(add=array.size, multiply=array.size)
            into = short.name if len(array.shape) < 2 else f"{short.name}[0]"
            self._call("copy_finite", array.name, array.size, into)

    def _alias(self, array: Array, short: Array) -> None:
        if len(array.shape) < 2:
            self.declarations.append(f"const {self.variant.number} *const {short.name} = {array.name};")
        else:
            row = f"[{array.shape[1]}]"
            declared = f"const {self.variant.number} (*const {short.name}){row}"
            self.declarations.append(f"{declared} = (const {self.variant.number} (*){row}){array.name};")

    def function(self, name: str) -> CFunction:
        self._guard_results()
        lines = (*self.declarations, *([""] if self.declarations else []), *self.lines)
        return CFunction(name, self.inputs, self.results, lines, self.operations, frozenset(self.calls))

    def _guard_results(self) -> None:
        """Make NaN of what overflowed; the stores of lanes do that themselves."""
        for array in self.results if self.variant.joint_lanes else ():
            if array.name in self.unguarded:
                self.operations = self.operations + Operations(add=array.size, multiply=array.size)
                self.lines += ["", "/* NaN in place of infinity */"]
                self._call("copy_finite", array.name, array.size, array.name)

    def _store(self, targets: Iterable[Array], arguments: Iterable[Array]) -> None:
        """Note results that are to be guarded. Sines of q are bounded, and so is what depends on them alone."""
        chain = self.scope.chain
        slides = any(joint.prismatic for joint in chain.joints[chain.base_joints :])
        if slides or any(array.name != "q" for array in arguments):
            self.unguarded |= {target.name for target in targets if self._public(target)}

    def _step(self, step: Step) -> None:
        if isinstance(step, StraightLine):
            self._block(step)
        elif isinstance(step, Sum):
            self._sum(step)
        elif isinstance(step, SumJoints):
            (self._spread if step.spread else self._sum_joints)(step)
        elif isinstance(step, SparseSum):
            self._sparse_sum(step)
        elif isinstance(step, Weights):
            self._weights(step)
        elif isinstance(step, Gather):
            self._gather(step)
        elif isinstance(step, Reduce):
            self._reduce(step)
        elif isinstance(step, Scan):
            self._scan(step)
        elif isinstance(step, Shared):
            self._shared(step)
        elif isinstance(step, Map):
            self._map(step)

    def _shared(self, step: Shared) -> None:
        function = self.printer.shared_steps(self.scope, step)
        if not self._public(step.output):
            self._declare(step.output, "")
        self.operations = self.operations + function.operations
        given = ", ".join(array.name for array in (*step.arguments, step.output))
        self.lines += ["", f"{function.name}{self.variant.suffix}({given});"]

    def _block(self, step: StraightLine) -> None:
        # Columns of joints are lanes; the public Jacobian is copied out of them.
        columns = tuple(
            Array("J", t.shape) if self.variant.joint_lanes and self._public(t) else t
            for t in step.outputs[: step.columns]
        )
        targets = (*columns, *step.outputs[step.columns :])
        for target in targets:
            if target in columns:
                if not self._public(target):
                    self._declare(target, "j")
            elif not self._public(target):
                self.flat.add(target.name)
                self._note(f"{self.variant.number} {target.name}[{target.size}];")
        if step.name:
            function = self.printer.shared_block(self.scope, step)
            operations = function.operations
            into = ", ".join([*map(self._passed, columns), *(target.name for target in targets[step.columns :])])
            self.lines.append(f"{function.name}{self.variant.suffix}({self._given(step)}, {into});")
        else:
            private = {target.name for target in targets if not self._public(target)} - self.read_whole
            inputs = {array.name for array in self.inputs} - self.columns
            local = {a.name: self._texts(a) for a in step.arguments if a.name not in inputs}
            zeros = {name: set(known) for name, known in self.zero_rows.items()}
            for array in step.arguments:
                if array.name in self.of_joints:  # of which whole rows are known to be zero
                    count = array.shape[1]
                    rows = self.zero_rows.get(array.name, ())
                    zeros[array.name] = {row * count + column for row in rows for column in range(count)}
            block = self.printer.block(
                self.scope, step, targets, local, private, zeros, self.temporaries,
                set() if self.scoped else self.guards,
            )  # fmt: skip
            self.zero_rows |= {name: zeros[name] for name in private & zeros.keys()}
            lines = ["{", *_indented(block.lines, 1), "}"] if self.scoped else block.lines
            operations, self.temporaries = block.operations, block.temporaries
            self.calls |= block.calls
            self.lines += ["", *lines] if self.lines else lines
        self.operations = self.operations + operations
        self._store(step.outputs, step.arguments)
        if targets != step.outputs:
            public = step.outputs[0]
            first = f"(const {self.variant.scalar.name} *)J"
            self._call("copy_rows", first, f"LANES * {self.scope.padded}", public.shape[0], public.name)

    def _texts(self, array: Array) -> list[str]:
        """C texts of the entries of an array that an earlier step wrote."""
        if array.name in self.lane_arrays:
            view = self._view(array)
            return [element(Array(view, array.shape), k) for k in range(array.size)]
        return [self._write(Operand(array, ""), k) for k in range(array.size)]

    def _passed(self, target: Array) -> str:
        """C text of the array of columns that a block's function is to fill."""
        if not self.variant.joint_lanes and self._public(target):
            return f"({self.variant.number} (*)[{target.shape[1]}]){target.name}"
        return target.name

    def _given(self, step: StraightLine) -> str:
        return ", ".join(array.name for array in step.arguments)

    def _public(self, array: Array) -> bool:
        return array.name in {result.name for result in self.results}  # whatever shape a block fills it in

    def _declare(self, array: Array, at: str) -> None:
        """Declare a local array that is written as a whole (at ""), by joints ("j") or by pairs of joints ("ij")."""
        if at == "j" and self.variant.joint_lanes:
            self.lane_arrays.add(array.name)
            self._note(f"lanes {array.name}[{array.shape[0]}][{self.scope.padded}];")
        else:
            self._declare_numbers(array, at)

    def _declare_numbers(self, array: Array, at: str) -> None:
        flat = at == "ij" and len(array.shape) == 2  # like a public result
        if flat:
            self.flat.add(array.name)
        extents = f"[{array.size}]" if flat else "".join(f"[{extent}]" for extent in array.shape)
        aligned = self.variant.aligned if at == "ij" else ""
        self._note(f"{aligned}{self.variant.number} {array.name}{extents};")

    def _note(self, declaration: str) -> None:
        if declaration not in self.declarations:
            self.declarations.append(declaration)

    def _sparse_sum(self, step: SparseSum) -> None:
        if step.start is not None and self.zero_rows.get(step.start.name):
            self._map(step.whole())  # a loop would read entries that were never stored
            return
        pairs = step.start is not None and step.start.name in self.flat
        in_place = step.start is not None and not pairs and not self._public(step.output)
        if not self._public(step.output) and not in_place:
            self._declare(step.output, "ij" if pairs else "")
        elif pairs:
            self._store([step.output], self.inputs)
        self.lines += ["", f"/* {step.comment} */"] if self.lines else [f"/* {step.comment} */"]
        inputs: list[tuple[ca.SX, str]] = []
        taken = []
        for array in step.reads:
            symbols = [ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
            inputs += [(symbol, self._write(Operand(array, ""), k)) for k, symbol in enumerate(symbols)]
            taken.append(as_operand(array.shape, symbols))
        changed = ca.densify(step.expression(*taken[len(step.reads) - len(step.operands) :]))
        whole = ca.densify(step.whole().expression(*taken))
        n = step.output.shape[0]
        changes = [k for k in range(n * n) if not changed[k // n, k % n].is_zero()]
        texts = [self._write(Operand(step.output, ""), k) for k in range(n * n)]
        outputs = []
        if in_place:  # the entries that do not change are read where they are
            assert step.start is not None
            texts = [self._write(Operand(step.start, ""), min(k, k % n * n + k // n)) for k in range(n * n)]
            for k in changes:
                texts[k] = f"{step.output.name}{k // n}{k % n}"
            self.entries[step.output.name] = texts
        elif step.start is not None:
            self._call("copy_symmetric", self._first(step.start), n, self._first(step.output))
        for before, k in zip([-1, *changes], [*changes, n * n], strict=True):
            # What lies between is 0, one statement a run, in the order of the places: compilers make wide stores of it.
            if step.start is None and k - before > 1:
                outputs.append((" = ".join(reversed(texts[before + 1 : k])), ca.SX(0)))
            if k < n * n:
                outputs.append((texts[k], whole[k // n, k % n]))
        every = not self.variant.joint_lanes
        printed = print_statements(
            inputs,
            outputs,
            wide={text for _, text in inputs} if every else (),
            variant=self.variant,
            wide_outputs=every,
            define=len(changes) if in_place else 0,
            temporaries=self.temporaries,
        )
        self.temporaries = printed.temporaries
        self.calls |= printed.calls
        self.operations = self.operations + printed.operations
        self.lines += printed.lines

    def _first(self, array: Array) -> str:
        """C text of a pointer to an array's numbers."""
        local = self.renamed.get(array.name, array)
        flat = len(array.shape) == 1 or self._public(array) or array.name in self.flat
        return local.name if flat else f"{local.name}[0]"

    def _map(self, step: Map) -> None:
        rows = self._by_rows(step)
        inputs, wide, results = self._run(step.operands, step.expression, rows=rows or step.over in _ROWS)
        target = step.output
        zeros: set[int] = set()
        whole = target.at == "" and target.array.name not in self.by_joints
        kept = self._public(target.array) or target.array.name in self.read_whole
        if not kept and (whole or target.at == "j"):
            # Entries, or rows of all joints, that are always zero are neither stored nor read.
            zeros = {k for k, value in enumerate(results) if value.is_zero()}
            self.zero_rows[target.array.name] = zeros
            if target.at == "j" and len(target.array.shape) == 2:
                self.of_joints.add(target.array.name)
            if len(zeros) == len(results):
                return
        if not self._public(target.array):
            self._declare(target.array, target.at if len(target.array.shape) > 1 else "")
        vector = self._is_vector_row(step)
        places = ["row[j]"] if rows or vector else [self._write(target, k) for k in range(target.count)]
        outputs = [(places[k], value) for k, value in enumerate(results) if k not in zeros]
        printed = print_statements(
            inputs,
            outputs,
            wide=wide,
            variant=self.variant,
            wide_outputs=rows or step.over in _ROWS or not self.variant.joint_lanes,
            temporaries=self.temporaries,
        )
        self.temporaries = self.temporaries if step.over is not Over.ONCE else printed.temporaries
        self.calls |= printed.calls
        self.operations = self.operations + printed.operations.times(
            sum(1 for _ in step.over.indices(self.scope.chain))
        )
        self.lines += ["", f"/* {step.comment} */"] if self.lines else [f"/* {step.comment} */"]
        if not rows and not vector:
            self._store([target.array], self.inputs)
        if vector:
            self.lines += self._vector_row(step, printed)
        else:
            self.lines += self._row_loops(step, printed) if rows else self._loops(step, printed)

    def _run(
        self, operands: Sequence[Operand], body: Callable[..., ca.SX], *, rows: bool
    ) -> tuple[list[tuple[ca.SX, str]], set[str], list[ca.SX]]:
        """A body's inputs with their C texts, the texts that are entries of rows, and its entries; ``rows`` in rows."""
        inputs: list[tuple[ca.SX, str]] = []
        wide: set[str] = set()
        taken = []
        for operand in operands:
            entries = []
            for k in range(operand.count):
                if k in self.zero_rows.get(operand.array.name, ()):
                    entries.append(ca.SX(0))
                    continue
                symbol = ca.SX.sym(f"{operand.array.name}_{operand.at}{k}")
                text, is_wide = self._read(operand, k, rows=rows)
                inputs.append((symbol, text))
                wide |= {text} if is_wide else set()
                entries.append(symbol)
            taken.append(as_operand(operand.shape, entries))
        dense = ca.densify(body(*taken))
        return inputs, wide, [dense[r, c] for r in range(dense.shape[0]) for c in range(dense.shape[1])]

    def _by_rows(self, step: Map) -> bool:
        """Whether a map over pairs runs over rows i, and over j in lanes."""
        return (
            self.variant.joint_lanes
            and step.over not in (Over.ONCE, *_ROWS, Over.ON_THE_WAY)
            and step.output.count == 1
        )

    def _is_vector_row(self, step: Map) -> bool:
        """Whether a map over joints fills a vector, one number a joint, in lanes."""
        return self.variant.joint_lanes and step.over in _ROWS and len(step.output.array.shape) == 1

    def _vector_row(self, step: Map, printed: Printed) -> list[str]:
        name, size = step.output.array.name, self._count(step.over)
        return [
            "{",
            f"    lanes row[{self.scope.padded}];",
            f"    for (int j = 0; j < {self.scope.blocks}; ++j) {{",
            *_indented(printed.lines, 2),
            "    }",
            f"    put_entries({name}, {size}, 0, row, 0, {size});",
            "}",
        ]

    def _row_loops(self, step: Map, printed: Printed) -> list[str]:
        name, size = step.output.array.name, self.scope.size
        _, _, first, last = self._range(step)
        # The first map over pairs stores whole rows: what it does not cover is overwritten.
        put = f"put_entries({name}, {size}, i, row, {first}, {last});"
        if name not in self.filled:
            put = f"put_row({name}, {size}, i, row, {self.scope.blocks});"
        self.filled.add(name)
        return [
            f"for (int i = 0; i < {self._rows_of(step)}; ++i) {{",
            f"    lanes row[{self.scope.padded}];",
            f"    for (int j = 0; j < {self.scope.blocks}; ++j) {{",
            *_indented(printed.lines, 2),
            "    }",
            f"    {put}",
            "}",
            *self._mirrored(step),
        ]

    def _loops(self, step: Map, printed: Printed) -> list[str]:
        size = self.scope.size
        if step.over is Over.ONCE:
            return printed.lines
        if step.over in _ROWS:
            head = f"for (int j = 0; j < {self._blocks(step.over)}; ++j) {{"
            return [*self._rolled, head, *_indented(printed.lines, 1), "}"]
        target, lines = step.output, printed.lines
        if step.over is Over.ON_THE_WAY:
            self.calls.add(f"{self.scope.prefix}parent_of")
            mirrored = [f"{self._pair(target.array, 'j', 'i')} = {self._pair(target.array, 'i', 'j')};"]
            return [
                f"for (int j = 0; j < {size}; ++j) {{",
                f"    for (int i = j; i >= 0; i = {self.scope.prefix}parent_of[i]) {{",
                *_indented([*lines, *(mirrored if step.mirror else [])], 2),
                "    }",
                "}",
            ]
        start, condition, _, _ = self._range(step)
        if target.count > 1 and self._public(target.array):
            position = f"{target.array.name}[{target.count} * ({size} * i + j)]"
            lines = [f"{self.variant.number} *const entry = &{position};", *lines]
        return [
            *self._rolled,
            f"for (int i = 0; i < {self._rows_of(step)}; ++i) {{",
            *_indented(self._rolled, 1),
            f"    for (int {start}; {condition}; ++j) {{",
            *_indented(lines, 2),
            "    }",
            "}",
            *self._mirrored(step),
        ]

    def _range(self, step: Map) -> list[str]:
        own = self.scope.chain.base_joints
        return [text.format(size=self.scope.size, base=own) for text in _RANGES[step.over]]

    def _rows_of(self, step: Map) -> str:
        """Number of rows i that a map over pairs runs over."""
        return str(self.scope.chain.base_joints) if step.over is Over.BASE else self.scope.size

    def _mirrored(self, step: Map) -> list[str]:
        if not step.mirror:
            return []
        half = {Over.UPPER: "upper", Over.LOWER: "lower"}[step.over]
        return [self._called(f"mirror_{half}", step.output.array.name, self.scope.size)]

    def _call(self, helper: str, *arguments: object) -> None:
        self.lines.append(self._called(helper, *arguments))

    def _called(self, helper: str, *arguments: object) -> str:
        """C text of a call of a helper (templates/macros.j2)."""
        name = helper + self.variant.suffix
        self.calls.add(name)
        if helper == "copy_finite":
            self.calls.add(self.variant.guard)
        if helper.startswith("sum_") and self.variant.lanes == "configurations":
            self.calls.add(self.variant.spread)
        return f"{name}({', '.join(map(str, arguments))});"

    def _count(self, over: Over) -> str:
        """C text of the number of joints or coordinates that a map runs over."""
        if over is not Over.COORDINATES:
            return self.scope.size
        return str(self.scope.chain.dof - self.scope.chain.base_joints) if self.scope.chain.floating else "N"

    @property
    def _rolled(self) -> list[str]:
        """What stands before a loop over joints in a batch."""
        return ["ROLLED"] if self.variant.lanes == "configurations" else []

    def _blocks(self, over: Over = Over.JOINTS) -> str:
        return self.scope.blocks if self.variant.joint_lanes else self._count(over)

    def _pair(self, array: Array, first: str, second: str) -> str:
        return f"{array.name}[{self.scope.size} * {first} + {second}]"

    def _read(self, operand: Operand, k: int, *, rows: bool) -> tuple[str, bool]:
        """C text of an operand's k-th entry, and whether it is lanes (of joints ``j``)."""
        array = operand.array
        if operand.at == "ij" and array.name in self.weights:
            return self._weight(operand, k), True
        if operand.at == "j" and rows and self.variant.joint_lanes and array.name not in self.lane_arrays:
            array = self._packed(array)
        if array.name in self.lane_arrays:
            if operand.at == "j" and rows:
                return f"{array.name}[{k}][j]", True
            return f"{self._view(array)}[{k}][{operand.at}]", False
        return self._write(operand, k), not self.variant.joint_lanes

    def _view(self, array: Array) -> str:
        """C name under which lanes of joints are read joint by joint."""
        view = f"{array.name}_of"
        row = f"[LANES * {self.scope.padded}]"
        scalar = self.variant.scalar.name
        declared = f"const {scalar} (*const {view}){row}"
        self._note(f"{declared} = (const {scalar} (*){row}){array.name}; /* joint by joint */")
        return view

    def _packed(self, array: Array) -> Array:
        """The rows over joints of a plain array, copied to lanes of joints."""
        if array.name not in self.packed:
            rows = 1 if len(array.shape) == 1 else array.shape[0]
            packed = self.packed[array.name] = Array(f"rows_of_{array.name}", (rows, array.shape[-1]))
            self._declare(packed, "j")
            columns = array.shape[-1]
            size = self.scope.size if columns == len(self.scope.chain.joints) else str(columns)
            self._call("pack_rows", self._numbers(array), rows, size, self.scope.padded, f"{packed.name}[0]")
        return self.packed[array.name]

    def _numbers(self, array: Array) -> str:
        """C text of a pointer to the numbers of an argument or a plain local array."""
        public = array.name in {each.name for each in (*self.inputs, *self.results)}
        if public or len(array.shape) == 1 or array.name in self.flat:
            return array.name
        return f"{array.name}[0]" if len(array.shape) == 2 else f"{array.name}[0][0]"

    def _spread(self, step: SumJoints) -> None:
        source, target, prefix = step.source, step.output, self.scope.prefix
        m, M = len(self.scope.chain.joints), self.scope.size
        if step.columns:
            self._declare_numbers(target, "")
        else:
            self.flat.add(target.name)
            self._note(f"{self.variant.number} {target.name}[{target.size}];")
        self.lines += ["", "/* joints that move together share a coordinate */"]
        rest = M, f"{prefix}coordinate_of", f"{prefix}multiplier_of", self._numbers(target)
        if step.columns or len(source.shape) == 1:
            self.operations = self.operations + Operations(multiply=target.size)
            self._call("spread_columns", target.size // m, self._numbers(source), *rest)
        else:
            self.operations = self.operations + Operations(multiply=target.size + m * m)
            self._call("spread_pairs", self._numbers(source), target.size // (m * m), *rest)

    def _weights(self, step: Weights) -> None:
        """Weights as rows of lanes, zero outside; or where the source has them, folded if both triangles count."""
        M, m = self.scope.size, len(self.scope.chain.joints)
        depth = step.source.size // (m * m)
        source, between = self._numbers(step.source), step.over is Over.ON_THE_WAY
        if not self.variant.joint_lanes and not step.mirror and not between:
            self.weights |= {step.output.name: (source, False), step.transposed.name: (source, True)}
            return
        folded = sum(i != j for i, j in step.over.indices(self.scope.chain)) if step.mirror else 0
        self.operations = self.operations + Operations(add=depth * folded)
        self.lines += ["", f"/* {step.output.name}_ij: what the pair {step.over} hands back */"]
        targets = [step.output, step.transposed] if self.variant.joint_lanes else [step.output]
        for array in targets:
            if self.variant.joint_lanes:
                self._note(f"lanes {array.name}[{M} * {depth}][{self.scope.padded}];")
            else:
                self._note(f"{self.variant.number} {array.name}[{array.size}];")
            self.weights[array.name] = array.name, False
        if not self.variant.joint_lanes:
            self.weights[step.transposed.name] = step.output.name, between  # folded pairs are symmetric
        into = [f"{array.name}[0]" if self.variant.joint_lanes else array.name for array in targets]
        shape = [M, *([depth, self.scope.padded] if self.variant.joint_lanes else [])]
        if between:
            self.calls.add(f"{self.scope.prefix}parent_of")
            self._call("weigh_branches", source, M, f"{self.scope.prefix}parent_of", *shape[2:], *into)
            return
        if not self.variant.joint_lanes:
            self._call("fold_pairs", source, *shape, *into)
            return
        own = self.scope.chain.base_joints
        if step.over is Over.BASE:
            self._call("weigh_base", source, *shape, own, *into)
            return
        upper, diagonal = step.over.upper, step.over.diagonal
        self._call("weigh_triangle", source, *shape, int(upper), int(diagonal), int(step.mirror), *into)
        if step.without_base:
            self._call("clear_base", *shape[1:], own, *into)

    def _weight(self, operand: Operand, k: int) -> str:
        """C text of a weight of the pair (i, j)."""
        name, transposed = self.weights[operand.array.name]
        depth = operand.count
        if self.variant.joint_lanes:
            row = "i" if depth == 1 else f"{depth} * i + {k}"
            return f"{name}[{row}][j]"
        first, second = ("j", "i") if transposed else ("i", "j")
        place = f"{self.scope.size} * {first} + {second}"
        return f"{name}[{place}]" if depth == 1 else f"{name}[{depth} * ({place}) + {k}]"

    def _sums(
        self, inputs: list[tuple[ca.SX, str]], wide: set[str], results: list[ca.SX], *, whole: bool = False
    ) -> tuple[list[str], Printed]:
        """Declaration of sums of a body's entries that are not always zero, and the statements that add to them.

        With ``whole`` there is room for squares of lanes.
        """
        stored = [value for value in results if not value.is_zero()]
        printed = print_statements(
            inputs,
            [(f"sum[{k}]", value) for k, value in enumerate(stored)],
            wide=wide,
            variant=self.variant,
            wide_outputs=True,
            temporaries=self.temporaries,
            accumulate=True,
        )
        self.calls |= printed.calls
        room = self.variant.scalar.filled(len(stored)) if whole and self.variant.joint_lanes else len(stored)
        opening = [f"{self.variant.row} sum[{room}];", "memset(sum, 0, sizeof sum);"]
        if not self.variant.lanes:
            opening = [f"{self.variant.row} sum[{room}] = {{{self.variant.scalar.constant(0.0)}}};"]
        return opening, printed

    def _gather(self, step: Gather) -> None:
        size, target = self.scope.size, step.output
        pairs = sum(1 for _ in step.over.indices(self.scope.chain, without_base=step.without_base))
        source = self._weighted(step) if self.variant.joint_lanes and step.over is not Over.BASE else None
        if source is not None:
            rows, padded, blocks = source.shape[0], self.scope.padded, self.scope.blocks
            weights = next(self.weights[operand.array.name][0] for operand in step.operands if operand.at == "ij")
            given, into = (f"{array.name}[0]" for array in (source, target))
            self._declare(target, "j")
            self.operations = self.operations + Operations(add=rows, multiply=rows).times(pairs)
            self.lines += ["", f"/* {step.comment} */"]
            self._call("weighted_sums", given, rows, size, padded, blocks, f"{weights}[0]", into)
            return
        inputs, wide, results = self._run(step.operands, step.expression, rows=True)
        zeros = {k for k, value in enumerate(results) if value.is_zero()}
        self.zero_rows[target.name] = set() if target.name in self.read_whole else zeros
        self.of_joints.add(target.name)
        self._declare(target, "j")
        opening, printed = self._sums(inputs, wide, results)
        self.operations = self.operations + printed.operations.times(pairs)
        start, stop = ("0", str(self.scope.chain.base_joints) if step.over is Over.BASE else size)
        if not self.variant.joint_lanes:
            if step.without_base or step.over is Over.BASE:
                raise NotImplementedError("maps over the pairs of a base's own joints go back in lanes of joints only")
            start, stop = {
                Over.UPPER: ("0", "j + 1"), Over.STRICTLY_UPPER: ("0", "j"),
                Over.LOWER: ("j", size), Over.STRICTLY_LOWER: ("j + 1", size),
            }.get(step.over, (start, stop))  # fmt: skip
        kept = [k for k in range(target.shape[0]) if k not in zeros]
        stores = [f"{target.name}[{k}][j] = sum[{index}];" for index, k in enumerate(kept)]
        if not zeros:
            stores = [f"for (int k = 0; k < {len(kept)}; ++k) {{", f"    {target.name}[k][j] = sum[k];", "}"]
        elif target.name in self.read_whole:
            stores += [f"{target.name}[{k}][j] = {self.variant.row_zero};" for k in sorted(zeros)]
        self.lines += [
            "",
            f"/* {step.comment} */",
            *self._rolled,
            f"for (int j = 0; j < {self._blocks()}; ++j) {{",
            *_indented(opening, 1),
            *_indented(self._rolled, 1),
            f"    for (int i = {start}; i < {stop}; ++i) {{",
            *_indented(printed.lines, 2),
            "    }",
            *_indented(stores, 1),
            "}",
        ]

    def _weighted(self, step: Gather) -> Array | None:
        """The columns of which a gather is nothing but the sum, each with its weight."""
        at = {operand.at: operand for operand in step.operands}
        if len(step.operands) != 2 or at.keys() != {"i", "ij"} or at["ij"].count != 1:
            return None
        columns = at["i"].array
        if columns.name not in self.lane_arrays or self.zero_rows.get(columns.name):
            return None
        symbols = {operand: ca.SX.sym("x", *operand.shape) for operand in step.operands}
        weighed = ca.densify(step.expression(*(symbols[operand] for operand in step.operands)))
        sums = ca.densify(symbols[at["i"]] * symbols[at["ij"]])
        return columns if sums.shape == weighed.shape and ca.is_equal(sums, weighed, 1) else None

    def _reduce(self, step: Reduce) -> None:
        inputs, wide, results = self._run(step.operands, step.expression, rows=True)
        opening, printed = self._sums(inputs, wide, results, whole=True)
        count = sum(1 for _ in step.over.indices(self.scope.chain))
        self.operations = self.operations + printed.operations.times(count)
        lines = [
            *opening,
            *self._rolled,
            f"for (int j = 0; j < {self._blocks(step.over)}; ++j) {{",
            *_indented(printed.lines, 1),
            "}",
        ]
        count = sum(not value.is_zero() for value in results)
        source = "sum"
        if self.variant.joint_lanes:
            room = self.variant.scalar.filled(count)
            lines += [
                f"lanes total_of[{room} / LANES];",
                self._called("add_lanes", "sum", count, "total_of"),
                f"const {self.variant.scalar.name} *const total = (const {self.variant.scalar.name} *)total_of;",
            ]
            source = "total"
        first = 0
        for target in step.outputs:
            own, results = results[: target.size], results[target.size :]
            first, assigned = self._distribute(target, own, source, first)
            lines += assigned
        self.lines += ["", f"/* {step.comment} */", "{", *_indented(lines, 1), "}"]

    def _distribute(self, target: Array, values: list[ca.SX], source: str, first: int) -> tuple[int, list[str]]:
        """Statements that give the sums from number ``first`` on to a target, and the number of the next one."""
        if not self._public(target):
            self.flat.add(target.name)
            self._note(f"{self.variant.number} {target.name}[{target.size}];")
        every = self._public(target) or target.name in self.read_whole
        if not every:
            self.zero_rows[target.name] = {k for k, value in enumerate(values) if value.is_zero()}
        kept = [k for k, value in enumerate(values) if not value.is_zero()]
        n = target.shape[0] if len(target.shape) == 2 else 0
        upper = [n * i + j for i in range(n) for j in range(i, n)]
        if kept == upper and n > 2:
            return first + len(kept), [self._called("put_upper", f"&{source}[{first}]", n, target.name)]
        if len(kept) == len(values) == 1:
            return first + 1, [f"{target.name}[0] = {source}[{first}];"]
        if len(kept) == len(values):
            loop = f"for (int k = 0; k < {len(values)}; ++k) {{"
            place = f"{source}[{first} + k]" if first else f"{source}[k]"
            return first + len(kept), [loop, f"    {target.name}[k] = {place};", "}"]
        zeros = [f"{target.name}[{k}] = {self.variant.zero};" for k in range(target.size) if k not in kept]
        sums = [f"{target.name}[{k}] = {source}[{first + index}];" for index, k in enumerate(kept)]
        return first + len(kept), sums + (zeros if every else [])

    def _scan(self, step: Scan) -> None:
        source, target = step.source, step.output
        self._declare(target, "j")
        self.lines += ["", f"/* {step.comment} */"]
        zeros = self.zero_rows[target.name] = self.zero_rows.get(source.name, set())
        if target.name in self.read_whole and zeros:
            raise NotImplementedError(f"{target.name} has rows that are never stored, and is read as a whole")
        self.of_joints.add(target.name)
        rows = [k for k in range(source.shape[0]) if k not in zeros]
        # Rows of lanes are filled up to the last block that holds a joint; what lies beyond was never written.
        stride, length = (self.scope.size, self.scope.size)
        if self.variant.joint_lanes:
            stride, length = (f"LANES * {lanes}" for lanes in (self.scope.padded, self.scope.blocks))
        self.operations = self.operations + Operations(add=len(rows) * len(self.scope.chain.joints))
        helper = "sums_beyond" if step.beyond else "sums_up_to"
        for _, run in itertools.groupby(enumerate(rows), lambda pair: pair[1] - pair[0]):
            group = [row for _, row in run]
            given, into = (f"{array.name}[{group[0]}]" for array in (source, target))
            if self.variant.joint_lanes:
                scalar = self.variant.scalar.name
                given, into = f"(const {scalar} *){given}", f"({scalar} *){into}"
            self._call(helper, given, len(group), stride, length, into)
            if step.base:
                self._call("sums_of_base", given, len(group), stride, step.base, int(step.beyond), into)

    def _write(self, operand: Operand, k: int) -> str:
        array = self.renamed.get(operand.array.name, operand.array)
        if array.name in self.entries:
            return self.entries[array.name][k]
        if operand.at == "":
            return f"{array.name}[{k}]" if self._public(array) or array.name in self.flat else element(array, k)
        if operand.at != "ij":
            return f"{array.name}[{k}][{operand.at}]" if len(array.shape) > 1 else f"{array.name}[{operand.at}]"
        if operand.count == 1:
            return self._pair(array, "i", "j")
        return f"entry[{k}]" if self._public(array) else f"{array.name}[i][j][{k}]"

    def _sum_joints(self, step: SumJoints) -> None:
        source, target = step.source, step.output
        m, M, prefix = len(self.scope.chain.joints), self.scope.size, self.scope.prefix
        if not self._public(target):
            self._declare_numbers(target, "")
        self._store([target], self.inputs)
        rest = M, f"{prefix}coordinate_of", f"{prefix}multiplier_of", target.name
        self.lines += ["", "/* joints that move together share a coordinate */"]
        if step.columns or len(source.shape) == 1:
            self.operations = self.operations + Operations(add=source.size, multiply=source.size)
            if source.name in self.lane_arrays:
                first = f"(const {self.variant.scalar.name} *){source.name}", f"LANES * {self.scope.padded}"
            else:
                first = source.name if len(source.shape) == 1 else f"{source.name}[0]", M
            rows = 1 if len(source.shape) == 1 else source.shape[0]
            self._call("sum_columns", rows, *first, *rest)
            return
        depth = source.size // (m * m)
        self.operations = self.operations + Operations(add=source.size, multiply=source.size + m * m)
        self._call("sum_pairs", source.name if len(source.shape) == 2 else f"{source.name}[0][0]", depth, *rest)
        if step.mirror:
            self._call("mirror_upper", target.name, "N")

    def _nothing(self, term: Term) -> str:
        """C name of zeros, as many as the largest argument of a term that has none."""
        size = max(array.size for array, source in term.arguments if not source.array)
        opening = "" if self.variant.lanes else f" = {{{self.variant.scalar.constant(0.0)}}}"
        self._note(f"{self.variant.number} nothing[{size}]{opening};")
        if self.variant.lanes and "memset(nothing, 0, sizeof nothing);" not in self.lines:
            self.lines.append("memset(nothing, 0, sizeof nothing);")
        return "nothing"

    def _sum(self, step: Sum) -> None:
        if len(step.terms) > 1:  # what is not summed was guarded where it was called
            self._store(step.outputs, self.inputs)
        parts = [Array(f"{result}_part", (t.size,)) for result, t in zip(step.results, step.outputs, strict=True)]
        for target, part in zip(step.outputs, parts, strict=True):
            if len(step.terms) > 1 and target.name not in step.apart:
                self._declare_numbers(part, "")
        for index, term in enumerate(step.terms):
            given: list[str] = []
            for array, source in term.arguments:
                offset = 0 if source.index is None else source.index * array.size
                name = source.array.name if source.array else self._nothing(term)
                given.append(f"&{name}[{offset}]" if source.index is not None else name)
            for target, part in zip(step.outputs, parts, strict=True):
                if target.name in step.apart:
                    given.append(f"&{target.name}[{target.size // len(step.terms) * index}]")
                else:
                    given.append((target if index == 0 else part).name)
            prefix = "" if self.variant.batches else f"{self.printer.name}_"
            self.lines.append(f"{prefix}{term.function}{suffix_of(self.variant)}({', '.join(given)});")
            self.operations = self.operations + self.printer.finished[term.function]
            for target, part in zip(step.outputs, parts, strict=True) if index > 0 else ():
                if target.name in step.apart:
                    continue
                self.operations = self.operations + Operations(add=target.size)
                self._call("add_numbers", part.name, target.size, target.name)


def _handed_on(step: Step) -> tuple[Array, ...]:
    """Arrays that a step reads as a whole, through a helper or a function, whatever is known of their entries."""
    if isinstance(step, (SumJoints, Weights)):
        return (step.source,)
    if isinstance(step, Shared):
        return step.arguments
    if isinstance(step, StraightLine) and step.name:
        return step.arguments
    return step.reads if isinstance(step, Sum) else ()


def _indented(lines: list[str], depth: int) -> list[str]:
    return ["    " * depth + line if line else line for line in lines]
