# SPDX-License-Identifier: MIT
"""Robots that the tests of several pages share."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffgen
from stiffgen.core.symbolic.choices import KernelOptions
from support.project import URDF, Once


@pytest.fixture(scope="session")
def derived(once: Once) -> Path:
    """Return the iiwa 14 with derivatives and CUDA, compiled without optimisation."""

    def make(output: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", "-O0")
            stiffgen.generate(URDF, derivatives=True, cuda=True, output=output)

    return once("derived", make) / "iiwa14"
