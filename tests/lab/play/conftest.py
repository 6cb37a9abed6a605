# SPDX-License-Identifier: MIT
"""Browser and page of the tests of the playground: one process for all of a worker's tests, a tab for each."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from lab.play.browser import Browser, chromium, require_chromium
from stiffgen.lab.play.page import write_page
from stiffgen.lab.play.wasm import compile_wasm
from support.playground import require_wasm
from support.project import Once


@pytest.fixture(scope="session", autouse=True)
def _kept_wasm(once: Once) -> Iterator[None]:
    """Compile each robot's kernels for WebAssembly once for all workers."""

    def kept(source: Path, functions: Sequence[str]) -> bytes:
        texts = [os.environ["PATH"], *functions, *(file.read_text() for file in sorted(source.parent.glob("*.[ch]")))]
        digest = hashlib.sha256("\0".join(texts).encode()).hexdigest()
        made = once(f"wasm-{digest}", lambda folder: (folder / "wasm").write_bytes(compile_wasm(source, functions)))
        return (made / "wasm").read_bytes()

    with pytest.MonkeyPatch.context() as patch:
        for user in ("stiffgen.lab.play.page", "support.playground"):
            patch.setattr(f"{user}.compile_wasm", kept)
        yield


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
