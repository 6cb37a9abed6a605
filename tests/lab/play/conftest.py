# SPDX-License-Identifier: MIT
"""Browser and page of the tests of the playground: one process for all of a worker's tests, a tab for each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from lab.play.browser import Browser, chromium, require_chromium
from stiffgen.lab.play.page import write_page
from support.playground import require_wasm
from support.project import Once


@pytest.fixture(scope="session")
def file(robot_folder: Path, once: Once) -> Path:
    """Return the playground of the iiwa 14."""
    require_wasm()
    require_chromium()
    return once("playground", lambda folder: write_page(robot_folder, folder / "play.html")) / "play.html"


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running
