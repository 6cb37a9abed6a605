# SPDX-License-Identifier: MIT
"""Describe NAME.hpp: every function once more, with sizes that the compiler checks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.texts import arguments_elsewhere, described, documented_arguments, wrapped
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel


def _doxygen(chain: Chain, kernel: Kernel) -> list[str]:
    """Return the comment above a C++ function."""
    lines = [f"@brief {kernel.summary}", "", *wrapped(kernel.equation)]
    if kernel.note:
        lines += wrapped(kernel.note)
    lines += ["", *arguments_elsewhere(kernel)]
    for direction, arguments in (("in", documented_arguments(kernel)), ("out", kernel.results)):
        for argument in arguments:
            lines += wrapped(f"@param[{direction}] {described(chain, argument)}", indent="    ")
    return lines


def _variables(request: Request) -> dict[str, Any]:
    return {"doxygen": {page.qualified_name: _doxygen(request.chain, page.kernel) for page in request.kernels}}


def _files(request: Request) -> dict[str, str]:
    return {f"{request.name}.hpp": "wrapper.hpp.j2"}


BACKEND = Backend(Path(__file__).parent, _files, _variables)
