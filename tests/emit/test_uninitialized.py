# SPDX-License-Identifier: MIT
"""No result depends on memory that nothing has written: random robots under clang's memory sanitizer."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from support.project import require_compiler
from support.warnings import sources_of_varied_robot

WIDTHS = {"native": ("-march=native",), "no vectors": ("-DSTIFFGEN_NO_VECTORS",)}
COUNT = 3
"""Configurations of a batch."""
MAIN = """
#include <sanitizer/msan_interface.h>
#include <stdlib.h>
#include "arm.h"

static double *given(size_t size)
{
    double *const values = malloc(size * sizeof *values);
    for (size_t k = 0; k < size; ++k) {
        values[k] = 0.1 + 0.37 * (double)(k % 5);
    }
    return values;
}

static double *taken(size_t size) { return malloc(size * sizeof(double)); } /* as the sanitizer sees it: not written */

static void look(const double *values, size_t size)
{
    __msan_check_mem_is_initialized(values, size * sizeof *values);
}
"""


def program(header: str) -> str:
    """Calls of every function of a header and of its batch, whose results are then looked at."""
    body = []
    for name, parameters in re.findall(r"^void (arm_\w+)\(([^;]*?)\);", header, re.M | re.S):
        parts = [re.fullmatch(r"(const )?double (\w+)\[(\d+)\]", part.strip()) for part in parameters.split(",")]
        if not all(parts):
            continue  # a batch: called with the function it belongs to
        arrays = [(bool(part[1]), part[2], int(part[3])) for part in parts if part]
        for count, suffix in ((1, ""), (COUNT, "_batch")):
            if suffix and f"{name}_batch(" not in header:
                continue
            lines = [f"double *const {a} = {'given' if const else 'taken'}({count} * {n});" for const, a, n in arrays]
            steps = [f"{a}, {n}" if const and suffix else a for const, a, n in arrays]
            lines.append(f"{name}{suffix}({', '.join([*([str(count)] if suffix else []), *steps])});")
            lines += [f"look({a}, {count} * {n});" for const, a, n in arrays if not const]
            lines += [f"free({a});" for _, a, _ in arrays]
            body += ["    {", *(f"        {line}" for line in lines), "    }"]
    assert body
    return "\n".join([MAIN, "int main(void)", "{", *body, "    return 0;", "}", ""])


def check(seed: int, width: str, folder: Path) -> None:
    clang = require_compiler("clang")
    _, (source, *_) = sources_of_varied_robot(seed, 4, folder)
    (folder / "main.c").write_text(program((folder / "arm.h").read_text()))
    flags = ["-std=c99", "-O1", "-w", "-fsanitize=memory", "-fno-sanitize-recover=all", *WIDTHS[width]]
    command = [clang, *flags, str(source), str(folder / "main.c"), "-o", str(folder / "program"), "-lm"]
    subprocess.run(command, check=True)
    done = subprocess.run([str(folder / "program")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_joint_without_a_force_that_shares_its_coordinate(tmp_path: Path) -> None:
    """Its force, which is always zero, is summed with its partner's."""
    check(11, "no vectors", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("seed", [9, 11, 13, 16, 23])
def test_random_robots(seed: int, width: str, tmp_path: Path) -> None:
    """Of every kind, two of them with such a joint."""
    check(seed, width, tmp_path)
