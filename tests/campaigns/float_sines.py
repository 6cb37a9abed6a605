# SPDX-License-Identifier: MIT
"""Every float up to FAR through the generated sine and cosine: ``python tests/campaigns/float_sines.py``.

The iiwa 14 is generated with ``--scalar float`` and its sine and cosine compiled for several widths of vectors, with
and without fused multiply-add; each of the 2.34e9 floats is held against sine and cosine of doubles, which are off by
2^-29 of what is measured. The largest errors are printed, in units of 2^-24 and in ulp; exit code 1 if one is beyond
the two units on which the bounds of rounding rest (families/rounding) or the ulps that templates/sine_cosine.c names.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import stiffgen
from stiffgen.core.lower.scalar import FLOAT
from support.float_sines import LAST, Sines, Worst
from support.project import URDF
from support.quad import can_run

UNITS, ULPS = FLOAT.sine_error * 2.0**24, 1.1
BUILDS = {
    "gcc, native": ("gcc", ["-O3", "-march=native"]),
    "clang, native": ("clang", ["-O3", "-march=native"]),
    "gcc, AVX2 and FMA": ("gcc", ["-O3", "-mavx2", "-mfma"]),
    "gcc, SSE2": ("gcc", ["-O3"]),
    "clang, SSE2": ("clang", ["-O3"]),
}
_PART = 1 << 24


def largest(parts: list[Worst]) -> Worst:
    """Return the largest errors of sine and cosine over all parts."""
    units, ulps, at = [], [], []
    for function in range(2):
        worst = max(parts, key=lambda part: part.units[function])
        units.append(worst.units[function])
        at.append(worst.at[function])
        ulps.append(max(part.ulps[function] for part in parts))
    return Worst((units[0], units[1]), (ulps[0], ulps[1]), (at[0], at[1]))


def main() -> int:
    """Compare sine and cosine of floats with exact ones, for each float of the range; return 1 beyond the bounds."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--builds", nargs="*", choices=list(BUILDS), default=list(BUILDS))
    parser.add_argument("--every", type=int, default=1, help="part of 2^24 floats, every so many (default: all)")
    options = parser.parse_args()
    within = True
    with tempfile.TemporaryDirectory() as place:
        folder = stiffgen.generate(URDF, output=place, name="arm", scalar="float", build=False)
        for number, build in enumerate(options.builds):
            compiler, flags = BUILDS[build]
            if not can_run(flags):
                print(f"{build}: this machine cannot run it")
                continue
            work = Path(place) / str(number)
            work.mkdir()
            sines = Sines(folder, compiler, flags, work)
            starts = range(0, LAST + 1, _PART * options.every)
            ends = [min(first + _PART, LAST + 1) for first in starts]
            with ThreadPoolExecutor() as pool:  # ctypes lets go of the interpreter's lock
                parts = list(pool.map(sines.worst, starts, ends))
            worst = largest(parts)
            within &= max(worst.units) <= UNITS and max(worst.ulps) <= ULPS
            for name, units, ulps, at in zip(("sine", "cosine"), worst.units, worst.ulps, worst.at, strict=True):
                print(f"{build}: {name} {units:.4f} units of 2^-24 (at {at:.9g}), {ulps:.4f} ulp", flush=True)
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
