# SPDX-License-Identifier: MIT
"""Values that a caller from Python gives for options: numbers of NumPy made plain, words and paths checked."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Mapping
from dataclasses import fields
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

from stiffgen.core.errors import OptionError, listed, printable


def plain(value: Any) -> Any:
    """Return numbers of other kinds (NumPy, fractions, decimals) as Python's, arrays and lists as tuples.

    What is no number stays as it is, for the check of the option that takes it.
    """
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if kind == "f":
        value = value.astype(float).tolist()
    elif kind in ("i", "u", "b"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(map(plain, value))
    return float(value) if isinstance(value, (Decimal, Fraction)) else value


def plain_record(record: Any) -> None:
    """Make the numbers of a frozen record plain; its constructor calls this."""
    for each in fields(record):
        object.__setattr__(record, each.name, plain(getattr(record, each.name)))


def is_number(value: Any) -> bool:
    """Return whether a value is a number of Python, perhaps not finite."""
    return isinstance(value, (int, float))


def are_numbers(value: Any, count: int) -> bool:
    """Return whether a value is a tuple of ``count`` numbers of Python."""
    return isinstance(value, tuple) and len(value) == count and all(map(is_number, value))


def shown(value: Any) -> str:
    """Return a value for a message."""
    return printable(repr(value), 80)


def checked_words(value: Any, option: str) -> tuple[str, ...]:
    """Return words as a tuple; one word is the only one.

    Raises:
        OptionError: the value is something else.

    """
    words = (value,) if isinstance(value, str) else value
    if isinstance(words, Mapping) or not isinstance(words, Collection):
        raise OptionError(f"{option}: takes a word or several, not {shown(value)}")
    wrong = [each for each in words if not isinstance(each, str)]
    if wrong:
        raise OptionError(f"{option}: takes words, not {shown(wrong[0])}")
    return tuple(words)


def checked_path(value: Any, what: str) -> str | Path:
    """Return a path, or a robot's name.

    Raises:
        OptionError: the value is neither text nor a path.

    """
    if not isinstance(value, (str, os.PathLike)) or isinstance(os.fspath(value), bytes):
        raise OptionError(f"{what}: takes a path as text or pathlib.Path, not {shown(value)}")
    return value if isinstance(value, (str, Path)) else Path(value)


def checked_keywords(record: Any, given: Collection[str], call: str) -> None:
    """Refuse keywords that are no options of a record.

    Raises:
        OptionError: names the first one, and the option that was probably meant.

    """
    names = [each.name for each in fields(record)]
    for name in given:
        if name not in names:
            meant = difflib.get_close_matches(name, names, n=1, cutoff=0.7)
            remedy = f"did you mean {meant[0]}=...?" if meant else f"options: {listed(names, 40)}"
            raise OptionError(f"{call}() has no option {printable(name)}=...; {remedy}")
