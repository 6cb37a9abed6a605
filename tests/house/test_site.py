# SPDX-License-Identifier: MIT
"""The site in Chromium, on a screen and on a phone: no name is broken, no page is wider than the window."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from lab.play.browser import chromium, require_chromium
from support.project import ROOT

BROKEN = r"""
(() => {
  const found = [], seen = new Set();
  const hyphenated = /(^[("']*--?\w|\d.*-|-.*\d|\w_\w)/;
  const parts = "td, th, code, p, li, h1, h2, h3";
  for (const part of document.querySelector("article").querySelectorAll(parts)) {
    const texts = document.createTreeWalker(part, NodeFilter.SHOW_TEXT);
    for (let text; (text = texts.nextNode());) {
      const around = text.parentElement;
      if (seen.has(text) || !around.checkVisibility() || around.closest("pre, math, svg")) continue;
      seen.add(text);
      for (const word of text.data.matchAll(/\S+/g)) {
        const plain = word[0].includes("-") && !hyphenated.test(word[0]) && !around.closest("td, th, code");
        // A compound of English, a sign, an address or a formula is no name.
        if (plain || !/\w/.test(word[0]) || /[\/<>\[]|\w\(/.test(word[0])) continue;
        const range = document.createRange();
        range.setStart(text, word.index);
        range.setEnd(text, word.index + word[0].length);
        const lines = new Set([...range.getClientRects()].filter(b => b.width > 0.5).map(b => Math.round(b.top / 4)));
        if (lines.size > 1) found.push(word[0]);
      }
    }
  }
  return [found, document.documentElement.scrollWidth];
})()
"""
LOADED = (
    "new Promise(done => { (function look() {"
    " document.readyState === 'complete' ? done(null) : setTimeout(look, 20); })(); })"
)
LONG = "document.querySelector('article p').innerHTML = '<b style=\"word-break: break-all\">' + 'a_b'.repeat(200)"


def site_module(name: str) -> ModuleType:
    """Return a module of docs/site; a package of the same name may be installed."""
    spec = spec_from_file_location(name, ROOT / "docs" / "site" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.wide(instead="tests/house/test_docs.py::test_every_block_says_its_language")
def test_no_name_is_broken(tmp_path: Path) -> None:
    """Draw all pages 1400 and 360 pixels wide: no name is broken; one broken on purpose is found."""
    require_chromium()
    command = [sys.executable, str(ROOT / "docs" / "site" / "build.py"), str(tmp_path)]
    subprocess.run(command, capture_output=True, check=True)
    files = [file for file in sorted(tmp_path.glob("html/**/*.html")) if "playground" not in file.parent.name]
    assert len(files) > 30
    broken, wide = {}, {}
    with chromium() as browser:
        page = browser.page()
        for file in files:
            page.do("Page.navigate", url=file.as_uri())
            page.js(LOADED)
            for width in (1400, 360):
                page.window(width, 900)
                page.settle()
                words, extent = page.js(BROKEN)
                broken |= {(file.name, width): words} if words else {}
                wide |= {(file.name, width): extent} if extent > width else {}
        page.js(LONG)
        assert page.js(BROKEN)[0] == ["a_b" * 200]
    assert broken == {}
    assert wide == {}


def test_figures_with_panels_in_a_row_are_folded() -> None:
    """Fold figures for narrow pages: panels go below each other with all their elements."""
    module = site_module("narrow")
    texts = {name: (ROOT / "docs" / f"{name}.svg").read_text() for name in ("flutter", "adaptive", "measured")}
    folded = module.narrow(texts["flutter"])
    wide, high = map(float, re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', texts["flutter"])[0])
    narrow, higher = map(float, re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', folded)[0])
    assert narrow < 0.6 * wide and higher == 2 * high
    assert re.search(rf'id="axes_2"[^>]*translate\(-[\d.]+ {high:g}\)', folded)
    assert folded.count("<text") == texts["flutter"].count("<text")
    others = [texts["adaptive"], texts["measured"], (ROOT / "docs" / "analyze_moment.svg").read_text()]
    assert [module.narrow(text) for text in others] == [None, None, None]


def test_no_panel_of_a_folded_figure_loses_its_label() -> None:
    """Labels along the vertical axis, in 9 points, stand that far from the edge in every panel."""
    module, panels = site_module("narrow"), 0
    for file in sorted((ROOT / "docs").rglob("*.svg")):
        folded = module.narrow(file.read_text())
        for panel in re.split(r'(?=id="axes_\d)', folded or "")[1:]:
            shift = float(re.findall(r'^id="axes_\d" transform="translate\((\S+) ', panel)[0])
            labels = re.findall(r'font-size: ([\d.]+)px[^>]*transform="rotate\(-90 ([\d.]+) ', panel)
            assert [label for label in labels if float(label[1]) + shift < float(label[0])] == [], file
            panels += 1
    assert panels > 8


def test_a_build_begins_without_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a page of an older build with a dead link: it is gone, and no check fails."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    pytest.importorskip("sphinx")
    build = site_module("build")
    old = tmp_path / "html" / "old.html"
    old.parent.mkdir()
    old.write_text('<a href="gone.html">gone</a>')
    assert build.faults(tmp_path / "html") == ["old.html leads to gone.html"]

    def write(words: list[str]) -> int:
        (Path(words[-1]) / "_static").mkdir(parents=True)
        return 0

    for name, instead in (("cut_the_network", lambda: None), ("stage", lambda _: None), ("sphinx", write)):
        monkeypatch.setattr(build, name, instead)
    assert build.main(tmp_path) == 0
    assert not old.exists()
