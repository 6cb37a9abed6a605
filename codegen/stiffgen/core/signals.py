# SPDX-License-Identifier: MIT
"""Signals that end the process, kept until a block can clean up after them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def signals_deferred() -> Iterator[Callable[[], None]]:
    """Keep signals that end the process until the function that is yielded is called, or the block ends.

    A signal between the making of a folder, or the start of a program, and the block that removes or ends it would
    leave it there.
    """
    came: list[int] = []
    held: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # Python runs handlers in this thread alone
        numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        held = {number: handler for number in numbers if callable(handler := signal.getsignal(number))}
    for number in held:
        signal.signal(number, lambda number, frame: came.append(number))

    def deliver() -> None:
        while held:
            signal.signal(*held.popitem())
        while came:
            signal.raise_signal(came.pop())

    try:
        yield deliver
    finally:
        deliver()
