# SPDX-License-Identifier: MIT
"""Sphinx: the repository's own pages, staged by pages.py, with the reference made from the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

import stiffgen

project, author, version = "stiffgen", "stiffgen contributors", stiffgen.__version__
release = version
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
html_theme = "furo"
html_title = f"stiffgen {version}"
html_copy_source = False
smartquotes = False  # programs are copied from the pages
project_copyright = "stiffgen contributors"
html_show_sphinx = False
html_math_renderer = "mathml"
html_static_path = [str(Path(__file__).parent / "static")]
html_css_files = ["site.css"]
pygments_style, pygments_dark_style = "default", "monokai"


def _inline(writer: Any, node: Any) -> None:
    writer.body.append(convert(node.astext()))
    raise SkipNode


def _block(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise SkipNode


def _as_it_is(app: Any, config: Any) -> None:
    config.html_extra_path = [str(folder) for folder in [Path(app.srcdir) / "as_it_is"] if folder.is_dir()]


def _search_from_a_file(app: Any, page: str, *_: Any) -> None:
    if page == "search":
        app.add_js_file("excerpts.js")  # build.py writes it
        app.add_js_file("search_from_file.js")


def setup(app: Any) -> None:
    """Equations as MathML, which browsers draw themselves: the site needs no script from elsewhere."""
    app.connect("html-page-context", _search_from_a_file)
    app.connect("config-inited", _as_it_is)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
