# SPDX-License-Identifier: MIT
"""Describe torch.py."""

from __future__ import annotations

from pathlib import Path

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.python import WRAPPERS


def _files(request: Request) -> dict[str, str | Path]:
    return {"python/torch.py": WRAPPERS / "torch.py"} if request.has_wrappers else {}


BACKEND = Backend(Path(__file__).parent, _files)
