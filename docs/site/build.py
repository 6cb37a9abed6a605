# SPDX-License-Identifier: MIT
"""Build the site without a network, and follow every link of the result.

python docs/site/build.py FOLDER
"""

from __future__ import annotations

import argparse
import re
import socket
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote, urldefrag

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
        self.loaded += [given[key] for key in ("src", "href", "data") if key in given and tag not in ("a", "base")]


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
    stage(folder / "pages")
    options = ["--quiet", "--fail-on-warning", "--keep-going", "-E", "-c", str(Path(__file__).parent)]
    code = sphinx([*options, str(folder / "pages"), str(folder / "html")])
    wrong = faults(folder / "html") if code == 0 else []
    print("\n".join([*wrong, f"open {folder}/html/index.html"]))
    return code or bool(wrong)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    sys.exit(main(arguments.parse_args().folder))
