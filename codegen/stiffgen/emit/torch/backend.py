# SPDX-License-Identifier: MIT
"""Describe torch.py."""

from __future__ import annotations

from pathlib import Path

from stiffgen.emit.backend import Backend, Request


def _files(request: Request) -> dict[str, str]:
    return {"python/torch.py": "torch.py.j2"} if request.has_wrappers else {}


TORCH = Backend(Path(__file__).parent, _files)
