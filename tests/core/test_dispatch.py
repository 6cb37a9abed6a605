# SPDX-License-Identifier: MIT
"""NAME_dispatch.c calls the functions of the processor's width, and CMake's library has the bits of each width."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import stiffgen
from support.project import URDF

SINGLE, BATCH = ["128", "256", "256"], ["128", "256", "512"]
FLAGS = {"128": ["-msse2"], "256": ["-mavx2", "-mfma"], "512": ["-mavx512f", "-mavx512dq", "-mavx512vl", "-mavx512bw"]}
CPU = Path("/proc/cpuinfo").read_text() if platform.system() == "Linux" else " avx2 "
HOST = 0 if " avx2 " not in CPU else 2 if all(f" avx512{each} " in CPU for each in ("f", "dq", "vl", "bw")) else 1
"""Row of the tables for this machine: SSE2, AVX2, AVX-512."""
COMPILERS = ["gcc", "clang"] if platform.machine() == "x86_64" else []
EMULATED = [(["qemu-x86_64", "-cpu", "Nehalem"], 0), (["qemu-x86_64", "-cpu", "Haswell"], 1)]
RUNS = [([], "", HOST), ([], "128", 0), ([], "256", min(HOST, 1)), ([], "nonsense", HOST)]
RUNS += [(command, "", row) for command, row in EMULATED if shutil.which(command[0])]

VALUES = """
#include <stdio.h>
#include "iiwa14.h"
int main(void)
{
    double q[7 * 19], wrench[6] = {3, -5, 7, 1, 2, -1}, stiffness[36] = {0}, one[49], all[49 * 19];
    for (int k = 0; k < 7 * 19; ++k) { q[k] = k / 32.0 - 2; }
    for (int k = 0; k < 6; ++k) { stiffness[7 * k] = 500 + 10 * k; }
    for (int c = 0; c < 19; ++c) {
        iiwa14_hybrid_joint_stiffness(q + 7 * c, wrench, stiffness, one);
        for (int k = 0; k < 49; ++k) { printf("%a\\n", one[k]); }
    }
    iiwa14_hybrid_joint_stiffness_batch(19, q, 7, wrench, 0, stiffness, 0, all);
    for (int k = 0; k < 49 * 19; ++k) { printf("%a\\n", all[k]); }
    return 0;
}
"""


def run(*command: str | Path, width: str = "") -> str:
    environment = {"PATH": "/usr/bin:/bin:/usr/local/bin", **({"STIFFGEN_WIDTH": width} if width else {})}
    done = subprocess.run([str(part) for part in command], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_function_calls_its_width(robot_folder: Path, tmp_path: Path, compiler: str) -> None:
    """Replace the functions of each width by one that prints its own name, and call every public function."""
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{robot_folder}"]
    made = tmp_path / "dispatch.o"
    run(compiler, *strict, "-DIIWA14_DISPATCH", "-c", robot_folder / "iiwa14_dispatch.c", "-o", made)
    symbols = [line.split()[-2:] for line in run("nm", made).splitlines()]
    inner = sorted(name for kind, name in symbols if kind == "U" and re.search(r"_(128|256|512)$", name))
    public = sorted(name for kind, name in symbols if kind == "T")
    header = (robot_folder / "iiwa14.h").read_text()
    assert public == sorted(set(re.findall(r"^(?:void|int) (iiwa14_\w+)\(", header, re.MULTILINE)))
    lines = ["int puts(const char *);", *(f'void {name}(void) {{ puts("{name}"); }}' for name in inner)]
    lines += [f"void {name}();" for name in public]
    calls = [f"((void (*)(void *, void *)){name})(0, 0);" for name in public]
    (tmp_path / "main.c").write_text("\n".join([*lines, "int main(void) {", *calls, "return 0; }"]))
    run(compiler, "-w", tmp_path / "main.c", made, "-o", tmp_path / "main")
    for command, width, row in RUNS:
        said = run(*command, tmp_path / "main", width=width).split()
        assert said == [f"{name}_{(BATCH if '_batch' in name else SINGLE)[row]}" for name in public], (command, width)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS[:1])
def test_library_has_the_bits_of_each_width(tmp_path: Path, compiler: str) -> None:
    """Compare the library with builds for one width each: the dispatcher must run exactly the width it says."""
    folder = stiffgen.generate(URDF, output=tmp_path, build=False, controller=False, kernels="hybrid.joint_stiffness")
    (tmp_path / "main.c").write_text(VALUES)
    build, sources = tmp_path / "build", [folder / "iiwa14.c", folder / "iiwa14_batch.c"]
    flags = [f"-DCMAKE_C_COMPILER={compiler}", "-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_C_FLAGS_DEBUG=-O2"]
    run("cmake", "-S", folder, "-B", build, *flags)
    run("cmake", "--build", build)
    compiled = [compiler, "-std=gnu99", "-O2", "-fPIC", f"-I{folder}", tmp_path / "main.c"]
    run(*compiled, build / "libiiwa14.a", "-lm", "-o", tmp_path / "chosen")
    bits = {}
    for width in BATCH[: HOST + 1]:
        run(*compiled, *sources, *FLAGS[width], "-lm", "-o", tmp_path / f"only_{width}")
        bits[width] = run(tmp_path / f"only_{width}").splitlines()
    for row, width in enumerate(BATCH[: HOST + 1]):
        single, half = bits[SINGLE[row]], len(bits[width]) // 2
        assert run(tmp_path / "chosen", width=width).splitlines() == single[:half] + bits[width][half:]
    if HOST:
        assert bits["128"] != bits["256"]
    run("cmake", "-S", folder, "-B", build, "-DIIWA14_NATIVE=ON")
    assert "iiwa14_512" not in run("cmake", "--build", build, "--target", "help")
