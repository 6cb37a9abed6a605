# SPDX-License-Identifier: MIT
"""Build the site without a network, and follow every link of the result.

python docs/site/build.py FOLDER
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import socket
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urldefrag

from narrow import narrow
from pages import stage
from sphinx.cmd.build import main as sphinx

_ELSEWHERE = re.compile(r"[a-z]+:|//")


def cut_the_network() -> None:
    """Refuse every connection of this process from now on."""

    def refuse(*_: Any) -> NoReturn:
        raise OSError("the site is built without a network")

    for where, name in ((socket.socket, "connect"), (socket, "getaddrinfo")):
        setattr(where, name, refuse)


class Page(HTMLParser):
    """A page: its anchors, its links, and what a browser loads with it."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(file.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record an element's addresses."""
        given = {key: value for key, value in attrs if value}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        self.links += [given["href"]] if tag == "a" and "href" in given else []
        self.loaded += [
            given[key] for key in ("src", "srcset", "href", "data") if key in given and tag not in ("a", "base")
        ]


class Excerpt(HTMLParser):
    """Text of a page's main part: ``sections``, pairs of an anchor and the text behind it."""

    _SILENT = ("script", "style", "svg", "button")
    _BLOCKS = ("p", "li", "td", "th", "dt", "dd", "pre", "h1", "h2", "h3", "h4", "div")

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.sections: list[tuple[str, str]] = []
        self._inside = self._silent = 0
        self.feed(file.read_text())
        self.sections = [(anchor, " ".join(text.replace("¶", "").split())) for anchor, text in self.sections]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Enter the main part, or a section of it."""
        given = dict(attrs)
        if tag == "article" and given.get("role") == "main":
            self._inside, self.sections = 1, [("", "")]
        if not self._inside:
            return
        self._silent += tag in self._SILENT
        if tag == "section":
            self.sections.append((given.get("id") or "", ""))

    def handle_endtag(self, tag: str) -> None:
        """Leave the main part; words of two blocks stand apart."""
        self._silent -= self._inside and tag in self._SILENT
        if tag == "article":
            self._inside = 0
        if tag in self._BLOCKS:
            self.handle_data(" ")

    def handle_data(self, data: str) -> None:
        """Add text to the section."""
        if self._inside and not self._silent:
            anchor, text = self.sections[-1]
            self.sections[-1] = (anchor, text + data)


def write_excerpts(folder: Path) -> None:
    """Write the index of excerpts that the search shows where the site is opened from a file."""
    index = {str(file.relative_to(folder)): Excerpt(file).sections for file in sorted(folder.rglob("*.html"))}
    text = json.dumps({page: sections for page, sections in index.items() if sections}, ensure_ascii=False)
    (folder / "_static" / "excerpts.js").write_text(f"window.excerpts = {text};\n")


def fold_figures(folder: Path) -> None:
    """Write narrow forms of the figures that have one, and let the pages show them in narrow windows."""
    folded = {file.name: text for file in (folder / "_images").glob("*.svg") if (text := narrow(file.read_text()))}
    (folder / "narrow").mkdir(exist_ok=True)
    for name, text in folded.items():
        (folder / "narrow" / name).write_text(text)

    def both(found: re.Match[str]) -> str:
        if found[3] not in folded:
            return found[0]
        source = f'<source media="(max-width: 30em)" srcset="{found[2]}narrow/{found[3]}">'
        return f"<picture>{source}{found[0]}</picture>"

    for file in folder.rglob("*.html"):
        text = file.read_text()
        changed = re.sub(r'(<img [^>]*src="([^"]*)_images/([^"/]+)"[^>]*>)', both, text)
        if changed != text:
            file.write_text(changed)


def faults(folder: Path) -> list[str]:
    """Return links of the site that lead nowhere, and addresses that it would load from a network."""
    pages = {file.resolve(): Page(file) for file in folder.rglob("*.html")}
    found = [
        f"{file.relative_to(folder)} loads {address}"
        for file in folder.rglob("*.css")
        for address in re.findall(r"(?:url\(|@import )[\"']?((?:https?:)?//[^\"')]+)", file.read_text())
    ]
    for file, page in pages.items():
        name = file.relative_to(folder.resolve())
        for address in page.links + page.loaded:
            if _ELSEWHERE.match(address):
                if address in page.loaded and not address.startswith("data:"):
                    found.append(f"{name} loads {address}")
                continue
            path, anchor = urldefrag(address)
            target = (file.parent / unquote(path.partition("?")[0])).resolve() if path else file
            if not target.exists():
                found.append(f"{name} leads to {address}")
            elif anchor and target in pages and unquote(anchor) not in pages[target].anchors:
                found.append(f"{name} leads to {address}, which has no such place")
    return found


def main(folder: Path) -> int:
    """Stage, build and check the site; return 0 if all is well."""
    cut_the_network()
    print("writing the pages, and compiling the playground, usually half a minute ...", flush=True)
    stage(folder / "pages")
    shutil.rmtree(folder / "html", ignore_errors=True)  # pages of an older build would be followed, too
    print("building the site, usually a minute ...", flush=True)
    options = ["--quiet", "--fail-on-warning", "--keep-going", "-E", "-c", str(Path(__file__).parent)]
    code = sphinx([*options, str(folder / "pages"), str(folder / "html")])
    if code == 0:
        write_excerpts(folder / "html")
        fold_figures(folder / "html")
    wrong = faults(folder / "html") if code == 0 else []
    print("\n".join([*wrong, f"open {folder}/html/index.html"]))
    return code or bool(wrong)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    sys.exit(main(arguments.parse_args().folder))
