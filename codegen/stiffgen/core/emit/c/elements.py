# SPDX-License-Identifier: MIT
"""C text of entries, pointers and declarations of arrays."""

from __future__ import annotations

from dataclasses import dataclass

from stiffgen.core.lower.form import (
    Count,
    Declaration,
    Declared,
    Entry,
    HelperArgument,
    Layout,
    Pointer,
    Scope,
    Storage,
    Table,
)
from stiffgen.core.lower.spots import Index, PairIndex, RowIndex, flat_name, spot_of
from stiffgen.core.lower.variant import Variant
from stiffgen.core.symbolic.program import Array


@dataclass(frozen=True)
class Elements:
    """The spelling of arrays in functions of a scope and variant."""

    scope: Scope
    variant: Variant

    def entry(self, entry: Entry) -> str:
        """Return the C text of an entry."""
        spot = spot_of(entry)
        return spot.name + "".join(f"[{self._index(index)}]" for index in spot.indices)

    def _index(self, index: Index) -> str:
        """Return the C text of an index; pairs and rows of weights with one number need no depth."""
        if isinstance(index, PairIndex):
            place = f"{self.scope.size} * {index.first} + {index.second}"
            return place if index.depth == 1 else f"{index.depth} * ({place}) + {index.offset}"
        if isinstance(index, RowIndex):
            return "i" if index.depth == 1 else f"{index.depth} * i + {index.offset}"
        return str(index)

    def pair(self, array: Array, first: str, second: str) -> str:
        """Return the C text of the entry of a pair of joints."""
        return f"{array.name}[{self.scope.size} * {first} + {second}]"

    def base(self, entry: Entry) -> str:
        """Return the name of what an entry lies in."""
        return self.entry(entry).partition("[")[0]

    def pointer(self, pointer: Pointer, *, written: bool = False) -> str:
        """Return the C text of a pointer to numbers, or to a row."""
        storage = pointer.storage
        array = storage.named if pointer.as_read else storage.array
        if pointer.plain:
            row = "" if pointer.row is None else f"[{pointer.row}]"
            return f"({'' if written else 'const '}{self.variant.scalar.name} *){array.name}{row}"
        if pointer.row is not None:
            return f"{array.name}[{pointer.row}]"
        if not pointer.as_read:
            return flat_name(storage)
        return array.name if storage.layout is not Layout.SHAPED else array.name + "[0]" * (len(array.shape) - 1)

    def argument(self, argument: HelperArgument, *, written: bool = False) -> str:
        """Return the C text of a helper's argument."""
        if isinstance(argument, Pointer):
            return self.pointer(argument, written=written)
        if isinstance(argument, Table):
            return f"{self.scope.prefix}{argument.value}"
        if isinstance(argument, Count):
            return {
                Count.JOINTS: self.scope.size,
                Count.COORDINATES: "N",
                Count.USED: self.scope.blocks,
                Count.ALLOCATED: self.scope.padded,
                Count.USED_NUMBERS: f"LANES * {self.scope.blocks}",
                Count.ALLOCATED_NUMBERS: f"LANES * {self.scope.padded}",
            }[argument]
        return str(argument)

    def declaration(self, declaration: Declaration) -> str:
        """Return the C text of a declaration."""
        array, number, scalar = declaration.array, self.variant.number, self.variant.scalar.name
        if declaration.kind is Declared.VIEW:
            row = f"[LANES * {self.scope.padded}]"
            return (
                f"const {scalar} (*const {array.name}_of){row} = (const {scalar} (*){row}){array.name};"
                " /* joint by joint */"
            )
        if declaration.kind is Declared.ALIAS and declaration.local:
            if len(array.shape) < 2:
                return f"const {number} *const {declaration.local.name} = {array.name};"
            # Pointers to the rows: gcc takes a cast to a pointer to const arrays for one that discards const.
            count, length = array.shape
            rows = ", ".join([array.name, *(f"{array.name} + {length * k}" for k in range(1, count))])
            return f"const {number} *const {declaration.local.name}[{count}] = {{{rows}}};"
        if declaration.kind is Declared.ZEROS:
            zeros = "" if self.variant.lanes else f" = {{{self.variant.scalar.constant(0.0)}}}"
            return f"{number} {array.name}[{array.size}]{zeros};"
        return self._array(declaration)

    def _array(self, declaration: Declaration) -> str:
        """Return the C text of an array's declaration in its layout."""
        array, number = declaration.array, self.variant.number
        if declaration.layout is Layout.LANES:
            return f"lanes {array.name}[{array.shape[0]}][{self.scope.padded}];"
        if declaration.layout is Layout.WEIGHT_ROWS:
            depth = array.size // (array.shape[0] * array.shape[1])
            return f"lanes {array.name}[{self.scope.size} * {depth}][{self.scope.padded}];"
        flat = declaration.layout is not Layout.SHAPED
        extents = f"[{array.size}]" if flat else "".join(f"[{extent}]" for extent in array.shape)
        aligned = self.variant.aligned if declaration.kind is Declared.ALIGNED else ""
        return f"{aligned}{number} {array.name}{extents};"

    def passed(self, storage: Storage, *, columns: bool, written: bool) -> str:
        """Return the C text of an array that an internal function reads or fills; ``columns``: as columns of joints."""
        name, number = storage.array.name, self.variant.number
        if columns and not self.variant.joint_lanes and storage.is_result:
            return f"({number} (*)[{storage.array.shape[1]}]){name}"
        if columns or flat_name(storage) == name:
            return name
        # A cast: gcc takes name[0] for the first row alone, of which the function reads too much.
        return f"({'' if written else 'const '}{number} *){name}"
