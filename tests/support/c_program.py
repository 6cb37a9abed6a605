# SPDX-License-Identifier: MIT
"""Compile a generated robot with a small main, and read back its kernels' results bit by bit."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Wcast-qual", "-Werror"]


def language_flags(language: str) -> list[str]:
    """Return flags that make a C or C++ compiler take the .c file in the given language."""
    return ["-x", "c++", f"-std={language}"] if language.startswith("c++") else ["-x", "c", f"-std={language}"]


def run_kernels(
    folder: Path,
    name: str,
    calls: Sequence[tuple[str, Sequence[np.ndarray], int | Sequence[int]]],
    compiler: str,
    language: str,
    flags: Sequence[str],
    work: Path,
    compiled: Path | None = None,
) -> list[np.ndarray]:
    """Call kernels (name, arguments, size of the result or of each) from a C program and return their flat results.

    The program ends with the robot's self-check, which must pass. ``compiled``: the robot's object file, if there is
    one.
    """
    body = []
    for index, (kernel, arguments, size) in enumerate(calls):
        names = []
        for k, argument in enumerate(arguments):
            values = ", ".join(_literal(v) for v in np.asarray(argument, dtype=float).ravel())
            body.append(f"    static const double a{index}_{k}[] = {{{values}}};")
            names.append(f"a{index}_{k}")
        sizes = [size] if isinstance(size, int) else list(size)
        results = [f"&result[{sum(sizes[:k])}]" for k in range(len(sizes))]
        body.append(f"    {name}_{kernel}({', '.join([*names, *results])});")
        body.append(f"    show(result, {sum(sizes)});")
    source = "\n".join(
        [
            f'#include "{name}.h"',
            "#include <math.h>",
            "#include <stdio.h>",
            "static double result[4096];",
            "static void show(const double *x, int n)",
            '{ for (int k = 0; k < n; ++k) { printf("%a ", x[k]); } printf("\\n"); }',
            "int main(void)",
            "{",
            *body,
            f"    return {name}_self_check();",
            "}",
            "",
        ]
    )
    main = work / "main.c"
    main.write_text(source)
    program = work / "program"
    command = [compiler, *language_flags(language), *flags, f"-I{folder}", str(main)]
    command += [str(folder / f"{name}.c")] if compiled is None else ["-x", "none", str(compiled)]
    subprocess.run([*command, "-o", str(program), "-lm"], check=True, cwd=work)
    output = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    return [np.array([float.fromhex(word) for word in line.split()]) for line in output.splitlines()]


def _literal(value: float) -> str:
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))
