# SPDX-License-Identifier: MIT
"""Render the text of every file of a robot's folder; nothing is written here."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import jinja2

from stiffgen.core.emit.backend import SOURCES, Backend, Request
from stiffgen.core.emit.manifest import manifest_text
from stiffgen.core.emit.registry import BACKENDS
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.names import c_string, comment
from stiffgen.core.options import GenerationOptions
from stiffgen.core.rendering import environment
from stiffgen.core.robot.chain import Chain


def render(chain: Chain, name: str, options: GenerationOptions | None = None) -> dict[str, str]:
    """Return the files of a robot's folder by name.

    Args:
        chain: the robot.
        name: an identifier (:mod:`stiffgen.core.names`), the prefix of all C names.
        options: choices of the user; those that select the chain have no effect here.

    Returns:
        Text by file name; the same on every machine.

    Raises:
        ChainError: CUDA was chosen for a chain too long for batches, or the options exclude each other.

    """
    request = Request(chain, name, options or GenerationOptions())
    texts = _with_sources(print_files(request, BACKENDS))
    texts[MANIFEST] = manifest_text(request, texts)
    return texts


def print_files(request: Request, backends: Sequence[Backend]) -> dict[str, str]:
    """Return the files that some backends write for a robot, by name."""
    texts = {}
    for backend in backends:
        folders = dict.fromkeys(each.folder / "templates" for each in (backend, *backends, *BACKENDS))
        templates, files = _templates(tuple(folders)), backend.files(request)
        variables = request.variables | dict(backend.variables(request)) if files else {}
        for file, source in files.items():
            banner = _banner(file, request.banner)
            if isinstance(source, Path):
                texts[file] = f"{banner}\n{source.read_text(encoding='utf-8')}"
            else:
                texts[file] = templates.get_template(source).render(variables, banner=banner)
    return texts


def _with_sources(texts: dict[str, str]) -> dict[str, str]:
    """Replace :data:`SOURCES` by the digest of the C sources: module and Python file can find out that they differ."""
    sources = "".join(text for file, text in sorted(texts.items()) if file.endswith((".c", ".h")))
    digest = hashlib.sha256(sources.encode()).hexdigest()[:16]
    return {file: text.replace(SOURCES, digest) for file, text in texts.items()}


@cache
def _templates(folders: tuple[Path, ...]) -> jinja2.Environment:
    """Return the environment of some folders' templates: of a name in several folders, the first one's."""
    # C and Python, not HTML: names from the robot file go through these filters
    filters: dict[str, Callable[..., str]] = {
        "c_string": c_string,
        "comment": comment,
        "python": ascii,
        "python_float": lambda x: repr(x) if math.isfinite(x) else f"float('{x}')",
        "short": lambda x: f"{x:.6g}" if math.isfinite(x) else "none",
    }
    return environment(folders, filters)


def _banner(file: str, line: str) -> str:
    """Return the first line of a file as a comment of its language."""
    return f"/* {line} */" if file.endswith((".h", ".hpp", ".c", ".cu")) else f"# {line}"
