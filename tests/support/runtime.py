# SPDX-License-Identifier: MIT
"""The robot-independent C of stiffgen, compiled for tests, and its functions on NumPy arrays."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.ctypeslib import ndpointer

from stiffgen.emit.controller import RUNTIME

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")
MAX_ROWS = 40
IN = ndpointer(np.float64, flags="C_CONTIGUOUS")
OUT = ndpointer(np.float64, flags=("C_CONTIGUOUS", "WRITEABLE"))

SIGNATURES = {
    "eigen_symmetric": (ctypes.c_int, OUT, OUT, OUT),
    "pencil": (ctypes.c_int, IN, IN, OUT, OUT, OUT, OUT, OUT),
    "soften": (IN, ctypes.c_double, OUT, OUT),
    "is_positive_semidefinite": (ctypes.c_int, IN),
}


def compile_c(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Run a C compiler; fails the test with the compiler's words."""
    done = subprocess.run(
        [compiler, *map(str, arguments), "-o", str(output)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return output


class Matrices:
    """runtime/matrix.c as a shared library; in a robot's file its functions are static."""

    def __init__(self, folder: Path) -> None:
        suffix = ".dylib" if sys.platform == "darwin" else ".so"
        head = f"#include <float.h>\n#include <math.h>\n#include <string.h>\nenum {{ MAX_ROWS = {MAX_ROWS} }};\n"
        source = folder / "matrix.c"
        source.write_text(head + (RUNTIME / "matrix.c").read_text(encoding="utf-8"), encoding="utf-8")
        flags = ("-std=c99", "-O2", "-shared", "-fPIC", "-Dstatic=", "-D__STDC_WANT_IEC_60559_BFP_EXT__")
        self.library: Any = ctypes.CDLL(str(compile_c(folder / f"matrix{suffix}", *flags, source, "-lm")))
        for name, signature in SIGNATURES.items():
            getattr(self.library, name).argtypes = signature

    def eigen_symmetric(self, A: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(A)
        values, rows = np.empty(n), np.empty((n, n))
        return self.library.eigen_symmetric(n, A.copy(), values, rows), values, rows.T

    def pencil(self, K: np.ndarray, M: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors V, V^T M V = I."""
        n = len(K)
        L, C, values, rows, scale = np.zeros((n, n)), np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(1)
        code = self.library.pencil(n, K, M, L, C, values, rows, scale)
        V = np.linalg.solve(np.tril(L).T, rows.T) / np.sqrt(scale) if code == 0 else rows
        return code, values, V

    def soften(self, wanted: np.ndarray, share: float, K: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Whether K had a way to go, K after what is done at once, and the cost."""
        rest, cost = K.copy(), np.empty((3, 3))
        return self.library.soften(wanted, share, rest, cost), rest, cost

    def is_positive_semidefinite(self, A: np.ndarray) -> bool:
        return bool(self.library.is_positive_semidefinite(len(A), A))


def symmetric(random: np.random.Generator, values: np.ndarray) -> np.ndarray:
    n = len(values)
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = Q @ np.diag(values) @ Q.T
    return np.asarray((A + A.T) / 2)


def pencils(seed: int, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(K, M) of every size up to MAX_ROWS: plain, clustered, repeated, singular, indefinite and graded spectra."""
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
    """Largest |K v - lambda M v| over (|K| + |lambda| |M|) |v|, 2-norms."""
    scale = np.linalg.norm(K, 2) + np.abs(values) * np.linalg.norm(M, 2)
    difference = np.linalg.norm(K @ vectors - M @ vectors * values, axis=0)
    return float(np.max(difference / np.where(scale > 0, scale, 1) / np.linalg.norm(vectors, axis=0)))
