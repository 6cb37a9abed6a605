# SPDX-License-Identifier: MIT
"""Compile the robot-independent C of the controller for tests, and call it with NumPy arrays."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.control.companions import SHARED
from stiffgen.control.page import LIBRARY, SOURCES
from support.project import ROOT

WARNINGS = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wshadow",
    "-Wdouble-promotion",
    "-Wcast-qual",
    "-Werror",
)


def compile_c(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Run a C compiler; fail the test with its messages."""
    done = subprocess.run(
        [compiler, *map(str, arguments), "-o", str(output)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return output


STUB = ROOT / "tests" / "support" / "stub_robot"
SHARED_SOURCES = [SHARED.folder / source for source in SHARED.sources]
LIBRARY_FLAGS = ("-std=c99", *WARNINGS, f"-I{LIBRARY}", f"-I{STUB}", f"-I{ROOT / 'generated' / 'iiwa14'}")


def compile_library(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Compile the controller's library with its stub robot into a shared library, every function visible."""
    sources = (STUB / "robot.c", *SHARED_SOURCES, *(LIBRARY / source for source in SOURCES))
    return compile_c(output, *LIBRARY_FLAGS, "-O2", "-shared", "-fPIC", *arguments, *sources, "-lm", compiler=compiler)


class Matrices:
    """Functions of shared/, core/library/matrix.c and modes.c on NumPy arrays with a number of rows."""

    def __init__(self, folder: Path, rows: int) -> None:
        sources = [*SHARED_SOURCES, LIBRARY / "matrix.c", LIBRARY / "modes.c"]
        flags = (*LIBRARY_FLAGS, "-O2", "-shared", "-fPIC", f"-DSTUB_ROWS={rows}")
        self.rows = rows
        self.library: Any = ctypes.CDLL(str(compile_c(folder / f"matrix_{rows}.so", *flags, *sources, "-lm")))
        self.library.smallest_eigenvalue.restype = ctypes.c_double

    def call(self, name: str, *arguments: np.ndarray) -> Any:
        """Call a function with arrays, which it may change."""
        return getattr(self.library, name)(*(each.ctypes.data_as(ctypes.c_void_p) for each in arguments))

    def find_modes(self, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return eigenvalues and modes V, in columns, of a symmetric matrix."""
        modes, turns = np.zeros(20 * self.rows**2 + 100), A.copy()  # more than modes_t
        self.call("find_modes", turns, modes)
        columns = []
        for row in np.eye(self.rows):
            column = row.copy()
            self.call("from_modes", modes, turns, column)
            back = column.copy()
            self.call("to_modes", modes, turns, back)
            np.testing.assert_allclose(back, row, rtol=0, atol=1e-13)
            columns.append(column)
        return modes[: self.rows].copy(), np.array(columns).T

    def smallest_eigenvalue(self, A: np.ndarray) -> float:
        """Return the smallest eigenvalue of a symmetric 3 x 3 matrix."""
        return float(self.call("smallest_eigenvalue", A))

    def form_pencil(self, K: np.ndarray, M: np.ndarray) -> tuple[bool, np.ndarray]:
        """Return whether M is positive definite, and L^-1 K L^-T with M = L L^T."""
        L, C = M.copy(), K.copy()
        if not self.call("factorise", L):
            return False, C
        self.call("invert_triangle", L)
        self.call("form_pencil", L, C)
        return True, C


def symmetric(random: np.random.Generator, values: np.ndarray) -> np.ndarray:
    """Return a random symmetric matrix with these eigenvalues."""
    Q = np.linalg.qr(random.normal(size=(len(values), len(values))))[0]
    A = Q @ np.diag(values) @ Q.T
    return np.asarray((A + A.T) / 2)


def spectra(random: np.random.Generator, rows: int, count: int) -> Iterator[np.ndarray]:
    """Yield symmetric matrices with spectra of every kind: plain, clustered, repeated, singular, positive, graded."""
    for index in range(count):
        values = random.normal(size=rows) * 10 ** random.uniform(-3, 4)
        kinds = (
            values, 100 + 1e-9 * values, np.repeat(values[: (rows + 2) // 3], 3)[:rows],
            np.where(np.arange(rows) < rows // 2, 0.0, values), np.abs(values), 10 ** random.uniform(-6, 3, size=rows),
        )  # fmt: skip
        yield symmetric(random, kinds[index % 6])


def residual(A: np.ndarray, values: np.ndarray, V: np.ndarray) -> float:
    """Return the largest error of |A V - V values| and |V^T V - I|, over the size of A."""
    size = max(float(np.abs(A).max()), 1e-300)
    return max(float(np.abs(A @ V - V * values).max()) / size, float(np.abs(V.T @ V - np.eye(len(A))).max()))
