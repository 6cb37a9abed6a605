# SPDX-License-Identifier: MIT
"""Comparisons and choices in lanes against those of numbers, which are C's operators, on every width of vectors."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

import stiffgen
from stiffgen.core import rendering
from stiffgen.core.lower.graph import LIBM, LIBM_OF_TWO, OWN
from stiffgen.core.lower.scalar import DOUBLE, FLOAT
from stiffgen.core.lower.variant import SINGLE
from support.project import require_compiler

ONE_NUMBER = ("sign", "negation")
MAIN = """
int main(void)
{
    static const double given[] = {0.0, -0.0, 1.0, -1.0, 2.5, -2.5, 5e-324, 1.7e308, INFINITY, -INFINITY, NAN};
    enum { COUNT = sizeof given / sizeof given[0] };
    int wrong = 0;
    for (int i = 0; i < COUNT * COUNT; ++i) {
        lanes a, b;
        for (int n = 0; n < LANES; ++n) {
            ((double *)&a)[n] = given[(i + n) % COUNT];
            ((double *)&b)[n] = given[(i / COUNT + 3 * n) % COUNT];
        }
        COMPARED
    }
    return wrong != 0;
}
"""
COMPARED = """
        {
            const lanes found = NAME_lanes(LANES_GIVEN);
            for (int n = 0; n < LANES; ++n) {
                const double x = ((const double *)&a)[n], y = ((const double *)&b)[n];
                const double expected = NAME(NUMBERS), got = ((const double *)&found)[n];
                (void)y;
                wrong += !(got == expected || (isnan(got) && isnan(expected)));
            }
        }
"""


@pytest.mark.parametrize("scalar", [DOUBLE, FLOAT], ids=lambda scalar: scalar.name)
@pytest.mark.parametrize("flags", ["-march=native", "-mavx2", "-msse2", "-DSTIFFGEN_NO_VECTORS"])
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.slow)])
def test_lanes_choose_as_numbers_do(compiler, flags, scalar, tmp_path):
    """Compile the templates of comparisons and choices: lanes must give the bits of single numbers."""
    require_compiler(compiler)
    calls = {*OWN, *(f"{name}_lanes" for name in OWN), "masked"}
    # The program: the templates' functions, and same(x), a vector with x in each lane.
    text = '{% from "choices.c.j2" import choices with context %}{% include "lanes.c" %}'
    text += "static inline lanes same(double x)\n{\n    lanes all;\n    for (int n = 0; n < LANES; ++n) {\n"
    text += "        ((double *)&all)[n] = x;\n    }\n    return all;\n}\n{{ choices(variant, calls) }}"
    compared = ""
    for name in OWN:
        one = name in ONE_NUMBER
        piece = COMPARED.replace("LANES_GIVEN", "a" if one else "a, b").replace("NUMBERS", "x" if one else "x, y")
        compared += piece.replace("NAME", name)
    source = (
        rendering.environment([Path(stiffgen.__file__).parent / "core" / "emit" / "c" / "templates"])
        .from_string(text)
        .render(
            variant=replace(SINGLE, scalar=scalar),
            scalar=scalar,
            calls=calls,
            batches=False,
            libm=LIBM,
            libm_of_two=LIBM_OF_TWO,
            own=OWN,
        )
    )
    file = tmp_path / "choices.c"
    includes = "#include <math.h>\n#define EXCESS_PRECISION 0\n"
    text = source + MAIN.replace("COMPARED", compared)
    if scalar is FLOAT:
        # Least and largest numbers of single precision in place of those of double.
        text = text.replace("double", "float").replace("5e-324", "1e-45f").replace("1.7e308", "3e38f")
        text = text.replace("2.5", "2.5f")
    file.write_text(includes + text)
    program = tmp_path / "choices"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wno-unused-function", "-Werror"]
    subprocess.run([compiler, "-O2", *strict, flags, str(file), "-o", str(program), "-lm"], check=True)
    assert subprocess.run([str(program)], check=False).returncode == 0
