"""The robot-independent C of stiffgen, compiled for tests, and its functions on NumPy arrays."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.ctypeslib import ndpointer

from stiffgen.emit.controller import runtime_source

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
PARTS = ("stiffgen_error.h", "stiffgen_damping.h", "stiffgen_error.c", "stiffgen_damping.c")
PREFIX = "arm"
IN = ndpointer(np.float64, flags="C_CONTIGUOUS")
OUT = ndpointer(np.float64, flags=("C_CONTIGUOUS", "WRITEABLE"))

SIGNATURES = {
    "eigen_symmetric": (ctypes.c_int, IN, OUT, OUT, OUT),
    "eigen_generalised": (ctypes.c_int, IN, IN, OUT, OUT, OUT),
    "damping_modal": (ctypes.c_int, IN, IN, IN, OUT, OUT, OUT),
    "damping_factorised": (ctypes.c_int, IN, IN, IN, OUT, OUT),
    "damping_task": (ctypes.c_int, IN, IN, ctypes.c_double, OUT),
    "positive_part": (ctypes.c_int, IN, ctypes.c_void_p, OUT, OUT, OUT),
    "nullspace_stiffness": (ctypes.c_int, IN, IN, ctypes.c_double, ctypes.c_double, OUT, OUT, OUT),
    "is_positive_semidefinite6": (IN,),
}


def compile_c(output: Path, *arguments: str | Path, compiler: str = "cc") -> Path:
    """Run a C compiler; fails the test with the compiler's words."""
    done = subprocess.run(
        [compiler, *map(str, arguments), "-o", str(output)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return output


def write_source(folder: Path) -> Path:
    """The controller's linear algebra as a C file of its own, for a robot named PREFIX."""
    source = folder / "runtime.c"
    source.write_text(runtime_source(PARTS, PREFIX) + "\n", encoding="utf-8")
    return source


class Runtime:
    """The linear algebra of the controller as a shared library; in a robot's folder its functions are static."""

    def __init__(self, folder: Path) -> None:
        suffix = ".dylib" if sys.platform == "darwin" else ".so"
        source = write_source(folder)
        flags = ("-std=c99", "-O2", "-shared", "-fPIC", "-Dstatic=")
        path = compile_c(folder / f"runtime{suffix}", *flags, source, "-lm")
        self.library = ctypes.CDLL(str(path))
        self.function("impedance_error_text").restype = ctypes.c_char_p
        for name, signature in SIGNATURES.items():
            self.function(name).argtypes = signature

    def function(self, name: str) -> Any:
        return getattr(self.library, f"{PREFIX}_{name}")

    def call(self, name: str, *arguments: object) -> int:
        return int(self.function(name)(*arguments))

    def text(self, code: int) -> str:
        return str(self.function("impedance_error_text")(code).decode())

    def eigen_symmetric(self, A: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(A)
        values, vectors = np.empty(n), np.empty((n, n))
        code = self.call("eigen_symmetric", n, A, values, vectors, np.empty(4 * n * n))
        return code, values, vectors

    def eigen_generalised(self, K: np.ndarray, M: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(K)
        values, vectors = np.empty(n), np.empty((n, n))
        code = self.call("eigen_generalised", n, K, M, values, vectors, np.empty(4 * n * n))
        return code, values, vectors

    def damping_modal(self, K: np.ndarray, M: np.ndarray, ratio: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(K)
        damping, values = np.empty((n, n)), np.empty(n)
        code = self.call("damping_modal", n, K, M, ratio, damping, values, np.empty(4 * n * n))
        return code, damping, values

    def damping_factorised(self, K: np.ndarray, M: np.ndarray, ratio: np.ndarray) -> tuple[int, np.ndarray]:
        n = len(K)
        damping = np.empty((n, n))
        return self.call("damping_factorised", n, K, M, ratio, damping, np.empty(4 * n * n)), damping

    def damping_task(self, J: np.ndarray, B: np.ndarray, d: float) -> tuple[int, np.ndarray]:
        damping = np.empty((J.shape[1], J.shape[1]))
        return self.call("damping_task", J.shape[1], J, B, d, damping), damping

    def positive_part(self, A: np.ndarray, metric: np.ndarray | None = None) -> tuple[int, np.ndarray, np.ndarray]:
        n = len(A)
        result, values = np.empty((n, n)), np.empty(n)
        pointer = None if metric is None else metric.ctypes.data
        return self.call("positive_part", n, A, pointer, result, values, np.empty(4 * n * n)), result, values

    def nullspace_stiffness(
        self, J: np.ndarray, M: np.ndarray, k: float, threshold: float
    ) -> tuple[int, np.ndarray, float]:
        n = J.shape[1]
        stiffness, smallest = np.empty((n, n)), np.empty(1)
        code = self.call("nullspace_stiffness", n, J, M, k, threshold, stiffness, smallest, np.empty(4 * n * n))
        return code, stiffness, float(smallest[0])


def symmetric(random: np.random.Generator, values: np.ndarray) -> np.ndarray:
    n = len(values)
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = Q @ np.diag(values) @ Q.T
    return np.asarray((A + A.T) / 2)


def pencils(seed: int, count: int):
    """(K, M) of every size up to 32: plain, clustered, repeated, singular, indefinite and graded spectra."""
    random = np.random.default_rng(seed)
    for index in range(count):
        n = int(random.integers(1, 33))
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
