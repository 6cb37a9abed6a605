# SPDX-License-Identifier: MIT
"""Coefficients of the kinematic connection on SE(3), as a table.

:mod:`stiffgen.core.symbolic.derivation` derives them exactly with SymPy, and states the conventions. The table stands
here because loading SymPy takes longer than loading the rest of the generator; ``test_connection.py`` derives it anew.
"""

from __future__ import annotations

from typing import Literal

Representation = Literal["body", "spatial", "hybrid"]
REPRESENTATIONS: tuple[Representation, ...] = ("body", "spatial", "hybrid")

_EVEN = ((3, 4, 5), (4, 5, 3), (5, 3, 4))
"""Rotations in cyclic order: e_i x e_j = e_k."""
_HALF_TURNS = dict.fromkeys(_EVEN, 0.5) | {(j, i, k): -0.5 for i, j, k in _EVEN}
"""Connection of the rotations in base axes; in body axes it has the opposite sign."""
_CARRIED = {(i - 3, j, k - 3): -1.0 for i, j, k in _EVEN} | {(j - 3, i, k - 3): 1.0 for i, j, k in _EVEN}
"""Translations, which a rotation carries along as vectors of the body."""


def _ordered(table: dict[tuple[int, int, int], float]) -> tuple[tuple[int, int, int, float], ...]:
    return tuple((i, j, k, value) for (i, j, k), value in sorted(table.items()))


COEFFICIENTS: dict[Representation, tuple[tuple[int, int, int, float], ...]] = {
    "body": _ordered(_CARRIED | {index: -value for index, value in _HALF_TURNS.items()}),
    "spatial": _ordered({(j, i, k): value for (i, j, k), value in _CARRIED.items()} | _HALF_TURNS),
    "hybrid": _ordered(_HALF_TURNS),
}
"""All non-zero coefficients (i, j, k, Gamma^k_ij) of a representation; twists are linear first."""
