# SPDX-License-Identifier: MIT
"""Write the report: one HTML page with the summary and the figures, with a light and a dark theme."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import mujoco

import stiffgen
from examples.bowl_wiping.analysis import Row
from examples.bowl_wiping.trial import COLUMNS

TITLE = "Bowl wiping with and without the correction"
PICTURE = "postures.png"
CAPTIONS = {
    "antisymmetric.svg": "Largest singular value of the antisymmetric part of the joint stiffness that the controller "
    "applied. With the correction it is zero at every step. Without it, it is the closed form, and follows the moment "
    "at the tool. The vertical line in this and the other figures is the start of the wipe.",
    PICTURE: "Postures of the corrected trial: start, start of the wipe, on the way, and the turning point (solid). "
    "Rendered by MuJoCo.",
    "joints.svg": "Joint positions: corrected solid, conventional dashed, potential law dash-dotted, zero-force "
    "trajectory dotted. The distance from the zero-force trajectory is the spring's deflection, with which the arm "
    "presses on the bowl. Towards the end the arm swings under the paper's law: the smallest eigenvalue is small "
    "there, and the nullspace has 0.1 N m s/rad of damping alone. The potential law designs damping for every mode.",
    "wrench.svg": "Forces and moments of the environment on the robot at the tool point in base axes, from the "
    "force/torque sensor, the tool's weight and inertia taken out, mean of three samples.",
    "singular_values.svg": "Largest singular values of both parts of the joint stiffness: applied in the paper's law, "
    "the tangent of the energy in the potential law. Corrected and conventional symmetric parts differ only as far as "
    "the motions do.",
    "eigenvalues.svg": "Eigenvalues of the symmetric part. Symmetric is not positive definite: for some of the wipe "
    "the smallest one is below zero, with and without the correction. In the paper's law, which pulls by this matrix, "
    "the spring then pushes away from its zero-force position, and damping alone slows it. In the potential law the "
    "matrix pulls nothing: it says that the torque falls as the arm yields, and the energy bounds where that ends.",
    "energy.svg": "Energy account of the controller (docs/controller.md). The paper's law has no energy: "
    "what it puts out is all that is known. The potential law stores what the moving equilibrium puts in, and damping "
    "takes it out.",
    "trajectory.svg": "The zero-force trajectory: as recorded, and by inverse kinematics from the stated and from the "
    "measured geometry.",
}
"""Figures in the order of the page, with their captions."""

STYLE = """
:root{color-scheme:light dark;--ink:#1f2328;--page:#ffffff;--soft:#59636e;--line:#d1d9e0;--box:#f6f8fa}
@media(prefers-color-scheme:dark){:root{--ink:#e6edf3;--page:#0d1117;--soft:#9198a1;--line:#3d444d;--box:#151b23}}
body{color:var(--ink);background:var(--page);font:16px/1.5 system-ui,sans-serif}
body{max-width:62rem;margin:0 auto;padding:1.5rem}
h1{font-size:1.7rem;line-height:1.2}h2{font-size:1.25rem;margin-top:2.2rem}
table{border-collapse:collapse;width:100%;font-size:.9rem;display:block;overflow-x:auto}
th,td{border-bottom:1px solid var(--line);padding:.45rem .6rem;text-align:left;vertical-align:top}
th{background:var(--box)}figure{margin:1.5rem 0}figcaption{color:var(--soft);font-size:.9rem;max-width:50rem}
figure svg,figure img{width:100%;height:auto;max-width:56rem}code{background:var(--box);padding:.1em .3em}
.note{background:var(--box);border-left:4px solid var(--line);padding:.6rem 1rem}
"""


@dataclass(frozen=True)
class Content:
    """Content of the page.

    ``figures``: SVG text by file name; ``picture``: PNG bytes, or why there is none; ``failed``: bars that do not hold.
    """

    sample_time: float
    seed: int
    rows: Sequence[Row]
    trajectory_rows: Sequence[Row]
    figures: Mapping[str, str]
    picture: bytes | str
    failed: Sequence[str]


def page(content: Content) -> str:
    """Return the HTML text; self-contained, the same for the same content."""
    verdict = (
        "All bars of the experiment hold."
        if not content.failed
        else "Bars that do not hold: " + "; ".join(content.failed) + "."
    )
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width,initial-scale=1">',
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; "
            'img-src data:">',
            f"<title>{TITLE}</title><style>{STYLE}</style></head><body>",
            f"<h1>{TITLE}</h1>",
            "<p>The experiment of Lachner, Nah and Hogan, &ldquo;A Physically Consistent Stiffness Formulation for "
            "Contact-Rich Manipulation&rdquo; (2025), in simulation: an LBR iiwa 14 wipes a bowl three times: with the "
            "paper's law, its joint stiffness corrected and conventional, and with the gradient of a spring's energy. "
            f"Controller every {1e3 * content.sample_time:g} ms, seed {content.seed}, stiffgen {stiffgen.__version__}, "
            f"MuJoCo {mujoco.__version__}. <code>docs/experiment.md</code> tells how it is made.</p>",
            f'<p class="note">{escape(verdict)}</p>',
            "<h2>The paper and this simulation</h2>",
            _table(("what", "paper", "measured here", "remark"), content.rows),
            *(_figure(name, content) for name in CAPTIONS if name != "trajectory.svg"),
            "<h2>The zero-force trajectory made anew</h2>",
            _table(("from", "geometry", "largest deviation from the recording", "remark"), content.trajectory_rows),
            _figure("trajectory.svg", content),
            "<h2>The traces</h2>",
            "<p><code>traces.npz</code> has these arrays; the first axis is time, the trials one after the other.</p>",
            "<table><tr><th>array</th><th>what</th></tr>",
            *(f"<tr><td><code>{name}</code></td><td>{escape(what)}</td></tr>" for name, what in COLUMNS.items()),
            "</table>",
            "</body></html>",
            "",
        ]
    )


def _table(head: Sequence[str], rows: Sequence[Row]) -> str:
    cells = [(row.what, row.paper, row.measured, row.remark) for row in rows]
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in cells)
    return "<table><tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + f"</tr>{body}</table>"


def _figure(name: str, content: Content) -> str:
    if name != PICTURE:
        body = content.figures[name]
    elif isinstance(content.picture, str):
        return f'<p class="note">The rendered picture is missing: {escape(content.picture)}.</p>'
    else:
        data = base64.b64encode(content.picture).decode()
        body = f'<img alt="overlaid postures of the arm over the bowl" src="data:image/png;base64,{data}">'
    return f"<figure>{body}<figcaption>{escape(CAPTIONS[name])}</figcaption></figure>"
