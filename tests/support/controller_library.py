# SPDX-License-Identifier: MIT
"""Compile the robot-independent C of the controller for tests, and call it with NumPy arrays."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.ctypeslib import ndpointer

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
MAX_ROWS = 40
IN = ndpointer(np.float64, flags="C_CONTIGUOUS")
OUT = ndpointer(np.float64, flags=("C_CONTIGUOUS", "WRITEABLE"))

SIGNATURES = {
    "diagonalise_symmetric": (ctypes.c_int, OUT, OUT, OUT),
    "find_largest_eigenvalue": (IN,),
    "solve_pencil": (ctypes.c_int, IN, IN, OUT, OUT, OUT, OUT, OUT),
    "solve_modes": (ctypes.c_int, IN, IN, OUT, OUT, OUT),
    "refine_modes": (ctypes.c_int, IN, IN, OUT, OUT, OUT),
    "soften": (IN, ctypes.c_double, OUT, OUT),
    "is_positive_semidefinite": (ctypes.c_int, IN, ctypes.c_double),
    "solve_rows": (ctypes.c_int, ctypes.c_int, IN, OUT),
    "solve_damped": (ctypes.c_int, IN, ctypes.c_double, OUT),
}


def compile_c(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Run a C compiler; fail the test with its messages."""
    done = subprocess.run(
        [compiler, *map(str, arguments), "-o", str(output)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return output


STUB = ROOT / "tests" / "support" / "stub_robot"
LIBRARY_FLAGS = ("-std=c99", *WARNINGS, f"-I{LIBRARY}", f"-I{STUB}", f"-I{ROOT / 'generated' / 'iiwa14'}")


def compile_library(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Compile the controller's library with its stub robot into a shared library, every function visible."""
    sources = (STUB / "robot.c", *(LIBRARY / source for source in SOURCES))
    return compile_c(output, *LIBRARY_FLAGS, "-O2", "-shared", "-fPIC", *arguments, *sources, "-lm", compiler=compiler)


class Matrices:
    """Functions of library/matrix.c, eigen.c and modes.c on NumPy arrays, for up to MAX_ROWS rows."""

    def __init__(self, folder: Path) -> None:
        path = compile_library(folder / "matrix.so", f"-DSTUB_ROWS={MAX_ROWS}")
        self.library: Any = ctypes.CDLL(str(path))
        for name, signature in SIGNATURES.items():
            getattr(self.library, name).argtypes = signature
        self.library.find_largest_eigenvalue.restype = ctypes.c_double

    def diagonalise_symmetric(self, A: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(A)
        values, rows = np.empty(n), np.empty((n, n))
        return self.library.diagonalise_symmetric(n, A.copy(), values, rows), values, rows.T

    def find_largest_eigenvalue(self, A: np.ndarray) -> float:
        return float(self.library.find_largest_eigenvalue(A))

    def solve_pencil(self, K: np.ndarray, M: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Return the code, eigenvalues and eigenvectors V, V^T M V = I."""
        n = len(K)
        L, C, values, rows, scale = np.zeros((n, n)), np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(1)
        code = self.library.solve_pencil(n, K, M, L, C, values, rows, scale)
        V = np.linalg.solve(np.tril(L).T, rows.T) / np.sqrt(scale) if code == 0 else rows
        return code, values, V

    def solve_modes(self, K: np.ndarray, M: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Return the code, eigenvalues and modes V, V^T M V = I."""
        n = len(K)
        work, values, rows = np.empty(2 * n * n), np.empty(n), np.empty((n, n))
        return self.library.solve_modes(n, K, M, work, values, rows), values, rows.T

    def refine_modes(self, K: np.ndarray, M: np.ndarray, start: np.ndarray) -> tuple[bool, np.ndarray, np.ndarray]:
        """Return whether the modes became those of the pencil, eigenvalues and modes V, V^T M V = I."""
        n = len(K)
        work, values, rows = np.empty(2 * n * n), np.empty(n), np.ascontiguousarray(start.T)
        return bool(self.library.refine_modes(n, K, M, work, values, rows)), values, rows.T

    def soften(self, wanted: np.ndarray, share: float, K: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Return whether K differed from wanted, K after the change, and the cost."""
        rest, cost = K.copy(), np.empty((3, 3))
        return self.library.soften(wanted, share, rest, cost), rest, cost

    def is_positive_semidefinite(self, A: np.ndarray) -> bool:
        return bool(self.library.is_positive_semidefinite(len(A), A, 1e-9))

    def solve_rows(self, L: np.ndarray, X: np.ndarray) -> np.ndarray:
        """Return L^-1 X; only the lower triangle of L is read."""
        result = X.copy()
        self.library.solve_rows(len(L), X.shape[1], L, result)
        return result

    def solve_damped(self, A: np.ndarray, shift: float, x: np.ndarray) -> tuple[bool, np.ndarray]:
        """Return whether A + shift I is positive definite, and (A + shift I)^-1 x."""
        result = x.copy()
        return bool(self.library.solve_damped(len(A), A, shift, result)), result


def symmetric(random: np.random.Generator, values: np.ndarray) -> np.ndarray:
    n = len(values)
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = Q @ np.diag(values) @ Q.T
    return np.asarray((A + A.T) / 2)


def pencils(seed: int, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (K, M) of every size up to MAX_ROWS: plain, clustered, repeated, singular, indefinite, graded spectra."""
    random = np.random.default_rng(seed)
    for index in range(count):
        n = int(random.integers(1, MAX_ROWS + 1))
        values = random.normal(size=n) * 10 ** random.uniform(-3, 4)
        kind = index % 6
        if kind == 1:
            values = 100 + 1e-9 * random.normal(size=n)
        elif kind == 2:
            values = np.repeat(values[: (n + 2) // 3], 3)[:n]
        elif kind == 3:
            values[: n // 2] = 0.0
        elif kind == 4:
            values = np.abs(values)
        elif kind == 5:
            values = 10 ** random.uniform(-6, 3, size=n)
        mass = 10 ** random.uniform(-1.5, 1.5, size=n)
        if kind == 2:
            mass[:] = mass[0]
        yield symmetric(random, values), symmetric(random, mass)


def residual(K: np.ndarray, M: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> float:
    """Return the largest |K v - lambda M v| / ((|K| + |lambda| |M|) |v|) in 2-norms."""
    scale = np.linalg.norm(K, 2) + np.abs(values) * np.linalg.norm(M, 2)
    difference = np.linalg.norm(K @ vectors - M @ vectors * values, axis=0)
    return float(np.max(difference / np.where(scale > 0, scale, 1) / np.linalg.norm(vectors, axis=0)))
