# SPDX-License-Identifier: MIT
"""Picture of the playground in docs/start.md, taken in headless Chromium.

PYTHONPATH=tests:. python -m lab.play.picture docs/playground.png    (after make generate)
"""

from __future__ import annotations

import base64
import sys
import tempfile
from pathlib import Path

from lab.play.browser import Page, chromium
from stiffgen.lab.play.page import write_page
from support.project import ROOT

SIZE = (1200, 980)


def take(page: Page, file: Path) -> bytes:
    """Open a playground in a window of SIZE and return its picture as PNG."""
    page.window(*SIZE)
    page.prefer(prefers_color_scheme="light")
    page.open(file)
    return base64.b64decode(page.do("Page.captureScreenshot", format="png")["data"])


def main(target: Path) -> None:
    """Take the picture of the iiwa 14's playground."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        file = write_page(ROOT / "generated" / "iiwa14", Path(folder) / "iiwa14.html")
        target.write_bytes(take(browser.page(), file))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
