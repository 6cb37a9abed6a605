# SPDX-License-Identifier: MIT
"""Compare sine and cosine of floats in a generated NAME.c with those of doubles, float by float."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from support.project import require_compiler

LAST = 0x45BB8000
"""Bits of the largest angle that the code reduces itself, FAR."""
_SOURCE = r"""
#include "{name}_lanes.h"
/* Largest errors of sine and cosine, in 2^-24 and in ulp of the exact value, over floats by their bits, both signs. */
void worst(unsigned first, unsigned end, double *units, double *ulps, float *at)
{{
    for (unsigned bits = first; bits < end; bits += 8) {{
        float x[16];
        lanes angle[16 / LANES], found[2][16 / LANES];
        for (unsigned n = 0; n < 8; ++n) {{
            const unsigned one = bits + n < end ? bits + n : end - 1;
            memcpy(&x[n], &one, sizeof one);
            x[8 + n] = -x[n];
        }}
        memcpy(angle, x, sizeof x);
        sine_cosine(angle, found[0], found[1], 16 / LANES);
        for (int n = 0; n < 16; ++n) {{
            const double exact[2] = {{sin((double)x[n]), cos((double)x[n])}};
            for (int f = 0; f < 2; ++f) {{
                const double off = fabs((double)((const float *)found[f])[n] - exact[f]);
                int exponent;
                (void)frexp(exact[f], &exponent);
                const double ulp = ldexp(1.0, exponent < -125 ? -149 : exponent - 24);
                if (!(off <= units[f] * 0x1p-24)) {{
                    units[f] = off * 0x1p24;
                    at[f] = x[n];
                }}
                if (!(off <= ulps[f] * ulp)) {{
                    ulps[f] = off / ulp;
                }}
            }}
        }}
    }}
}}
"""


@dataclass(frozen=True)
class Worst:
    """Largest errors of sine and cosine, in units of 2^-24 and in ulp, and the angles of the errors in 2^-24."""

    units: tuple[float, float]
    ulps: tuple[float, float]
    at: tuple[float, float]


class Sines:
    """Sine and cosine of a folder of floats, compiled with the given flags."""

    def __init__(self, folder: Path, compiler: str, flags: Sequence[str], work: Path) -> None:
        """Compile the sine and cosine of a robot in floats into a library."""
        source, library = work / "sines.c", work / "sines.so"
        source.write_text(_SOURCE.format(name=folder.name))
        command = [
            require_compiler(compiler),
            *flags,
            "-std=gnu99",
            "-w",
            "-shared",
            "-fPIC",
            f"-I{folder}",
            str(source),
        ]
        subprocess.run([*command, "-o", str(library), "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))

    def worst(self, first: int, end: int) -> Worst:
        """Over the floats whose bits are ``first`` to ``end`` - 1, and their negatives; doubles are off by 2^-29."""
        units, ulps, at = (ctypes.c_double * 2)(), (ctypes.c_double * 2)(), (ctypes.c_float * 2)()
        self.library.worst(ctypes.c_uint(first), ctypes.c_uint(end), units, ulps, at)
        return Worst((units[0], units[1]), (ulps[0], ulps[1]), (at[0], at[1]))
