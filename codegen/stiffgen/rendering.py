# SPDX-License-Identifier: MIT
"""How the templates of all rooms are read."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jinja2


def environment(
    package: str, filters: Mapping[str, Callable[..., object]] | None = None, *, escaped: bool = False
) -> jinja2.Environment:
    """Return the templates of a package, in which a name that is not given is an error.

    Args:
        package: whose folder ``templates`` they lie in.
        filters: by name, what the templates may apply.
        escaped: what is put in becomes text of HTML; else (C, Python, Markdown) it goes in as it is.

    """
    templates = jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=escaped,
    )
    templates.filters |= filters or {}
    return templates
