# SPDX-License-Identifier: MIT
"""Run compiled code in a child process, which a crash or a loop without end may end."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import warnings
from collections.abc import Callable


def confined(work: Callable[[], list[str]], seconds: int = 1200) -> list[str]:
    """Return the faults that ``work`` finds in a child process; a crash, and no end within ``seconds``, are faults."""
    if not hasattr(os, "fork"):
        return work()
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads: the child calls C alone
        child = os.fork()
    if child == 0:
        try:
            faulthandler.disable()
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(seconds)
            with os.fdopen(writer, "w", encoding="utf-8") as pipe:
                json.dump(work(), pipe)
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writer)
    try:
        with os.fdopen(reader, encoding="utf-8") as pipe:
            text = pipe.read()
    except BaseException:  # a signal ends the parent: the child ends with it
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        status = os.waitpid(child, 0)[1]
    if status != 0:
        return [f"the compiled code ends its process (status {os.waitstatus_to_exitcode(status)})"]
    return [str(fault) for fault in json.loads(text)]
