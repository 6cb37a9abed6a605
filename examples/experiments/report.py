# SPDX-License-Identifier: MIT
"""Write the report: one HTML page with the summary and the figures, with a light and a dark theme."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from html import escape

import mujoco

import stiffgen
from examples.experiments.analysis import Row
from examples.experiments.trial import COLUMNS

PICTURE, FILM = "postures.png", "film.mp4"
STYLE = """
:root{color-scheme:light dark;--ink:#1f2328;--page:#ffffff;--soft:#59636e;--line:#d1d9e0;--box:#f6f8fa}
@media(prefers-color-scheme:dark){:root{--ink:#e6edf3;--page:#0d1117;--soft:#9198a1;--line:#3d444d;--box:#151b23}}
body{color:var(--ink);background:var(--page);font:16px/1.5 system-ui,sans-serif}
body{max-width:62rem;margin:0 auto;padding:1.5rem}
h1{font-size:1.7rem;line-height:1.2}h2{font-size:1.25rem;margin-top:2.2rem}
table{border-collapse:collapse;width:100%;font-size:.9rem;display:block;overflow-x:auto}
th,td{border-bottom:1px solid var(--line);padding:.45rem .6rem;text-align:left;vertical-align:top}
th{background:var(--box)}figure{margin:1.5rem 0}figcaption{color:var(--soft);font-size:.9rem;max-width:50rem}
figure svg,figure img,figure video{width:100%;height:auto;max-width:56rem}code{background:var(--box);padding:.1em .3em}
.note{background:var(--box);border-left:4px solid var(--line);padding:.6rem 1rem}
"""


@dataclass(frozen=True)
class Section:
    """Table with a title, the heads of its columns, and the figures below it, by file name."""

    title: str
    head: tuple[str, str, str, str]
    rows: Sequence[Row]
    figures: Sequence[str]


@dataclass
class Content:
    """Content of the page.

    Attributes:
        title: of the page.
        introduction: paragraphs.
        sections: tables and figures.
        figures: SVG text by file name.
        captions: of figures, picture and film.
        failed: bars that do not hold.
        picture: PNG bytes, or why there is no picture.
        film: MP4 bytes, or why there is no film.
        sample_times: of the controller [s].
        seed: of the sensor's noise.

    """

    title: str
    introduction: Sequence[str]
    sections: Sequence[Section]
    figures: Mapping[str, str]
    captions: Mapping[str, str]
    failed: Sequence[str]
    picture: bytes | str = ""
    film: bytes | str = ""
    sample_times: Sequence[float] = ()
    seed: int = 0


def page(content: Content) -> str:
    """Return the HTML text; self-contained, the same for the same content."""
    verdict = (
        "All bars of the experiment hold."
        if not content.failed
        else "Bars that do not hold: " + "; ".join(content.failed) + "."
    )
    times = " and ".join(f"{1e3 * each:g}" for each in content.sample_times)
    made = (
        f"Controller every {times} ms, seed {content.seed}, stiffgen {stiffgen.__version__}, MuJoCo "
        f"{mujoco.__version__}. docs/results.md tells how it is made."
    )
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width,initial-scale=1">',
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; "
            'img-src data:; media-src data:">',
            f"<title>{escape(content.title)}</title><style>{STYLE}</style></head><body>",
            f"<h1>{escape(content.title)}</h1>",
            *(f"<p>{escape(paragraph)}</p>" for paragraph in (*content.introduction, made)),
            f'<p class="note">{escape(verdict)}</p>',
            *(_section(section, content) for section in content.sections),
            "<h2>The traces</h2>",
            "<p><code>traces.npz</code> has these arrays; the first axis is time, the trials one after the other.</p>",
            "<table><tr><th>array</th><th>content</th></tr>",
            *(f"<tr><td><code>{name}</code></td><td>{escape(what)}</td></tr>" for name, what in COLUMNS.items()),
            "</table>",
            "</body></html>",
            "",
        ]
    )


def _section(section: Section, content: Content) -> str:
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in astuple(row)) + "</tr>" for row in section.rows
    )
    head = "".join(f"<th>{escape(cell)}</th>" for cell in section.head)
    figures = "\n".join(_figure(name, content) for name in section.figures)
    return f"<h2>{escape(section.title)}</h2>\n<table><tr>{head}</tr>{body}</table>\n{figures}"


def _figure(name: str, content: Content) -> str:
    """Return the HTML of a figure, picture or film with its caption."""
    if name == PICTURE:
        body = _data(content.picture, '<img alt="overlaid configurations of the arm" src="data:image/png;base64,{}">')
    elif name == FILM:
        body = _data(content.film, '<video controls muted src="data:video/mp4;base64,{}"></video>')
    else:
        body = content.figures[name]
    return f"<figure>{body}<figcaption>{escape(content.captions[name])}</figcaption></figure>"


def _data(data: bytes | str, element: str) -> str:
    """Return an element with data, or a note that says why there are none."""
    if isinstance(data, str):
        return f'<p class="note">Missing: {escape(data)}.</p>'
    return element.format(base64.b64encode(data).decode())
