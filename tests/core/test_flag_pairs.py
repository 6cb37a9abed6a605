# SPDX-License-Identifier: MIT
"""Flags that no macro tells are found by a self-check; tests/campaigns/flag_pairs.py sweeps all flags and pairs."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from campaigns.flag_pairs import COMPILERS, FLAGS, sweep, write_sources
from support.project import Once

UNSEEN = ("-fno-honor-nans",)
"""No macro tells these."""


@pytest.fixture(scope="module")
def sources(once: Once) -> Path:
    return once("flag-pairs", write_sources) / "arm"


@pytest.mark.slow
@pytest.mark.parametrize("compiler", [name for name in COMPILERS if set(UNSEEN) & set(FLAGS.get(name, ()))])
def test_flags_that_no_macro_tells_are_found(compiler: str, sources: Path, tmp_path: Path) -> None:
    """Before: with clang -fno-honor-nans every check said 0, and every torque was NaN."""
    unseen = [(flag,) for flag in FLAGS[compiler] if flag in UNSEEN]
    assert set(sweep(compiler, unseen, sources, tmp_path).values()) == {"found"}


@pytest.mark.slow
@pytest.mark.parametrize("compiler", [name for name in COMPILERS if name in FLAGS])
def test_the_papers_law_sees_nan_by_its_bits(compiler: str, sources: Path, tmp_path: Path) -> None:
    """Compile with flags that no macro tells: NaN is seen by its bits. Before: torques of NaN."""
    refusing = [*(flag for flag in FLAGS[compiler] if flag in UNSEEN), "-fno-signed-zeros", "-ffinite-math-only"]
    printed: dict[tuple[str, ...], str] = {}
    rest = [compiler, "-std=gnu99", "-O1", "-w", f"-I{sources}"]
    others = [str(tmp_path / f"{name}.o") for name in ("arm", "arm_impedance", "main")]
    for other in others:
        subprocess.run([*rest, "-c", str(sources / f"{Path(other).stem}.c"), "-o", other], check=True)
    for flags in ((), *((flag,) for flag in refusing)):
        objects = tmp_path / "paper.o"
        paper = ["-std=gnu99", "-O2", *flags, "-c", str(sources / "arm_paper.c"), "-o", str(objects)]
        done = subprocess.run([compiler, *paper], capture_output=True, text=True, check=False)
        if "-ffinite-math-only" in flags:
            assert "compile without" in done.stderr
            continue
        subprocess.run([*rest, *others, str(objects), "-lm", "-o", str(tmp_path / "program")], check=True)
        printed[flags] = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True).stdout
    assert len(printed) > 1 and len(set(printed.values())) == 1
