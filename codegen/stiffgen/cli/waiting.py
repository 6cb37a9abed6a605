# SPDX-License-Identifier: MIT
"""A line at a terminal while a command loads its packages, rich's among them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def waiting(step: str) -> Iterator[None]:
    """Show a step on standard error until the block ends, where both streams are terminals.

    A pager on standard output shares the terminal with standard error, and would be written into.
    """
    streams = (sys.stdout, sys.stderr)
    if not all(stream is not None and stream.isatty() for stream in streams):
        yield
        return
    line = f"{step} ..."
    print(line, end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        print(f"\r{' ' * len(line)}\r", end="", file=sys.stderr, flush=True)
