# SPDX-License-Identifier: MIT
"""Read the templates of all rooms in one way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    )
    templates.filters |= filters or {}
    return templates
