# SPDX-License-Identifier: MIT
"""Loading: which libraries a use needs, and limits of memory under which these would abort or hang."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from support.project import URDF

HEAVY = {"numpy", "casadi", "sympy", "scipy", "yourdfpy", "lxml", "mpmath", "jinja2", "rich"}


def loaded(code: str) -> set[str]:
    """The heavy libraries that a fresh interpreter has loaded after this code."""
    told = f"{code}\nimport sys\nprint(*({HEAVY!r} & sys.modules.keys()), file=sys.stderr)"
    return set(subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True).stderr.split())


@pytest.mark.parametrize(
    ("code", "needed"),
    [
        ("import stiffgen, stiffgen.cli; stiffgen.cli.main([])", set()),
        ("import stiffgen.core.generate, stiffgen.core.options", {"numpy", "casadi", "mpmath", "lxml", "jinja2"}),
        ("import stiffgen.core.verify.verify", {"numpy", "casadi", "mpmath", "lxml", "jinja2"}),
    ],
)
def test_what_an_import_loads(code: str, needed: set[str]) -> None:
    """Import parts of the package: a heavy dependency must not be loaded before it is needed."""
    assert loaded(code) <= needed


ANALYZE = """import numpy as np
rows = np.random.default_rng(1).uniform(-1, 1, (20, 13))
np.savez("log.npz", q=rows[:, :7], wrench=rows[:, 7:])
stiffgen.analyze("log.npz", {folder!r}, np.diag([300.0] * 3 + [20.0] * 3), figures=False, output="analysis")"""


@pytest.mark.parametrize(
    ("use", "most"),
    [
        ("stiffgen.open_robot({folder!r})", 40),
        ("sys.path.insert(0, {parent!r}); import {name}", 1),
        pytest.param(ANALYZE, 200, marks=pytest.mark.slow),
    ],
)
def test_a_finished_folder_needs_no_reader_and_no_printer(
    use: str, most: int, robot_folder: Path, tmp_path: Path
) -> None:
    """Use a generated folder: generator and reader stay unloaded, and few modules are loaded."""
    place = {"folder": str(robot_folder), "parent": str(robot_folder.parent), "name": robot_folder.name}
    code = f"import sys, stiffgen\n{use.format(**place)}\nprint(*(m for m in sys.modules if m.startswith('stiffgen')))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    modules = done.stdout.splitlines()[-1].split()
    heavy = ("stiffgen.core.emit", "stiffgen.core.robot.reader", "stiffgen.core.generate", "stiffgen.files")
    assert not [module for module in modules if module.startswith(heavy)]
    assert len(modules) <= most + 1  # the package itself


def test_a_generated_robot_needs_numpy_alone(robot_folder) -> None:
    code = f"import sys; sys.path.insert(0, {str(robot_folder.parent)!r}); import {robot_folder.name}"
    assert loaded(code) == {"numpy"}


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [150_000, 200_000, 250_000, 350_000, 500_000, 700_000, 1_000_000])
def test_a_limit_of_memory_is_refused_in_one_sentence(kilobytes: int) -> None:
    """Limit the memory as ``ulimit -v`` does: refused in one line; OpenBLAS would abort or hang below 400 MB."""
    limit, command = kilobytes << 10, [sys.executable, "-m", "stiffgen", "inspect", str(URDF)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )  # fmt: skip
    if kilobytes < 600_000:
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert done.stderr.startswith(f"stiffgen: this process may use {limit >> 20} MiB of memory, and needs 600")
    else:
        assert done.returncode == 0, done.stderr
