# SPDX-License-Identifier: MIT
"""Describe torch.py."""

from __future__ import annotations

from pathlib import Path

from stiffgen.core.emit.backend import Backend, Request

_FOLDER = Path(__file__).parent


def _files(request: Request) -> dict[str, str | Path]:
    return {"python/torch.py": _FOLDER / "wrappers" / "torch.py"} if request.has_wrappers else {}


BACKEND = Backend(_FOLDER, _files)
