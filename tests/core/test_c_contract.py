# SPDX-License-Identifier: MIT
"""The contract of the generated C: warnings, symbols, threads, bitwise symmetry, and use from other builds."""

from __future__ import annotations

import os
import subprocess

import pytest

import stiffgen
from stiffgen.control.companions import COMPANIONS
from stiffgen.core.symbolic.kernels import KERNELS
from stiffgen.core.verify.kernels.samples import Samples
from support.c_program import STRICT, run_kernels
from support.chains import chain_urdf
from support.project import ROOT, compilers, require_compiler

COMPANION_HEADERS, COMPANION_SOURCES = ([f"_{name}.{ending}" for name in COMPANIONS] for ending in ("h", "c"))
# libm, and what compilers insert for copies and runs of zeros.
ALLOWED = {"sin", "cos", "sincos", "sqrt", "fmax", "memcpy", "memset", "memmove"}


MARKS = {
    ("gcc", "c99", "-O2"): (), ("gcc", "c++11", "-O0"): (), ("clang", "c++11", "-O0"): (),
    ("clang", "c99", "-O2"): pytest.mark.slow, ("gcc", "c++20", "-O0"): pytest.mark.slow,
}  # fmt: skip
"""Cases that are not wide: a level and the languages that users build with."""


@pytest.mark.parametrize(
    ("compiler", "language", "optimisation"),
    [
        pytest.param(*case, marks=MARKS.get(case, pytest.mark.wide))
        for compiler in compilers()
        for case in (
            *((compiler, "c99", level) for level in ("-O0", "-O2", "-O3")),  # warnings of the optimiser
            *((compiler, language, "-O0") for language in ("c11", "c++11", "c++20")),  # warnings of the language
        )
    ],
)
def test_compiles_without_a_warning(compiler, language, optimisation, compiled):
    """Compile with strict warnings as errors, for each compiler, language and optimisation."""
    assert compiled(compiler, language, optimisation).exists()


@pytest.mark.slow
@pytest.mark.parametrize("compiler", [pytest.param("gcc", marks=pytest.mark.wide), "clang"])
def test_other_chains_compile_without_a_warning(compiler, tmp_path):
    """Sliding and mimic joints. (gcc meets random robots at every level: test_warnings.py.)"""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(chain_urdf("rprmrr"))
    folder = stiffgen.generate(urdf, output=tmp_path, name="arm", build=False, controller=False)
    command = [require_compiler(compiler), "-std=c99", "-O1", *STRICT]
    subprocess.run([*command, "-c", str(folder / "arm.c"), "-o", str(tmp_path / "o")], check=True)


@pytest.mark.parametrize(
    "standard",
    [
        "-std=c89",
        "-std=iso9899:199409",
        *(pytest.param(each, marks=pytest.mark.wide) for each in ("-ansi", "-std=gnu89")),
    ],
)
@pytest.mark.parametrize("compiler", compilers())
@pytest.mark.parametrize("file", [".h", "_impedance.h", ".c", "_batch.c", "_impedance.c", *COMPANION_HEADERS])
def test_c89_is_refused_by_a_sentence(file, compiler, standard, robot_folder):
    """Compile as C89: the first error names the remedy."""
    command = [compiler, standard, "-fsyntax-only", "-x", "c", robot_folder / f"iiwa14{file}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    errors = [line for line in done.stderr.splitlines() if "error:" in line]
    assert "iiwa14 needs C99 or later: compile with -std=c99, c11 or c17" in errors[0]


PLATFORM = ROOT / "tests" / "support" / "platform_macros.h"
FIRST = {
    "c": ("float.h", "limits.h", "math.h", "stddef.h", "stdint.h", "stdio.h", "stdlib.h", "string.h"),
    "c++": ("algorithm", "array", "cmath", "cstddef", "limits", "string", "type_traits", "utility", "vector"),
}
"""Headers of the system, which some of the macros would break."""


@pytest.mark.parametrize(
    ("files", "language"),
    [
        *(((end,), "c") for end in (".c", "_batch.c", "_impedance.c", "_dispatch.c", *COMPANION_SOURCES)),
        ((".h", "_impedance.h", *COMPANION_HEADERS), "c"),
        ((".h", "_impedance.h", ".hpp", *COMPANION_HEADERS), "c++"),
    ],
)
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.wide)])
def test_macros_of_platforms_do_no_harm(compiler, files, language, robot_folder, tmp_path):
    """Compile beside the macros of Arduino, Windows, Apple, GNU, X11, Qt and termios, such as check, near, N and I."""
    lines = [*(f"#include <{each}>" for each in FIRST[language]), f'#include "{PLATFORM}"']
    lines += [*(f'#include "iiwa14{end}"' for end in files), ""]
    source = tmp_path / ("a.c" if language == "c" else "a.cpp")
    source.write_text("\n".join(lines))
    standard = "-std=gnu99" if language == "c" else "-std=gnu++17"
    program = compiler if language == "c" else {"gcc": "g++", "clang": "clang++"}[compiler]
    command = [program, standard, "-O0", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", f"-I{robot_folder}", source]
    subprocess.run(command, check=True)


def test_compiles_alone(robot_folder, tmp_path):
    """The README's line, in a folder with nothing but the file and its headers."""
    for file in ("iiwa14.c", "iiwa14.h", "iiwa14_lanes.h"):
        (tmp_path / file).write_bytes((robot_folder / file).read_bytes())
    subprocess.run(["cc", "-std=c99", "-c", "iiwa14.c"], check=True, cwd=tmp_path)
    assert (tmp_path / "iiwa14.o").exists()


@pytest.mark.parametrize(
    ("compiler", "optimisation"),
    [
        pytest.param(compiler, level, marks=MARKS.get((compiler, "c99", level), pytest.mark.wide))
        for compiler in compilers()
        for level in ("-O0", "-O2", "-O3")
    ],
)
def test_symbols(compiler, optimisation, compiled):
    """List the symbols: only libm is called, only the header's names exported, no data can be written to."""
    nm = ["nm", str(compiled(compiler, "c99", optimisation))]
    lines = subprocess.run(nm, check=True, capture_output=True, text=True).stdout.split("\n")
    symbols = [line.split()[-2:] for line in lines if line]
    assert {name for kind, name in symbols if kind == "U"} <= ALLOWED
    assert not [name for kind, name in symbols if kind in "bBC"]
    exported = {name for kind, name in symbols if kind.isupper() and kind != "U"}
    functions = {f"iiwa14_{kernel.qualified_name}" for kernel in KERNELS}
    functions |= {f"iiwa14_{kernel.qualified_name}{batch.suffix}" for kernel in KERNELS for batch in kernel.batches}
    tables = {f"iiwa14_{c}" for c in ("joints", "lower", "upper", "velocity", "effort")}
    assert exported == functions | tables | {"iiwa14_self_check", "iiwa14_batch_self_check"}


THREADS = r"""
#include "iiwa14.h"
#include <pthread.h>
#include <stdio.h>
#include <string.h>

enum { THREADS = 8, CALLS = 2000 };

static double q[THREADS][7], wrench[THREADS][6], stiffness[36], expected[THREADS][49];
static int wrong[THREADS];

static void *work(void *argument)
{
    const int t = *(const int *)argument;
    for (int c = 0; c < CALLS; ++c) {
        double found[49];
        iiwa14_hybrid_joint_stiffness(q[t], wrench[t], stiffness, found);
        wrong[t] += memcmp(found, expected[t], sizeof found) != 0;
    }
    return NULL;
}

int main(void)
{
    pthread_t threads[THREADS];
    int number[THREADS], total = 0;
    for (int k = 0; k < 6; ++k) { stiffness[7 * k] = 100.0 * (k + 1); }
    for (int t = 0; t < THREADS; ++t) {
        number[t] = t;
        for (int k = 0; k < 7; ++k) { q[t][k] = 0.1 * (t + 1) * (k - 3); }
        for (int k = 0; k < 6; ++k) { wrench[t][k] = t - k; }
        iiwa14_hybrid_joint_stiffness(q[t], wrench[t], stiffness, expected[t]);
    }
    for (int t = 0; t < THREADS; ++t) { pthread_create(&threads[t], NULL, work, &number[t]); }
    for (int t = 0; t < THREADS; ++t) { pthread_join(threads[t], NULL); total += wrong[t]; }
    printf("%d\n", total);
    return 0;
}
"""


@pytest.mark.parametrize(
    "flags",
    [pytest.param([], id="plain"), pytest.param(["-fsanitize=thread"], id="thread-sanitizer", marks=pytest.mark.slow)],
)
def test_eight_threads(flags, robot_folder, tmp_path):
    """Call the functions from eight threads: equal results, and no data race for the thread sanitizer."""
    main = tmp_path / "main.c"
    main.write_text(THREADS)
    program = tmp_path / "program"
    sources = [str(main), str(robot_folder / "iiwa14.c")]
    command = ["gcc", "-std=c99", "-O1", "-pthread", *flags, f"-I{robot_folder}", *sources, "-o", str(program), "-lm"]
    subprocess.run(command, check=True)
    # setarch -R: the sanitizer cannot place its shadow memory under some kernels' address randomisation.
    run = ["setarch", os.uname().machine, "-R", str(program)] if flags else [str(program)]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "0"), done.stderr


@pytest.mark.parametrize("level", ["-O0", pytest.param("-O1", marks=pytest.mark.wide)])
def test_no_undefined_behaviour(level, golden, chain, robot_folder, tmp_path):
    """Address and undefined-behaviour sanitizers over every kernel."""
    sample = golden[0]
    drawn = Samples(chain, 1, seed=0)
    pool = {argument.name: drawn[argument][0] for kernel in KERNELS for argument in kernel.arguments}
    pool |= {"q": sample.q, "wrench": sample.wrench, "task_stiffness": sample.task_stiffness}
    sizes = {k.qualified_name: [result.array(chain).size for result in k.results] for k in KERNELS}
    calls = [(k.qualified_name, [pool[a.name] for a in k.arguments], sizes[k.qualified_name]) for k in KERNELS]
    flags = [level, "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    assert len(run_kernels(robot_folder, "iiwa14", calls, "gcc", "c99", flags, tmp_path)) == len(KERNELS)


CONSUMER = {
    "CMakeLists.txt": """
cmake_minimum_required(VERSION 3.18)
project(consumer LANGUAGES C)
find_package(iiwa14 REQUIRED)
add_executable(consumer main.c)
target_link_libraries(consumer PRIVATE iiwa14::iiwa14)
""",
    "main.c": """
#include <iiwa14.h>
#include <stdio.h>
int main(void)
{
    const double q[IIWA14_DOF] = {0};
    double pose[16];
    iiwa14_forward_kinematics(q, pose);
    printf("%s %.4f %.0f", iiwa14_joints[6], pose[11], iiwa14_effort[0]);
    return 0;
}
""",
}


@pytest.mark.slow
def test_cmake_package(robot_folder, tmp_path):
    """Install the package, find it with find_package, link to it, and run the program."""

    def cmake(*arguments):
        subprocess.run(["cmake", *map(str, arguments)], check=True, cwd=tmp_path, capture_output=True)

    prefix = tmp_path / "prefix"
    cmake("-S", robot_folder, "-B", "build", "-DCMAKE_BUILD_TYPE=Debug", f"-DCMAKE_INSTALL_PREFIX={prefix}")
    cmake("--build", "build")
    cmake("--install", "build")
    consumer = tmp_path / "consumer"
    consumer.mkdir()
    for file, text in CONSUMER.items():
        (consumer / file).write_text(text)
    cmake("-S", consumer, "-B", "out", f"-DCMAKE_PREFIX_PATH={prefix}")
    cmake("--build", "out")
    done = subprocess.run([str(tmp_path / "out" / "consumer")], capture_output=True, text=True, check=True)
    assert done.stdout == "A7 1.3060 320"
