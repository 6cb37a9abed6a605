# SPDX-License-Identifier: MIT
"""Lower the kernels of a chain: each program becomes a :class:`~stiffgen.core.lower.form.Function`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from stiffgen.core.lower.form import (
    Access,
    Call,
    Count,
    Declaration,
    Declared,
    Function,
    Helpers,
    Item,
    Layout,
    Place,
    Pointer,
    Scope,
    Statements,
    Storage,
    Unused,
)
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.variant import Variant
from stiffgen.core.names import comment
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.program import Array, Operand, Program, Step, as_operand, entries_of
from stiffgen.core.symbolic.steps import OnOperands, SparseSum, StraightLine, Term

Rules = Mapping[type[Step], Callable[["Lowering", Any], None]]


@dataclass
class LoweredKernels:
    """Functions lowered so far for one variant.

    Attributes:
        chain: the robot.
        variant: way in which the functions will be printed.
        rules: lowering of each kind of step.
        scopes: by the prefix of their internal names.
        shared: internal functions that several kernels call, by name with prefix.
        functions: those of the kernels, by qualified name.

    """

    chain: Chain
    variant: Variant
    rules: Rules
    scopes: dict[str, Scope] = field(default_factory=dict)
    shared: dict[str, Function] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)

    def kernel(self, kernel: Kernel) -> Function:
        """Return a kernel's function, lowered once."""
        name, chain = kernel.qualified_name, self.chain
        if name not in self.functions:
            title = comment(kernel.place) if kernel.place else ""
            scope = self._scope(kernel.scope(chain), kernel.scope_name(chain), title)
            inputs = tuple(argument.array(chain) for argument in kernel.arguments)
            outputs = tuple(result.array(chain) for result in kernel.results)
            self.functions[name] = self._lowered(Function(name, scope, inputs, outputs), kernel.steps(chain))
        return self.functions[name]

    def term(self, term: Term, results: Sequence[Array]) -> Function:
        """Return the function of the kernel that a term calls, lowered once; ``results`` are its outputs."""
        if term.function not in self.functions:
            tips = term.chain.tips
            branch = tips[0].name if len(self.chain.tips) > 1 and len(tips) == 1 else ""
            inputs = tuple(array for array, _ in term.arguments)
            known = (scope for scope in self.scopes.values() if scope.chain == term.chain)
            scope = next(known, None) or self._scope(term.chain, branch)
            function = Function(term.function, scope, inputs, tuple(results))
            self.functions[term.function] = self._lowered(function, term.program)
        return self.functions[term.function]

    def _scope(self, chain: Chain, name: str, title: str = "") -> Scope:
        """Return the scope for functions about a part of the robot; "" names the whole."""
        prefix = f"{name}_" if name else ""
        return self.scopes.setdefault(prefix, Scope(chain, prefix, self.variant.scalar, title))

    def _lowered(self, function: Function, program: Program) -> Function:
        lowering = Lowering(self, function)
        lowering.read_arguments(program)
        return lowering.lower(program)


class Lowering:
    """Lowering of one function under way: first :meth:`read_arguments` or :meth:`read_parameters`, then :meth:`lower`.

    ``braces``: straight-line steps get a scope of their own. ``guards``: arguments may be infinite, so that statements
    read copies with NaN instead.
    """

    def __init__(self, kernels: LoweredKernels, function: Function) -> None:
        self.kernels = kernels
        self.variant = kernels.variant
        self.function = function
        self.scope = function.scope
        self.chain = function.scope.chain
        self.storages = {array.name: Storage(array, Place.ARGUMENT, Layout.FLAT) for array in function.inputs}
        self.storages.update((array.name, Storage(array, Place.RESULT, Layout.FLAT)) for array in function.outputs)
        self.braces, self.guards = False, True
        self.guarded: set[str] = set()
        """Guarded copies of arguments' entries, and the local that makes NaN, defined so far outside of braces."""

    def lower(self, program: Program) -> Function:
        """Lower the steps in order and finish the results; rules ask how arrays are read, which is noted before."""
        for step in program:
            self.kernels.rules[type(step)](self, step)
        # Both look at what the rules have noted and appended.
        self._guard_results()
        self._mirror_results()
        return self.function

    def storage(self, array: Array) -> Storage:
        """Return the record of an array."""
        return self.storages.setdefault(array.name, Storage(array))

    def add(self, item: Item) -> None:
        """Append an item."""
        self.function.items.append(item)

    def call(self, helper: str, *arguments: object, cost: Operations | None = None) -> None:
        """Append the call of a helper that only copies or guards."""
        self.add(Helpers((Call(helper, tuple(arguments)),), cost=cost or Operations()))  # type: ignore[arg-type]

    def declare(self, storage: Storage, at: str) -> None:
        """Declare a local that is written as a whole (at ""), by joints ("j") or by pairs of joints ("ij")."""
        if at == "j" and self.variant.joint_lanes:
            storage.layout = Layout.LANES
        elif at == "ij" and len(storage.array.shape) == 2:
            storage.layout = Layout.FLAT
        kind = Declared.ALIGNED if at == "ij" else Declared.ARRAY
        self.function.declare(Declaration(kind, storage.array, storage.layout))

    def declare_flat(self, storage: Storage) -> None:
        """Declare a local of numbers one after the other."""
        storage.layout = Layout.FLAT
        self.function.declare(Declaration(Declared.ARRAY, storage.array))

    def declare_as(self, storage: Storage) -> None:
        """Declare a local in the layout that it has."""
        self.function.declare(Declaration(Declared.ARRAY, storage.array, storage.layout))

    def declare_zeros(self, count: int) -> None:
        """Declare zeros to pass for arguments that are left out."""
        if count:
            self.function.declare(Declaration(Declared.ZEROS, Array("nothing", (count,))))

    def _note_reads(self, program: Program) -> list[OnOperands]:
        """Note in the storages how arrays are read, by joints or whole; return the steps that read operands."""
        maps = [step.whole() if isinstance(step, SparseSum) else step for step in program]
        on_operands = [step for step in maps if isinstance(step, OnOperands)]
        for operand in (operand for step in on_operands for operand in step.operands if operand.at):
            self.storage(operand.array).by_joints = True
        for array in (array for step in program for array in step.reads_whole):
            self.storage(array).whole = True
        return on_operands

    def read_parameters(self, program: Program) -> None:
        """Prepare an internal function: callers have copied the arguments, and pass columns of joints as vectors."""
        self._note_reads(program)
        for name in self.function.columns:
            self.storages[name].layout = Layout.LANES if self.variant.joint_lanes else Layout.SHAPED

    def read_arguments(self, program: Program) -> None:
        """Give arguments their short names, as copies in which infinity has become NaN where that is needed.

        Kernels that end in sums over pairs need no copies: no sum and no product brings a number that is not finite
        back among the finite ones, so that guarding the sums is enough (put_row).
        """
        on_operands = self._note_reads(program)
        copies = self.variant.joint_lanes and not any(step.over.is_pairs for step in on_operands)
        # Statements that take sines and name frames stand in braces of their own, where there are several.
        unshared = [step for step in program if isinstance(step, StraightLine) and not step.name]
        self.braces = len(unshared) > 1 and any(array.is_q for step in unshared for array in step.arguments)
        read, in_place = {array.name for step in program for array in step.reads}, self._read_in_place(on_operands)
        for array in self.function.inputs:
            if array.name not in read:
                self.add(Unused(self.storages[array.name]))
            if array.name in in_place:
                self._rename(self.storages[array.name], copies=copies)

    def _read_in_place(self, steps: Iterable[OnOperands]) -> set[str]:
        """Return the arrays that operands read where they lie; with vectors of joints, columns j are copied to them."""
        operands = [operand for step in steps for operand in step.operands]
        return {operand.array.name for operand in operands if operand.at != "j" or not self.variant.joint_lanes}

    def _rename(self, storage: Storage, *, copies: bool) -> None:
        """Give an argument its symbol as name: as a copy without infinity, or as an alias where the names differ."""
        array = storage.array
        storage.local, storage.layout = Array(array.symbol, array.shape or (1,)), Layout.SHAPED
        if array.symmetric_part and self.variant.joint_lanes:
            if copies:
                raise NotImplementedError(f"{array.name}: a symmetric part without NaN in place of infinity")
            return  # the rule of its step declares and fills the copy
        if copies:
            self.function.declare(Declaration(Declared.ARRAY, storage.local, Layout.SHAPED))
            cost = Operations(add=array.size, multiply=array.size)
            self.call("copy_finite", Pointer(storage), array.size, Pointer(storage, as_read=True), cost=cost)
        elif storage.local.name != array.name:
            self.function.declare(Declaration(Declared.ALIAS, array, local=storage.local))

    def note_overflow(self, outputs: Iterable[Array], arguments: Iterable[Array]) -> None:
        """Note which outputs of a step are results that may overflow.

        Sines of q are bounded, and so is what depends on them without division.
        """
        slides = any(joint.prismatic for joint in self.chain.joints[self.chain.base_joints :])
        divides = bool(self.chain.loops)
        if slides or divides or not all(array.is_q for array in arguments):
            for storage in map(self.storage, outputs):
                storage.overflows |= storage.is_result

    def _guard_results(self) -> None:
        """Make NaN of what overflowed; the stores of vectors do that themselves."""
        for array in self.function.outputs if self.variant.joint_lanes else ():
            if self.storages[array.name].overflows:
                cost = Operations(add=array.size, multiply=array.size)
                pointer = Pointer(self.storages[array.name])
                call = Call("copy_finite", (pointer, array.size, pointer))
                self.add(Helpers((call,), "NaN in place of infinity", cost=cost))

    def _mirror_results(self) -> None:
        """Copy the upper triangle of symmetric results of statements to the lower one.

        One statement stores an entry of both triangles. A compiler that makes vectors of neighbouring stores may
        compute its value twice even so, and contract a product and a sum in one of the two only.
        """
        filled = {array for item in self.function.items if isinstance(item, Statements) for array in item.step_outputs}
        for array in self.function.outputs if self.variant.joint_lanes else ():
            if array.symmetric and array in filled:
                call = Call("mirror_upper", (Pointer(self.storages[array.name]), array.shape[0]))
                self.add(Helpers((call,), "the same bits in both triangles, however products and sums are contracted"))

    def access(self, operand: Operand, entry: int, *, rows: bool = False) -> Access:
        """Return the access to an operand's entry, and declare what the access reads.

        With ``rows``, the access is in a loop over vectors of joints: column j is read from vectors, all lanes at once.
        Without vectors of joints, each entry is one number of the variant, and counts as wide.
        """
        storage, lanes = self.storage(operand.array), self.variant.joint_lanes
        if storage.layout in (Layout.WEIGHTS, Layout.WEIGHTS_TRANSPOSED, Layout.WEIGHT_ROWS):
            return Access(storage, operand, entry, wide=True)
        is_column = operand.at == "j"
        is_flat = storage.layout is Layout.FLAT and storage.place is Place.LOCAL and len(operand.array.shape) == 2
        if is_column and is_flat and not lanes:
            raise NotImplementedError(f"{storage.array.name}: a column of an array that was written as a whole")
        if is_column and rows and lanes and storage.layout is not Layout.LANES:
            storage = self._in_vectors(storage)
        if storage.layout is not Layout.LANES:
            return Access(storage, operand, entry, wide=not lanes)
        wide = is_column and rows
        if not wide:
            self.function.declare(Declaration(Declared.VIEW, storage.array, Layout.LANES))
        return Access(storage, operand, entry, wide)

    def _in_vectors(self, storage: Storage) -> Storage:
        """Return the copy of a plain array in vectors of joints; the first call declares and fills it."""
        if storage.companion is None:
            array = storage.array
            columns = array.shape[-1]
            rows = 1 if len(array.shape) == 1 else array.shape[0]
            copy = Storage(Array(f"rows_of_{array.name}", (rows, columns)))
            storage.companion = copy
            self.declare(copy, "j")
            count = Count.JOINTS if columns == len(self.chain.joints) else columns
            self.call("pack_rows", Pointer(storage), rows, count, Count.ALLOCATED, Pointer(copy, row=0))
        return storage.companion

    def apply(
        self, operands: Sequence[Operand], expression: Callable[..., ca.SX], *, rows: bool
    ) -> tuple[list[tuple[ca.SX, Access]], list[ca.SX]]:
        """Return the inputs of an expression of operands (a symbol and its access each), and the expression's entries.

        Entries that are always zero are no inputs: the expression gets a structural zero, and loses terms.
        """
        inputs: list[tuple[ca.SX, Access]] = []
        values = []
        for operand in operands:
            storage = self.storage(operand.array)
            # Of an array that is read by columns, ``zeros`` numbers rows, and so does an entry of a column.
            zeros = storage.known_zeros() if operand.at == "" else storage.zeros
            entries = []
            for k in range(operand.count):
                if k in zeros:
                    entries.append(ca.SX(0))
                    continue
                symbol = ca.SX.sym(f"{operand.array.name}_{operand.at}{k}")
                inputs.append((symbol, self.access(operand, k, rows=rows)))
                entries.append(symbol)
            values.append(as_operand(operand.shape, entries))
        return inputs, entries_of(expression(*values))
