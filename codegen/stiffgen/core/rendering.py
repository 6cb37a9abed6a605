# SPDX-License-Identifier: MIT
"""Read the templates of all rooms in one way."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import cache_from_source
from pathlib import Path

import jinja2


def environment(
    source: str | Sequence[Path],
    filters: Mapping[str, Callable[..., object]] | None = None,
    *,
    escaped: bool = False,
) -> jinja2.Environment:
    """Return an environment of templates in which an undefined name is an error.

    Args:
        source: a package, whose folder ``templates`` is read, or folders.
        filters: functions that the templates may apply, by name.
        escaped: escape values for HTML; else (C, Python, Markdown) they are inserted as they are.

    """
    loader = jinja2.PackageLoader(source) if isinstance(source, str) else jinja2.FileSystemLoader(source)
    templates = jinja2.Environment(
        loader=loader,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=escaped,
        optimized=False,  # no filter is applied to a constant: what is kept is independent of the filters
        bytecode_cache=_kept("html" if escaped else "text"),
    )
    templates.filters |= filters or {}
    return templates


def _kept(kind: str) -> jinja2.FileSystemBytecodeCache | None:
    """Return the cache of compiled templates beside that of Python's modules; None where Python writes none.

    Compiling an arm's templates takes a sixth of its generation. Jinja compiles a template anew when its text changes.
    """
    folder = Path(cache_from_source(__file__)).parent
    if sys.dont_write_bytecode or not os.access(folder, os.W_OK):
        return None
    return jinja2.FileSystemBytecodeCache(str(folder), f"templates-{kind}-{jinja2.__version__}-%s.bin")
