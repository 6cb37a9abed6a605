# SPDX-License-Identifier: MIT
"""Spots of entries: the array and the indices behind an access, decided once for every printer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from stiffgen.core.lower.form import Access, Entry, Layout, Local, Storage
from stiffgen.core.lower.statements import indices


@dataclass(frozen=True)
class PairIndex:
    """Row-major index of a pair of joints, of which each has ``depth`` numbers: depth (M first + second) + offset."""

    first: str = "i"
    second: str = "j"
    depth: int = 1
    offset: int = 0


@dataclass(frozen=True)
class RowIndex:
    """Index of a row of weights, of which each joint has ``depth``: depth i + offset."""

    depth: int
    offset: int


Index = int | str | PairIndex | RowIndex


@dataclass(frozen=True)
class Spot:
    """Entry of an array in memory: its name there, and one index per dimension; no index for a number."""

    name: str
    indices: tuple[Index, ...] = ()


def spot_of(entry: Entry) -> Spot:
    """Return the spot of an entry.

    A local and a guard are numbers of their own. An argument as passed is flat. An array that is not stored has its
    entries elsewhere. All others lie in memory as the array's layout says.
    """
    if isinstance(entry, Local):
        return Spot(entry.name, () if entry.index is None else (entry.index,))
    if entry.guard:
        return Spot(entry.guard)
    if entry.as_passed:
        return Spot(entry.storage.array.name, (entry.entry,))
    if entry.storage.elsewhere:
        return spot_of(entry.storage.elsewhere[entry.entry])
    return _BY_LAYOUT[entry.storage.layout](entry)


def _in_order(entry: Access) -> Spot:
    """Return the spot in a row-major array, read whole, by a joint or by a pair of joints."""
    storage, at, k = entry.storage, entry.operand.at, entry.entry
    array = storage.named
    if at == "":
        return Spot(array.name, (k,) if storage.layout is Layout.FLAT else tuple(indices(array.shape, k)))
    if at != "ij":
        return Spot(array.name, (k, at) if len(array.shape) > 1 else (at,))
    if entry.operand.count == 1:
        return Spot(array.name, (PairIndex(),))
    return Spot("entry", (k,)) if storage.is_result else Spot(array.name, ("i", "j", k))


def _in_vectors(entry: Access) -> Spot:
    """Return the spot in rows of vectors: all lanes at once, or one number by the view with the suffix _of."""
    array, at, k = entry.storage.array, entry.operand.at, entry.entry
    if entry.wide:
        return Spot(array.name, (k, "j"))
    return Spot(f"{array.name}_of", tuple(indices(array.shape, k)) if at == "" else (k, at))


def _weight(entry: Access) -> Spot:
    """Return the spot of a pair's weight, in the array or in its companion."""
    storage = entry.storage
    swapped = storage.layout is Layout.WEIGHTS_TRANSPOSED
    first, second = ("j", "i") if swapped else ("i", "j")
    where = PairIndex(first, second, entry.operand.count, entry.entry)
    return Spot(storage.array.name if storage.companion is None else flat_name(storage.companion), (where,))


def _weight_in_rows(entry: Access) -> Spot:
    return Spot(entry.storage.array.name, (RowIndex(entry.operand.count, entry.entry), "j"))


_BY_LAYOUT: Mapping[Layout, Callable[[Access], Spot]] = {
    Layout.FLAT: _in_order,
    Layout.SHAPED: _in_order,
    Layout.LANES: _in_vectors,
    Layout.WEIGHTS: _weight,
    Layout.WEIGHTS_TRANSPOSED: _weight,
    Layout.WEIGHT_ROWS: _weight_in_rows,
}


def flat_name(storage: Storage) -> str:
    """Return the C text of a pointer to the first number of an array; a local with several dimensions is indexed."""
    array = storage.array
    is_flat = storage.local is not None or storage.layout is not Layout.SHAPED or storage.place.is_parameter
    return array.name if is_flat else array.name + "[0]" * (len(array.shape) - 1)
