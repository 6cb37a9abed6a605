# SPDX-License-Identifier: MIT
"""Flags that no macro tells are found by a self-check; tests/campaigns/flag_pairs.py sweeps all flags and pairs."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.flag_pairs import COMPILERS, FLAGS, sweep, write_sources
from support.project import Once

UNSEEN = ("-fno-honor-nans",)
"""No macro tells these."""


@pytest.fixture(scope="module")
def sources(once: Once) -> Path:
    return once("flag-pairs", write_sources) / "arm"


@pytest.mark.parametrize("compiler", [name for name in COMPILERS if name in FLAGS])
def test_flags_that_no_macro_tells_are_found(compiler: str, sources: Path, tmp_path: Path) -> None:
    """Before: with clang -fno-honor-nans every check said 0, and every torque was NaN."""
    unseen = [(flag,) for flag in FLAGS[compiler] if flag in UNSEEN]
    assert set(sweep(compiler, unseen, sources, tmp_path).values()) <= {"found"}
