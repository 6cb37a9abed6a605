# SPDX-License-Identifier: MIT
"""Spots of entries: one per layout, with what takes its place where an array is not stored."""

from __future__ import annotations

import pytest

from stiffgen.core.lower.form import Access, Layout, Local, Place, Storage
from stiffgen.core.lower.spots import PairIndex, RowIndex, Spot, spot_of
from stiffgen.core.symbolic.program import Array, Operand

MATRIX, PAIRS, SIXES = Array("A", (6, 7)), Array("A", (7, 7)), Array("A", (7, 7, 6))


def access(layout: Layout, at: str, k: int, array: Array = MATRIX, **more: object) -> Access:
    options = {name: more.pop(name) for name in ("wide", "as_passed", "guard") if name in more}
    return Access(Storage(array, layout=layout, **more), Operand(array, at), k, **options)


@pytest.mark.parametrize(
    ("entry", "spot"),
    [
        (Local("x"), Spot("x")),
        (Local("x", 3), Spot("x", (3,))),
        (access(Layout.SHAPED, "", 9, guard="seen"), Spot("seen")),
        (access(Layout.SHAPED, "", 9, as_passed=True), Spot("A", (9,))),
        (access(Layout.FLAT, "", 9), Spot("A", (9,))),
        (access(Layout.SHAPED, "", 9), Spot("A", (1, 2))),
        (access(Layout.SHAPED, "i", 4), Spot("A", (4, "i"))),
        (access(Layout.SHAPED, "ij", 0, PAIRS), Spot("A", (PairIndex(),))),
        (access(Layout.SHAPED, "ij", 2, SIXES), Spot("A", ("i", "j", 2))),
        (access(Layout.SHAPED, "ij", 2, SIXES, place=Place.RESULT), Spot("entry", (2,))),
        (access(Layout.LANES, "j", 4, wide=True), Spot("A", (4, "j"))),
        (access(Layout.LANES, "i", 4), Spot("A_of", (4, "i"))),
        (access(Layout.LANES, "", 9), Spot("A_of", (1, 2))),
        (access(Layout.WEIGHTS, "ij", 2, SIXES), Spot("A", (PairIndex("i", "j", 6, 2),))),
        (access(Layout.WEIGHTS_TRANSPOSED, "ij", 2, SIXES, companion=Storage(Array("B", (7, 7)))),
         Spot("B[0]", (PairIndex("j", "i", 6, 2),))),
        (access(Layout.WEIGHT_ROWS, "ij", 2, SIXES), Spot("A", (RowIndex(6, 2), "j"))),
        (access(Layout.SHAPED, "", 1, elsewhere=(Local("y"), Local("z", 0))), Spot("z", (0,))),
    ],
)  # fmt: skip
def test_spot(entry, spot):
    """Compare the place of an entry in the printed code with the one expected from its layout."""
    assert spot_of(entry) == spot
