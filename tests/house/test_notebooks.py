# SPDX-License-Identifier: MIT
"""The notebooks run from top to bottom in a kernel of their own, and are committed with what they print."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from support.project import ROOT

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
FIGURES = {"first_steps": 0, "my_robot": 0, "springs_and_orbits": 1, "tuning": 2}


def test_there_are_four() -> None:
    assert {notebook.stem for notebook in NOTEBOOKS} == FIGURES.keys()


def shown(book: nbformat.NotebookNode) -> list[tuple[str, list[str]]]:
    """Outputs of every cell: printed text without its numbers, and the kinds of what is displayed."""
    cells = [cell.outputs for cell in book.cells if cell.cell_type == "code"]
    texts = ["".join(output.get("text", "") for output in outputs) for outputs in cells]
    kinds = [sorted(kind for output in outputs for kind in output.get("data", ())) for outputs in cells]
    return [
        (re.sub(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?\s*", "#", text), kind) for text, kind in zip(texts, kinds, strict=True)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "notebook",
    [pytest.param(path, id=path.stem, marks=() if path.stem == "my_robot" else pytest.mark.wide) for path in NOTEBOOKS],
)
def test_runs(notebook: Path, robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a notebook beside nothing but ``generated``: it shows what is committed, but for numbers."""
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")  # no note of the kernel's debugger on frozen modules
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))  # the user's profile is neither read nor written
    book = nbformat.read(notebook, as_version=4)
    committed = shown(book)
    assert any(committed)
    NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert shown(book) == committed
    # what is committed could lack its figures, too, or show text on stderr alone
    outputs = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == FIGURES[notebook.stem]
    assert any(output.output_type == "stream" and output.name == "stdout" for output in outputs)
