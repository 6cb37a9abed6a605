# SPDX-License-Identifier: MIT
"""Sphinx: the repository's own pages, staged by pages.py, with the reference made from the tables."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import SkipNode
from docutils.transforms import Transform
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
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}  # else NumPy's own union of a dozen types
python_use_unqualified_type_names = True
html_theme = "furo"
html_title = f"stiffgen {version}"
html_copy_source = False
smartquotes = False  # programs are copied from the pages
project_copyright = "stiffgen contributors"
html_show_sphinx = False
html_math_renderer = "mathml"
html_static_path = [str(Path(__file__).parent / "static")]
html_css_files = ["site.css"]
html_js_files = [("full_size.js", {"defer": "defer"})]
pygments_style, pygments_dark_style = "default", "monokai"


def _inline(writer: Any, node: Any) -> None:
    writer.body.append(convert(node.astext()))
    raise SkipNode


def _block(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise SkipNode


class NamesInOnePiece(Transform):  # type: ignore[misc]  # docutils has no types
    """Keep numbers, options and names on one line: browsers break lines behind every hyphen."""

    default_priority = 900
    name = re.compile(r"(\S*(?:(?<!\S)[(\"']*--?\w|\d\S*-|-\S*\d|\w_\w|\w-\w+-\w)\S*)")
    in_a_cell = re.compile(r"(\S*-\S*)")

    def apply(self) -> None:
        """Wrap each of them in the running text, and every word with a hyphen in a table."""
        for text in list(self.document.findall(nodes.Text)):
            above = text.parent
            if not isinstance(above, nodes.paragraph | nodes.emphasis | nodes.strong | nodes.title | nodes.inline):
                continue
            parts = (self.in_a_cell if isinstance(above.parent, nodes.entry) else self.name).split(text.astext())
            if len(parts) > 1:
                kept = [(part, k % 2) for k, part in enumerate(parts) if part]
                above.replace(text, [self._whole(part) if whole else nodes.Text(part) for part, whole in kept])

    def _whole(self, part: str) -> nodes.inline:
        return nodes.inline("", part, classes=["name"])


def _as_it_is(app: Any, config: Any) -> None:
    config.html_extra_path = [str(folder) for folder in [Path(app.srcdir) / "as_it_is"] if folder.is_dir()]


def _search_from_a_file(app: Any, page: str, *_: Any) -> None:
    if page == "search":
        app.add_js_file("excerpts.js")  # build.py writes it
        app.add_js_file("search_from_file.js")


def setup(app: Any) -> None:
    """Equations as MathML, which browsers draw themselves: the site needs no script from elsewhere."""
    app.add_transform(NamesInOnePiece)
    app.connect("html-page-context", _search_from_a_file)
    app.connect("config-inited", _as_it_is)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
