# SPDX-License-Identifier: MIT
"""The playground's picture in the documentation is the page as it is drawn now, with the colour of every key."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lab.play.browser import Browser, Page
from lab.play.picture import take
from support.pictures import pixels, share_of_pixels
from support.project import ROOT

pytestmark = pytest.mark.slow

COMMITTED = (ROOT / "docs" / "playground.png").read_bytes()
SAME = 0.003
"""Share of blocks that may differ; test_a_change_is_seen says what a change makes of it."""
KEYS = ("exact", "conventional", "corrected", "translation", "rotation")


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    opened = browser.page()
    yield opened
    opened.do("Page.close")


def test_the_picture_is_the_page(page: Page, file: Path) -> None:
    """Compare the committed picture with the page as drawn now, and look for its colours."""
    found = share_of_pixels(take(page, file), COMMITTED)
    again = "PYTHONPATH=tests python -m lab.play.picture docs/playground.png takes it anew"
    assert found < SAME, f"{found:.3f} of docs/playground.png differs: {again}"
    colours = np.rint(255 * pixels(COMMITTED)[..., :3]).astype(int)
    for key in KEYS:
        text = page.js(f"getComputedStyle(document.documentElement).getPropertyValue('--{key}')").strip()
        colour = [int(text[k : k + 2], 16) for k in (1, 3, 5)]
        assert np.count_nonzero(np.all(colours == colour, axis=2)) > 50, f"{key}: {text} is not in the picture"


@pytest.mark.parametrize(
    ("old", "new"), [("Energy out of nothing", "Energy"), ("The gains", "The coefficients"), ("#27935f", "#1f8fd6")]
)
def test_a_change_is_seen(page: Page, file: Path, tmp_path: Path, old: str, new: str) -> None:
    """A shorter preset, a word, the colour of a key."""
    text = file.read_text()
    assert old in text
    (tmp_path / "play.html").write_text(text.replace(old, new))
    changed = take(page, tmp_path / "play.html")
    if old.startswith("#"):  # too small for a share of blocks
        colours = np.rint(255 * pixels(changed)[..., :3]).astype(int)
        assert not np.all(colours == [0x27, 0x93, 0x5F], axis=2).any()
    else:
        assert share_of_pixels(changed, COMMITTED) > SAME


@pytest.mark.parametrize("width", [1400, 360])
def test_a_preset_scrolls_to_what_it_shows(page: Page, file: Path, width: int) -> None:
    """Its panel lies up to 3700 pixels down; on a phone the arm stays above it."""
    page.window(width, 900)
    page.open(file)
    for name, title in (("Energy out of nothing", "loop-title"), ("Moment at the tip", "matrix-title")):
        page.js("scrollTo(0, 0)")
        page.js(f"[...document.querySelectorAll('#presets button')].find(b => b.textContent === {name!r}).click()")
        page.settle()
        top = page.js(f"document.getElementById('{title}').getBoundingClientRect().top")
        assert 0 <= top < 0.61 * 900, (name, top)
        if width == 360:
            assert 0 <= page.js("document.getElementById('arm').getBoundingClientRect().top") < 5


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (360, 740)])
def test_the_first_load_shows_the_effect_without_a_click(page: Page, file: Path, width: int, height: int) -> None:
    """The pushed arm, the difference of mirrored entries and the energy of a lap; a wide window has both matrices."""
    page.window(width, height)
    page.open(file)
    apart = page.js("2 * Math.max(...playground.now.matrices.antisymmetric)")
    net = page.js("playground.now.works.conventional.at(-1)")
    text = page.js("document.getElementById('effect').textContent")
    assert f"{apart:.3g} N m/rad" in text and f"{abs(net):.3g} J" in text
    matrices = ["#maps figure:nth-child(1)", "#maps figure:nth-child(2)"]
    for part in ["#arm", "#effect", *(matrices if width > 1000 else [])]:
        top, bottom = page.js(f"(b => [b.top, b.bottom])(document.querySelector('{part}').getBoundingClientRect())")
        assert 0 <= top < bottom <= height, part
    page.js("[...document.querySelectorAll('#presets button')].find(b => b.textContent === 'No load').click()")
    page.settle()
    assert page.js("document.getElementById('effect').textContent").startswith("No moment acts")
