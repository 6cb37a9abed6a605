# SPDX-License-Identifier: MIT
"""Refusal of a limit of memory under which the numerical libraries would abort or hang while they load."""

from __future__ import annotations

import os

from stiffgen.core.errors import StiffgenError

try:
    import resource
except ImportError:  # Windows has no such limit
    resource = None  # type: ignore[assignment]

LEAST = 600 << 20
"""Address space of a process [bytes]; reading and generating an iiwa 14 takes 380 MiB with one thread."""


def check_memory() -> None:
    """Refuse a limit on the address space below :data:`LEAST`; under any other limit, use one thread of OpenBLAS.

    OpenBLAS reserves some 40 MiB of address space per processor when NumPy is imported.

    Raises:
        StiffgenError: the process may use too little.

    """
    if resource is None:
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    if limit < LEAST:
        raise StiffgenError(
            f"this process may use {limit >> 20} MiB of memory, and needs {LEAST >> 20}; "
            f"allow more (ulimit -v {LEAST >> 10}, or unlimited)"
        )
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
