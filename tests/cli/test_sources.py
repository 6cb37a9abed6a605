# SPDX-License-Identifier: MIT
"""``verify`` and ``analyze`` take a robot's file as they take its folder: it is generated once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen.cli.verify
from stiffgen.cli import main
from stiffgen.cli.folders import folder_of
from stiffgen.core.verify.result import Check
from stiffgen.files.cache import cache_folder
from support.chains import chain_urdf
from support.project import ROOT


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_a_file_is_generated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Generate a file twice: the second command finds the folder of the first; verify compares the file."""
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(chain_urdf("rr"))
    seen: list[tuple[Path, Any]] = []

    def verified(folder: Path, urdf: Path | None, **_: Any) -> list[Check]:
        seen.append((folder, urdf))
        return [Check("all", "seen", 0.0, 1.0, "")]

    monkeypatch.setattr(stiffgen.cli.verify, "verify", verified)
    assert main(["verify", "arm.urdf"]) == 0
    assert "compiling" in capsys.readouterr().err
    assert main(["verify", "arm.urdf"]) == 0
    assert "compiling" not in capsys.readouterr().err
    (folder, urdf), (again, _) = seen
    assert folder == again and folder.is_relative_to(cache_folder()) and urdf == Path("arm.urdf")
    rows = np.hstack([np.random.default_rng(1).uniform(-1, 1, (20, 2)), np.ones((20, 6))])
    np.savez("log.npz", q=rows[:, :2], wrench=rows[:, 2:])
    numbers = ["300", "300", "300", "20", "20", "20"]
    assert main(["analyze", "log.npz", "--robot", "arm.urdf", "--task-stiffness", *numbers]) == 0
    assert len(list(cache_folder().glob("arm-*.lock"))) == 1


def test_a_folder_is_taken_as_it_is(tmp_path: Path) -> None:
    for source in (str(tmp_path), tmp_path):
        assert folder_of(source, None, lambda step: None) == tmp_path


def test_what_needs_an_option_is_generated_by_the_user(capsys: Any) -> None:
    assert main(["verify", str(ROOT / "tests" / "data" / "dual_arm.urdf")]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "several leaf links" in error and "'stiffgen generate', then give its folder here" in error
