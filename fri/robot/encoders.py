# SPDX-License-Identifier: MIT
"""Measured joint positions of encoders that fail: they stand still, toggle, or are late (faults.py)."""

from __future__ import annotations

import re
from collections import deque

import numpy as np
from numpy.typing import NDArray

JOINTS = 7
LONGEST = 1000
"""Most cycles by which a position is late."""
MANTISSA = 52
"""Bits of a double's mantissa."""

Array = NDArray[np.float64]

_ARGUMENT = re.compile(r"(?P<joints>all|A[1-7](?:\+A[1-7])*)(?:_(?P<number>[-+]?[0-9.]+))?")
_NUMBERS: dict[str, tuple[float, float] | None] = {
    "still": None,
    "stuck": (-10.0, 10.0),
    "toggling": (0.0, MANTISSA - 1.0),
    "late": (1.0, LONGEST),
}
KINDS = tuple(_NUMBERS)
"""Kinds of these faults."""


def parse_joints(kind: str, argument: str) -> tuple[list[int], float]:
    """Return the joints' indices and the number of an argument, such as A2+A4 or A6_0.3.

    Raises
    ------
    ValueError
        It cannot be read; the text says what is valid.

    """
    match, bounds = _ARGUMENT.fullmatch(argument), _NUMBERS[kind]
    shape = "joints, such as A6, A2+A4 or all" + ("" if bounds is None else ", and a number, such as A6_20")
    if not match or (match["number"] is None) != (bounds is None):
        raise ValueError(f"takes {shape}")
    joints = range(JOINTS) if match["joints"] == "all" else (int(j[1]) - 1 for j in match["joints"].split("+"))
    number = float(match["number"] or 0.0)
    if bounds and not bounds[0] <= number <= bounds[1]:
        raise ValueError(f"takes a number from {bounds[0]:g} to {bounds[1]:g} behind the joints")
    return sorted(set(joints)), number


class Encoders:
    """Encoders of the joints, and what their faults make of the positions."""

    def __init__(self) -> None:
        self._told: Array | None = None
        self._past: deque[Array] = deque(maxlen=LONGEST + 1)
        self._flips = False

    def read(self, q: Array, faults: dict[str, str]) -> Array:
        """Return the measured positions in this cycle [rad]; faults: arguments by kind."""
        self._past.append(q)
        self._flips = not self._flips
        measured = q.copy()
        for kind, argument in faults.items():
            joints, number = parse_joints(kind, argument)
            if kind == "late":
                measured[joints] = self._past[max(len(self._past) - 1 - int(number), 0)][joints]
            elif kind == "stuck":
                measured[joints] = number
            elif self._told is not None:
                measured[joints] = self._told[joints]
        self._told = measured.copy()
        if "toggling" in faults and self._flips:
            joints, bit = parse_joints("toggling", faults["toggling"])
            bits = measured.view(np.uint64)
            bits[joints] ^= np.uint64(1) << np.uint64(bit)
        return measured
