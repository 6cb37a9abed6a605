# SPDX-License-Identifier: MIT
"""Run a generated body without loops with 60 digits, to see what a sign changes apart from rounding."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from mpmath import mp

NUMBER = re.compile(r"(?<![\w.\]])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w\]])")
STATEMENT = re.compile(r"(?:const double )?(\w+(?:\[\d+\])?) = (.+)", re.S)


def statements(source: str, function: str) -> list[str]:
    """Return the statements of a function for one configuration, without comments."""
    start = source.index("{", source.index(f"void {function}("))
    body = source[start + 1 : source.index("\n}", start)]
    return [statement.strip() for statement in re.sub(r"/\*.*?\*/", "", body, flags=re.S).split(";\n")]


def run(lines: Sequence[str], given: Mapping[str, Any], result: str, size: int) -> list[Any]:
    """Run the statements with 60 digits; return the entries of ``result``. ``given``: the arguments and ``flip``."""
    values: dict[str, Any] = {"finite_or_nan": lambda x: x, result: [mp.mpf(0)] * size, "mpf": mp.mpf, **given}
    with mp.workdps(60):
        for line in lines:
            if "EIGHT(" in line:
                angles = [eval(_exact(each), values) for each in re.findall(r"EIGHT\(([^{}]*)\)", line)]
                flat = [x for each in angles for x in (each if isinstance(each, tuple) else (each,))]
                values["s"], values["c"] = [mp.sin(x) for x in flat], [mp.cos(x) for x in flat]
                continue
            found = STATEMENT.fullmatch(line)
            if found and "(const" not in line:
                exec(f"{found[1]} = ({_exact(found[2])})", values)
    return list(values[result])


def _exact(text: str) -> str:
    """Return a C expression as Python's, with its constants as exact doubles."""
    return NUMBER.sub(lambda number: f"mpf({number[0]})", " ".join(text.split()))
