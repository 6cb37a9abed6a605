# SPDX-License-Identifier: MIT
"""Postures of a passport: spread over the joints' ranges, or taken from a recording."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from stiffgen.core.errors import RecordingError, listed
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

MOST = 256
"""Postures of a passport at most."""


def spread_postures(chain: Chain, count: int = MOST) -> FloatArray:
    """Return postures (count, n) [rad or m] over the ranges of all joints; a joint without limits counts as one turn.

    The shares of the ranges are multiples of 1/g, 1/g^2 ..., modulo 1, with g^(n+1) = g + 1: they fill the cube evenly
    (M. Roberts, The unreasonable effectiveness of quasirandom sequences), and are the same in every run.
    """
    lower = np.array([each.lower for each in chain.coordinates])
    upper = np.array([each.upper for each in chain.coordinates])
    low = np.maximum(lower, np.minimum(upper, np.pi) - 2 * np.pi)
    high = np.minimum(upper, low + 2 * np.pi)
    g = 2.0
    for _ in range(60):  # converges: the right side's slope is below 1/2
        g = (1.0 + g) ** (1.0 / (len(low) + 1))
    share = np.outer(np.arange(1, count + 1), g ** -np.arange(1.0, len(low) + 1)) % 1.0
    return np.asarray(low + share * (high - low))


def recorded_postures(file: Path, chain: Chain) -> FloatArray:
    """Return postures of a CSV file, evenly thinned to at most MOST: columns q_0, q_1 ..., or the joints' names.

    Raises:
        RecordingError: the file cannot be read, lacks a column, or has no row of numbers.

    """
    names = [*chain.coordinate_names]
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            rows = csv.DictReader(text)
            found = rows.fieldnames or []
            columns = names if set(names) <= set(found) else [f"q_{i}" for i in range(len(names))]
            missing = [name for name in columns if name not in found]
            if missing:
                raise RecordingError(f"{file}: has no column {listed(missing)}; name them q_0 ... or like the joints")
            values = [_numbers(row, columns) for row in rows]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{file}: cannot be read ({error}); postures come from a CSV file") from error
    q = np.array(values).reshape(-1, len(names))
    q = q[np.isfinite(q).all(axis=1)]
    if not len(q):
        raise RecordingError(f"{file}: has no row with a number in every column of q; record joint positions")
    places = np.unique(np.linspace(0, len(q) - 1, min(MOST, len(q))).astype(int))
    return np.asarray(q[places])


def _numbers(row: dict[str, str | None], columns: list[str]) -> list[float]:
    """Return the numbers of a row; NaN where a text is none."""
    numbers = []
    for name in columns:
        try:
            numbers.append(float(row[name] or "nan"))
        except ValueError:
            numbers.append(float("nan"))
    return numbers
