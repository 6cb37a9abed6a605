# SPDX-License-Identifier: MIT
"""Differentiate by complex steps: f'(x) is the imaginary part of f(x + ih) over h, without cancellation.

A ``casadi.Function`` is run on complex numbers, a whole stack of states at a time (tests/support/graphs.py).
"""

from __future__ import annotations

from functools import partial

import casadi as ca
import numpy as np

from stiffgen.core.symbolic.model import folded
from stiffgen.core.verify.kernels.rounding import run
from support.graphs import COMPLEX

STEP = 1e-100
TOGETHER = 1024
"""States and directions that one run of a graph takes together: a run costs as much per instruction as per number."""

TWISTS = np.zeros((6, 4, 4))
"""Rates of a pose at unit twists (linear, angular), in the pose's own axes."""
for _k in range(3):
    TWISTS[_k, _k, 3] = 1
    TWISTS[3 + _k, (_k + 2) % 3, (_k + 1) % 3], TWISTS[3 + _k, (_k + 1) % 3, (_k + 2) % 3] = 1, -1


def columns(stack: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Reshape a stack of arguments to the shapes of CasADi."""
    rows = folded(shape) if shape else (1,)
    return stack.reshape(len(stack), *rows, *[1] * (2 - len(rows)))


def _by_columns(stack: np.ndarray) -> np.ndarray:
    """Return the entries of each matrix of a stack (count, rows, columns) column by column: (count, entries)."""
    count, rows = stack.shape[:2]
    return stack.reshape(count, rows, -1).transpose(0, 2, 1).reshape(count, -1).astype(complex)


def gradients(function: ca.Function, arguments: list[np.ndarray], cotangents: list[np.ndarray]) -> list[np.ndarray]:
    """Return gradients of the sum of cotangents times results with respect to every argument; stacks as in CasADi.

    A floating base's pose is differentiated along its body twists, (count, 6, 1); other arguments entry by entry.
    """
    count = len(arguments[0])
    weights = [w.real for c in cotangents for w in _by_columns(c).T]
    shapes = [(6, 1) if function.name_in(k) == "base_pose" else a.shape[1:] for k, a in enumerate(arguments)]
    directions: list[tuple[int, np.ndarray]] = []
    for k, argument in enumerate(arguments):
        by_twists = function.name_in(k) == "base_pose"
        rates = argument @ TWISTS[:, None] if by_twists else np.eye(argument[0].size).reshape(-1, 1, *shapes[k])
        directions += [(k, rate) for rate in rates]
    together = max(1, TOGETHER // count)
    slopes: list[np.ndarray] = []
    for start in range(0, len(directions), together):
        chosen = directions[start : start + together]
        moved = [np.tile(each.astype(complex), (len(chosen), 1, 1)) for each in arguments]
        for place, (k, rate) in enumerate(chosen):
            moved[k][place * count : (place + 1) * count] += 1j * STEP * rate
        number_of = partial(np.full, len(chosen) * count, dtype=complex)
        with np.errstate(all="ignore"):  # in branches that are not chosen
            results = run(function, [list(_by_columns(each).T) for each in moved], number_of, COMPLEX)
        entries = [entry.imag.reshape(len(chosen), count) for result in results for entry in result]
        slopes += list(sum(w * entry / STEP for w, entry in zip(weights, entries, strict=True)))
    of_argument = np.array([k for k, _ in directions])
    stacked = np.array(slopes).reshape(len(directions), count).T
    of_each = (stacked[:, of_argument == k].reshape(count, *shape) for k, shape in enumerate(shapes))
    return [np.ascontiguousarray(each) for each in of_each]  # row by row: copies of the layout go to C
