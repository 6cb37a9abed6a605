# SPDX-License-Identifier: MIT
"""Draw a shoulder and a hip, held by three drives and by the gradient, as an SVG that moves (SMIL)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from examples.flutter import GRADIENT, LAWS, POSTURES, watch_limb
from examples.style import CONVENTIONAL, CORRECTED

Array = NDArray[np.float64]

FIRST, LAST, EVERY = 2.0, 12.0, 40
"""Part of the motion that is shown [s], and steps of 1 ms between two frames."""
SIZE = 145.0  # pixels per metre
WIDTH, HEIGHT = 190, 270  # of a panel
AZIMUTH = np.radians(-35.0)  # from which one looks, level with the limb
THICK = 13  # pixels
LETTERS = 26  # pixels: 11 on a phone, where the film is 330 wide


def seen(points: Array) -> Array:
    """Return pixels (..., 2) of points (..., 3) [m] about a joint, which is in the upper half of its panel."""
    across = -np.sin(AZIMUTH) * points[..., 0] + np.cos(AZIMUTH) * points[..., 1]
    return np.stack([WIDTH / 2 + SIZE * across, 0.42 * HEIGHT - SIZE * points[..., 2]], axis=-1)


def polyline(pixels: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)


def panel(points: Array, resting: Array, law: str, place: tuple[float, float]) -> str:
    """Return the group of one limb under one law: on its way (k, 3, 3) [m], and its target (3, 3) as an outline."""
    shown = points[round(1e3 * FIRST / EVERY) :]
    target, frames = seen(resting - resting[0]), [polyline(seen(each - each[0])) for each in shown]
    colour = dict(zip(LAWS, (CONVENTIONAL, CORRECTED), strict=True))[law]
    x, y = place
    return (
        f'<g transform="translate({x:g} {y:g})">\n'
        f'<polyline points="{polyline(target)}" fill="none" stroke="currentColor" stroke-opacity="0.25" '
        f'stroke-width="{THICK + 6}"/>\n'
        f'<polyline points="{frames[0]}" fill="none" stroke="{colour}" stroke-width="{THICK}">'
        f'<animate attributeName="points" dur="{LAST - FIRST:g}s" repeatCount="indefinite" '
        f'values="{";".join(frames)}"/></polyline>\n</g>\n'
    )


def text(place: tuple[float, float], words: str) -> str:
    return f'<text x="{place[0]:g}" y="{place[1]:g}">{words}</text>\n'


def film() -> str:
    """Return the SVG text: one row, the limbs under one law beside those under the other."""
    top, body, count = 4 * LETTERS // 3, "", len(POSTURES)
    motions = {(joint, law): watch_limb(joint, law, LAST, EVERY)[1] for joint in POSTURES for law in LAWS}
    for column, law in enumerate(LAWS):
        body += text(((column + 0.5) * count * WIDTH, LETTERS), law)
        for row, joint in enumerate(POSTURES):
            left = (column * count + row) * WIDTH
            body += text((left + WIDTH / 2, 9 * LETTERS // 4), joint)
            body += panel(motions[joint, law], motions[joint, GRADIENT][-1], law, (left, top))
    width, height = WIDTH * len(LAWS) * count, top + HEIGHT
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="system-ui, sans-serif" font-size="{LETTERS}" text-anchor="middle" fill="currentColor" '
        'stroke-linecap="round" stroke-linejoin="round" role="img">\n'
        "<style>svg { color: #1f2328; } @media (prefers-color-scheme: dark) { svg { color: #e6edf3; } }</style>\n"
        f"{body}</svg>\n"
    )
