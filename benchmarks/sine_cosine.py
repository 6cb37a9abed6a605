"""Where the coefficients of the generated sine and cosine come from, and how exact the code is.

``python benchmarks/sine_cosine.py`` derives the polynomials by Remez' algorithm and the parts of pi/2, and prints them
with their errors; ``python benchmarks/sine_cosine.py POINTS`` compiles the generated iiwa14.c and holds that many
angles against mpmath (a million takes minutes).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import mpmath as mp
import numpy as np

TERMS = 6
ROBOT = Path(__file__).resolve().parent.parent / "generated" / "iiwa14"
Function = Callable[[mp.mpf], mp.mpf]


def remez(wanted: Function, weight: Function, low: mp.mpf, high: mp.mpf) -> tuple[list[mp.mpf], mp.mpf]:
    """Polynomial of TERMS coefficients with the least largest ``weight * (p - wanted)`` on [low, high]."""
    middle, half = (low + high) / 2, (high - low) / 2
    points = [middle + half * mp.cos(mp.pi * (TERMS - k) / TERMS) for k in range(TERMS + 1)]
    grid = [middle - half * mp.cos(mp.pi * k / 400) for k in range(401)]
    for _ in range(20):
        system, right = mp.matrix(TERMS + 1, TERMS + 1), mp.matrix(TERMS + 1, 1)
        for r, x in enumerate(points):
            for c in range(TERMS):
                system[r, c] = x**c
            system[r, TERMS] = (-1) ** r / weight(x)
            right[r] = wanted(x)
        coefficients = list(mp.lu_solve(system, right))[:TERMS]
        errors = [weight(x) * (mp.polyval(coefficients[::-1], x) - wanted(x)) for x in grid]
        extremes, run = [], [0]
        for k in range(1, len(grid)):
            if errors[k] * errors[run[-1]] < 0:
                extremes.append(max(run, key=lambda n: abs(errors[n])))
                run = []
            run.append(k)
        extremes.append(max(run, key=lambda n: abs(errors[n])))
        points = [grid[k] for k in extremes[: TERMS + 1]]
    return coefficients, max(map(abs, errors))


def derive() -> None:
    mp.mp.prec = 200
    limit = (mp.pi / 4 * (1 + mp.mpf(2) ** -30)) ** 2
    tiny = mp.mpf(10) ** -12
    root = mp.sqrt
    cases = {
        "P": (lambda z: (mp.sin(root(z)) / root(z) - 1) / z, lambda z: z * root(z) / mp.sin(root(z))),
        "Q": (lambda z: (mp.cos(root(z)) - 1 + z / 2) / z**2, lambda z: z**2 / mp.cos(root(z))),
    }
    for name, (wanted, weight) in cases.items():
        coefficients, error = remez(wanted, weight, tiny, limit)
        print(f"{name}: largest relative error 2^{float(mp.log(error, 2)):.1f}")
        for coefficient in coefficients:
            print(f"    {float(coefficient)!r}")
    rest = mp.pi / 2
    for bits in (38, 77):
        part = mp.floor(rest * mp.mpf(2) ** bits) / mp.mpf(2) ** bits
        print(f"pi/2, up to 2^-{bits}: {float(part)!r}")
        rest -= part
    print(f"pi/2, the rest: {float(rest)!r}, off by 2^{float(mp.log(abs(rest - mp.mpf(float(rest))), 2)):.1f}")


MAIN = """
#include "iiwa14.c"
#include <stdio.h>
int main(void)
{
    double x[8];
    while (fread(x, 8, 8, stdin) == 8) {
        lanes angle[8 / LANES], sine[8 / LANES], cosine[8 / LANES];
        memcpy(angle, x, sizeof x);
        sine_cosine(angle, sine, cosine, 8 / LANES);
        fwrite(sine, 8, 8, stdout);
        fwrite(cosine, 8, 8, stdout);
    }
    return 0;
}
"""


def measure(points: int) -> None:
    random = np.random.default_rng(0)
    eighth = points // 4 // 8 * 8
    near = random.integers(-12732, 12733, eighth) * (np.pi / 4)
    near += random.integers(-30, 31, eighth) * np.spacing(near)
    kinds = {
        "|x| <= 1e4": random.uniform(-1e4, 1e4, eighth),
        "|x| <= 4": random.uniform(-4, 4, eighth),
        "beside multiples of pi/4": np.clip(near, -1e4, 1e4),
        "tiny": 10 ** random.uniform(-300, 0, eighth),
    }
    mp.mp.prec = 160
    with tempfile.TemporaryDirectory() as folder:
        for flags in ("-O3 -march=native", "-O2"):
            main, program = Path(folder) / "main.c", Path(folder) / "program"
            main.write_text(MAIN)
            command = ["gcc", *flags.split(), f"-I{ROBOT}", str(main), "-o", str(program), "-lm"]
            subprocess.run(command, check=True)
            for kind, angles in kinds.items():
                out = subprocess.run([str(program)], input=angles.tobytes(), capture_output=True, check=True).stdout
                found = np.frombuffer(out).reshape(-1, 2, 8).transpose(1, 0, 2).reshape(2, -1)
                worst = [0.0, 0.0]
                for k, angle in enumerate(map(mp.mpf, angles.tolist())):
                    for function, exact in enumerate((mp.sin(angle), mp.cos(angle))):
                        error = abs(mp.mpf(float(found[function, k])) - exact) / np.spacing(abs(float(exact)))
                        worst[function] = float(np.maximum(worst[function], error))
                print(f"gcc {flags}, {kind}: sine {worst[0]:.3f} ulp, cosine {worst[1]:.3f} ulp, {len(angles)} angles")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        measure(int(sys.argv[1]))
    else:
        derive()
