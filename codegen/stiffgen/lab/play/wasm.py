# SPDX-License-Identifier: MIT
"""Kernels of a generated folder as WebAssembly: the unchanged C, compiled by clang and linked by lld."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from stiffgen.core.errors import BuildError
from stiffgen.core.folder import temporary_folder
from stiffgen.core.lower.graph import LIBM, LIBM_OF_TWO

_FLAGS = (
    "--target=wasm32", "-O2", "-msimd128", "-mbulk-memory", "-std=gnu99", "-DNDEBUG", "-ffunction-sections",
    "-fvisibility=hidden", "-nostdlib",
)  # fmt: skip
_LINK = ("--no-entry", "--strip-all", "--gc-sections", "-z", "stack-size=1048576", "--export=__heap_base")
_LAST_LINES = 10

_MATH = ("sin", "cos", *LIBM)
"""Functions of one number that the module may import; fabs, sqrt and copies in memory are instructions."""

_HEADERS = {
    "math.h": "#define INFINITY __builtin_inf()\n"
    + "".join(f"double {name}(double);\n" for name in _MATH)
    + "".join(f"double {name}(double, double);\n" for name in LIBM_OF_TWO),
    "string.h": "#include <stddef.h>\nvoid *memcpy(void *, const void *, size_t);\nvoid *memset(void *, int, size_t);\n"
    "void *memmove(void *, const void *, size_t);\n",
}
"""Headers of the C library that the generated C includes; the page supplies the mathematics."""


def compile_wasm(source: Path, functions: Sequence[str]) -> bytes:
    """Compile a generated C file for WebAssembly.

    Args:
        source: NAME.c, its header beside it.
        functions: C names of the functions that the module exports.

    Returns:
        The module. It exports ``memory``, ``__heap_base`` and the functions, and imports at most functions of libm,
        from "env".

    Raises:
        BuildError: clang or its linker for WebAssembly is missing, or one of them failed.

    """
    compiler = shutil.which("clang")
    missing = [name for name, found in (("clang", compiler), ("wasm-ld", shutil.which("wasm-ld"))) if not found]
    if missing or compiler is None:
        raise BuildError(
            f"{' and '.join(missing)} not found, which make WebAssembly of the robot's C; install LLVM's compiler and "
            "linker (Debian: apt-get install clang lld)"
        )
    with temporary_folder("play") as build:
        for header, text in _HEADERS.items():
            (build / header).write_text(text)
        imported = build / "imported"
        imported.write_text("\n".join((*_MATH, *LIBM_OF_TWO)))
        made = build / "kernels.wasm"
        exports = [f"--export={function}" for function in functions]
        command = [compiler, *_FLAGS, "-isystem", str(build), str(source.resolve())]
        for option in (*_LINK, f"--allow-undefined-file={imported}", *exports):
            command += ["-Xlinker", option]
        command += ["-o", str(made)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        except OSError as error:
            raise BuildError(f"{compiler}: cannot be started ({error.strerror})") from error
        if done.returncode != 0 or not made.exists():
            lines = "\n".join((done.stderr or done.stdout).strip().splitlines()[-_LAST_LINES:])
            raise BuildError(
                f"{compiler} could not make WebAssembly of {source.name}; it needs LLVM's clang with the target wasm32 "
                f"(Debian: apt-get install clang lld; macOS: brew install llvm lld). It said:\n{lines}"
            )
        return made.read_bytes()
