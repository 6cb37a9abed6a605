# SPDX-License-Identifier: MIT
"""Derivation of the coefficients of the generated sine and cosine, and measurement of their accuracy.

python tests/campaigns/sine_cosine.py                    derive the polynomials by Remez' algorithm and the parts of
                                                         pi, for doubles and floats; print them and their errors
python tests/campaigns/sine_cosine.py POINTS             compile the generated iiwa14.c and compare that many angles
                                                         with mpmath (a million takes minutes)
python tests/campaigns/sine_cosine.py --search SECONDS   climb the error against long double, and print the worst
                                                         angle of each build
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import mpmath as mp
import numpy as np

TERMS, FLOAT_TERMS = 6, 3
ROBOT = Path(__file__).resolve().parents[2] / "generated" / "iiwa14"
Function = Callable[[mp.mpf], mp.mpf]


def remez(wanted: Function, weight: Function, low: mp.mpf, high: mp.mpf, terms: int) -> tuple[list[mp.mpf], mp.mpf]:
    """Return the polynomial of `terms` coefficients with the least largest `weight * (p - wanted)`, and this value."""
    middle, half = (low + high) / 2, (high - low) / 2
    # Remez exchange: solve for an error of alternating sign at terms + 1 points, then move these to the extremes.
    points = [middle + half * mp.cos(mp.pi * (terms - k) / terms) for k in range(terms + 1)]
    grid = [middle - half * mp.cos(mp.pi * k / 400) for k in range(401)]
    for _ in range(20):  # converges quadratically: 20 rounds are plenty
        system, right = mp.matrix(terms + 1, terms + 1), mp.matrix(terms + 1, 1)
        for r, x in enumerate(points):
            for c in range(terms):
                system[r, c] = x**c
            system[r, terms] = (-1) ** r / weight(x)
            right[r] = wanted(x)
        coefficients = list(mp.lu_solve(system, right))[:terms]
        errors = [weight(x) * (mp.polyval(coefficients[::-1], x) - wanted(x)) for x in grid]
        extremes, run = [], [0]  # a run: places of the grid where the error keeps its sign
        for k in range(1, len(grid)):
            if errors[k] * errors[run[-1]] < 0:
                extremes.append(max(run, key=lambda n: abs(errors[n])))
                run = []
            run.append(k)
        extremes.append(max(run, key=lambda n: abs(errors[n])))
        points = [grid[k] for k in extremes[: terms + 1]]
    return coefficients, max(map(abs, errors))


def derive() -> None:
    mp.mp.prec = 200
    print("doubles")
    derive_for(float, TERMS, mp.mpf(2) ** -30, (37, 76))
    print("floats")
    derive_for(np.float32, FLOAT_TERMS, mp.mpf(2) ** -10, (10, 22, 34))


def derive_for(number: type[float | np.float32], terms: int, beyond: mp.mpf, bits: Sequence[int]) -> None:
    """Print what a type of number needs: ``beyond`` pi/4 the reduced angle gets, pi's parts end at these ``bits``."""
    limit = (mp.pi / 4 * (1 + beyond)) ** 2
    tiny = mp.mpf(10) ** -12
    root = mp.sqrt
    cases = {
        "P": (lambda z: (mp.sin(root(z)) / root(z) - 1) / z, lambda z: z * root(z) / mp.sin(root(z))),
        "Q": (lambda z: (mp.cos(root(z)) - 1 + z / 2) / z**2, lambda z: z**2 / mp.cos(root(z))),
    }
    for name, (wanted, weight) in cases.items():
        coefficients, error = remez(wanted, weight, tiny, limit, terms)
        print(f"{name}: largest relative error 2^{float(mp.log(error, 2)):.1f}")
        for coefficient in coefficients:
            print(f"    {number(coefficient)!s}")
    rest = +mp.pi
    for bit in bits:
        part = mp.floor(rest * mp.mpf(2) ** bit) / mp.mpf(2) ** bit
        print(f"pi, up to 2^-{bit}: {number(part)!s}")
        rest -= part
    print(f"pi, the rest: {number(rest)!s}, off by 2^{float(mp.log(abs(rest - mp.mpf(float(number(rest)))), 2)):.1f}")


MAIN = """
#include "iiwa14_lanes.h"
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
    """Print the largest errors [ulp] of the generated sine and cosine, over random angles of four kinds."""
    random = np.random.default_rng(0)
    eighth = points // 4 // 8 * 8
    near = random.integers(-12732, 12733, eighth) * (np.pi / 4)  # up to 1e4
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


SEARCH = r"""
#include "iiwa14_lanes.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static unsigned long long seed = 88172645463325252ULL;
static double uniform(double low, double high)
{
    seed ^= seed << 13; seed ^= seed >> 7; seed ^= seed << 17;
    return low + (high - low) * (double)(seed >> 11) * 0x1p-53;
}
static double ulps(double found, long double exact)
{
    const double size = fabs((double)exact);
    return (double)(fabsl(found - exact) / (nextafter(size, INFINITY) - size));
}
/* Errors of LANES angles; the worse one of sine and cosine. */
static void errors(const double *x, double *error)
{
    lanes angle, sine, cosine;
    memcpy(&angle, x, sizeof angle);
    sine_cosine(&angle, &sine, &cosine, 1);
    for (int n = 0; n < LANES; ++n) {
        const double s = ulps(((double *)&sine)[n], sinl(x[n])), c = ulps(((double *)&cosine)[n], cosl(x[n]));
        error[n] = s > c ? s : c;
    }
}
enum { KEPT = 64 };
int main(int argc, char **argv)
{
    (void)argc;
    const clock_t end = clock() + (clock_t)(atof(argv[1]) * CLOCKS_PER_SEC);
    double best[KEPT] = {0}, error[KEPT] = {0};
    double count = 0;
    while (clock() < end) {
        for (int round = 0; round < 20000; ++round) {
            double x[LANES], e[LANES];
            for (int n = 0; n < LANES; ++n) {
                const double kind = uniform(0, 1);
                if (kind < 0.25) { x[n] = uniform(-FAR, FAR); }
                else if (kind < 0.35) { x[n] = uniform(-4, 4); }
                else if (kind < 0.5) {
                    x[n] = (floor(uniform(0, 6366)) + 0.5) * 1.5707963267948966 * (1 + uniform(-1e-5, 1e-5));
                }
                else {
                    x[n] = best[(int)uniform(0, KEPT)];
                    if (kind < 0.75) { x[n] += ldexp(uniform(-1, 1), (int)uniform(-45, 0)); }
                    else { x[n] += floor(uniform(-50, 50)) * 1.5707963267948966; }
                }
                if (!(fabs(x[n]) <= FAR)) { x[n] = 1; }
            }
            errors(x, e);
            count += LANES;
            for (int n = 0; n < LANES; ++n) {
                int least = 0, known = 0;
                for (int k = 0; k < KEPT; ++k) { if (error[k] < error[least]) least = k; known |= best[k] == x[n]; }
                if (!known && e[n] > error[least]) { error[least] = e[n]; best[least] = x[n]; }
            }
        }
    }
    int worst = 0;
    for (int k = 0; k < KEPT; ++k) if (error[k] > error[worst]) worst = k;
    printf("%.4f ulp at %.17g, %.3g angles\n", error[worst], best[worst], count);
    return 0;
}
"""


def search(seconds: float) -> None:
    """Random angles, and steps from the 64 worst so far: by small amounts, and by multiples of pi/2."""
    with tempfile.TemporaryDirectory() as folder:
        main, program = Path(folder) / "main.c", Path(folder) / "program"
        main.write_text(SEARCH)
        for build in ("gcc -O2", "gcc -O3 -march=native", "clang -O2", "clang -O3 -march=native"):
            subprocess.run([*build.split(), f"-I{ROBOT}", str(main), "-o", str(program), "-lm"], check=True)
            found = subprocess.run([str(program), str(seconds)], capture_output=True, text=True, check=True)
            print(f"{build}: {found.stdout}", end="")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--search"]:
        search(float(sys.argv[2]))
    elif len(sys.argv) > 1:
        measure(int(sys.argv[1]))
    else:
        derive()
