# SPDX-License-Identifier: MIT
"""Compare a robot's functions with the same statements in more digits, to measure the error of every entry.

The second copy is NAME.c itself with ``double`` replaced by ``__float128`` (34 digits) or ``long double``, without
vectors, and with sines and cosines of that type. The constants are the printed ones. The copy's own error is some
2^-60 of the measured error. Long doubles on x86 (64 bits) have 2^-11 and take a sixth of the time.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from flint import arb, ctx

from stiffgen.core.emit import build
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.rounding import Stages
from stiffgen.families.rounding.bounds import ErrorBounds, NoBound, argument_sizes, chain_reach
from support.generated_c import kernel_text
from support.graphs import BALLS

WIDTHS = {
    "no vectors": ["-DSTIFFGEN_NO_VECTORS"],
    "SSE2": ["-mno-avx"],
    "AVX2": ["-mavx2", "-mfma", "-mno-avx512f"],
    "AVX-512": ["-march=x86-64-v4"],
}
"""Flags for every width of vectors that lanes.c distinguishes; the last two have fused multiply-add."""
_SINE_COSINE = """static inline void sine_cosine(const lanes *x, lanes *sine, lanes *cosine, int count)
{
    for (int n = 0; n < count; ++n) {
        sine[n] = SINE(x[n]);
        cosine[n] = COSINE(x[n]);
    }
}
"""
_LONGER = {
    "__float128": "#include <quadmath.h>\n#define SINE sinq\n#define COSINE cosq\n",
    "long double": "#define SINE sinl\n#define COSINE cosl\n",
}
"""Types of the second copy, and their functions."""
_DRIVER = """
void errors_of_{kernel}(size_t count, {parameters}, double *values, double *errors)
{{
    {declared}
    for (size_t c = 0; c < count; ++c) {{
        {copies}
        {name}_{kernel}({given});
    }}
    {batch}
    for (size_t c = 0; c < count; ++c) {{
        {quad_copies}
        {quad}_{kernel}({quad_given});
        {differences}
    }}
    {freed}
}}
"""


def can_run(flags: Sequence[str]) -> bool:
    """Return whether this machine has the vectors that the flags ask for."""
    known = Path("/proc/cpuinfo").read_text()
    if "-march=x86-64-v4" in flags:
        return " avx512f " in known
    return "-mavx2" not in flags or " avx2 " in known


class Measured:
    """Functions of a folder's C, and their errors."""

    def __init__(
        self,
        folder: Path,
        name: str,
        chain: Chain,
        kernels: Sequence[Kernel],
        work: Path,
        flags: Sequence[str] = (),
        compiler: str = "gcc",
        source: str | None = None,
        batches: bool = False,
        exact: Path | None = None,
        longer: str = "__float128",
    ) -> None:
        """Compile the functions and their reference.

        ``source`` is the text of NAME.c to measure (default: the folder's); ``batches`` includes the batches. ``exact``
        is a folder of the same robot in doubles; it is the reference of a ``folder`` of floats, whose constants are
        rounded. ``longer`` is the type that replaces double in the reference.
        """
        self.batches, self.longer = batches, longer
        self.chain, self.kernels = chain, {kernel.qualified_name: kernel for kernel in kernels}
        header, own = (folder / f"{name}.h").read_text(), kernel_text(folder, name)
        self.number: Literal["double", "float"] = (
            "float" if f"void {name}_forward_kinematics(const float" in header else "double"
        )
        (work / f"{name}.h").write_text(header)
        (work / f"{name}.c").write_text((source or own) if batches else _without_batches(source or own))
        quad = f"{name}_quad"
        doubles = _renamed(((exact or folder) / f"{name}.h").read_text(), name, quad)
        (work / f"{quad}.h").write_text(doubles)
        statements = kernel_text(exact or folder, name)
        (work / f"{quad}.c").write_text(_in_quad(_renamed(statements, name, quad), longer))
        driver = work / f"{name}_errors.c"
        drivers = [self._driver(name, quad, kernel) for kernel in kernels]
        prototypes = re.findall(rf"^void {quad}_\w+\((?:[^;]*)\);", doubles, flags=re.M)
        quads = [re.sub(r"\bdouble\b", longer, each) for each in prototypes if "size_t count" not in each]
        driver.write_text("\n".join([f'#include "{name}.h"', "#include <stdlib.h>", *quads, *drivers]))
        library = work / f"{name}_errors.so"
        commands = [
            [with_quad, "-c", "-fPIC", "-w", *own_flags, f"-I{work}", str(each), "-o", str(each.with_suffix(".o"))]
            for each, with_quad, own_flags in (
                (work / f"{name}.c", compiler, ["-O2", *flags]),
                (work / f"{quad}.c", "gcc", ["-O1"]),
                (driver, "gcc", ["-O1"]),
            )
        ]
        build.run_all(commands, compiler, work)  # in the tests, KeptObjects': a robot's reference is compiled once
        objects = [command[-1] for command in commands]
        subprocess.run(["gcc", "-shared", *objects, "-o", str(library), "-lquadmath", "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))

    def _driver(self, name: str, quad: str, kernel: Kernel) -> str:
        """Return the C function that calls a kernel in double, in batches and in quad, and stores the differences."""
        arguments = [a.array(self.chain) for a in kernel.arguments]
        results = [r.array(self.chain) for r in kernel.results]
        total, number, start = sum(r.size for r in results), self.number, 0
        declared = [
            f"{number} *const own_{a.name} = malloc(count * sizeof *own_{a.name} * {a.size});" for a in arguments
        ]
        copies, quad_copies, differences, called = [], [], [], []
        for a in arguments:
            declared.append(f"{self.longer} quad_{a.name}[{a.size}];")
            loop = f"for (int k = 0; k < {a.size}; ++k)"
            copies.append(f"{loop} own_{a.name}[{a.size} * c + k] = ({number}){a.name}[{a.size} * c + k];")
            quad_copies.append(f"{loop} quad_{a.name}[k] = own_{a.name}[{a.size} * c + k];")
            called.append(f"own_{a.name}, {a.size}")
        batch = kernel.batch and self.batches
        for r in results:
            declared.append(f"{self.longer} quad_{r.name}[{r.size}];")
            for which in ("own", "many") if batch else ("own",):
                declared.append(
                    f"{number} *const {which}_{r.name} = malloc(count * sizeof *{which}_{r.name} * {r.size});"
                )
            differences.append(f"for (int k = 0; k < {r.size}; ++k) {{ const size_t at = {total} * c + {start} + k;")
            differences.append(f"values[at] = (double)own_{r.name}[{r.size} * c + k]; errors[at] = 0;")
            for which in ("own", "many") if batch else ("own",):
                off = f"({self.longer}){which}_{r.name}[{r.size} * c + k] - quad_{r.name}[k]"
                differences.append(f"{{ const {self.longer} d = {off}; const double e = (double)(d < 0 ? -d : d);")
                differences.append("errors[at] = e > errors[at] || e != e ? e : errors[at]; }")
            differences.append("}")
            start += r.size
        locations = [f"own_{each.name} + {each.size} * c" for each in (*arguments, *results)]
        into = [f"many_{r.name}" for r in results]
        freed = [f"own_{each.name}" for each in (*arguments, *results)] + (into if batch else [])
        return _DRIVER.format(
            kernel=kernel.qualified_name,
            parameters=", ".join(f"const double *{a.name}" for a in arguments),
            declared="\n    ".join(declared),
            copies="\n        ".join(copies),
            name=name,
            quad=quad,
            given=", ".join(locations),
            batch=f"{name}_{kernel.qualified_name}_batch(count, {', '.join([*called, *into])});" if batch else "",
            quad_copies="\n        ".join(quad_copies),
            quad_given=", ".join(f"quad_{each.name}" for each in (*arguments, *results)),
            differences="\n        ".join(differences),
            freed=" ".join(f"free({each});" for each in freed),
        )

    def errors(self, kernel: str, arguments: Sequence[np.ndarray]) -> np.ndarray:
        """Return |computed - exact| of every entry of the results, one after the other, for a stack of states."""
        _, errors = self.values_and_errors(kernel, arguments)
        return errors

    def values_and_errors(self, kernel: str, arguments: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return the computed values and their errors."""
        record, count = self.kernels[kernel], len(arguments[0])
        found = np.empty((2, count, sum(result.array(self.chain).size for result in record.results)))
        given = [np.ascontiguousarray(argument, dtype=float) for argument in arguments]
        pointers = [ctypes.c_void_p(each.ctypes.data) for each in (*given, *found)]
        self.library[f"errors_of_{kernel}"](ctypes.c_size_t(count), *pointers)
        return found[0], found[1]


def _renamed(text: str, name: str, quad: str) -> str:
    return text.replace(f"{name}_", f"{quad}_").replace(f"{name}.h", f"{quad}.h").replace(name.upper(), quad.upper())


def _without_batches(source: str) -> str:
    """Return NAME.c up to its batches, without the self-check behind them."""
    single, check, _ = source.partition("/* ---- Self-check")
    assert check
    return single


def _in_quad(source: str, longer: str) -> str:
    """Return NAME.c, without batches, with its numbers in a type of more digits."""
    start = source.index("#if defined(__GNUC__) && LANE_BYTES <= 16\n/* Called")
    end = source.index("\n}\n", start) + 3
    source = source[:start] + _SINE_COSINE + source[end:]
    source = _without_batches(source)
    head = "#include <float.h>\n#include <math.h>\n#include <stddef.h>\n#include <string.h>\n"
    return f"{head}{_LONGER[longer]}#define STIFFGEN_NO_VECTORS\n#define double {longer}\n{source}"


def draw(
    chain: Chain,
    kernel: Kernel,
    ranges: Ranges,
    count: int,
    random: np.random.Generator,
    scalar: Scalar = DOUBLE,
) -> list[np.ndarray]:
    """Draw random arguments of a kernel within the ranges of its bounds; half of them at the ends."""
    given = []
    for argument, sizes in zip(kernel.arguments, argument_ends(chain, kernel, ranges, scalar), strict=True):
        values = random.uniform(-1, 1, (count, len(sizes)))
        if argument.name != "q":
            ends = random.random((count, 1)) < 0.5
            values = np.where(ends, np.sign(values), values)
        given.append(within(argument.name, values * sizes, chain, scalar))
    return given


def within(name: str, values: np.ndarray, chain: Chain, scalar: Scalar) -> np.ndarray:
    """Return the same values within their ranges: joint positions in their limits, poses with a rotation."""
    if name == "q":
        lower, upper = (np.array([getattr(c, side) for c in chain.coordinates]) for side in ("lower", "upper"))
        inside: np.ndarray = np.clip(
            values,
            np.where(np.isfinite(lower), lower, -scalar.largest_angle),
            np.where(np.isfinite(upper), upper, scalar.largest_angle),
        )
        return inside
    if name in ("equilibrium", "base_pose", "tool_pose"):
        poses = values.reshape(-1, 4, 4).copy()
        rotations, upper = np.linalg.qr(poses[:, :3, :3])
        poses[:, :3, :3] = rotations * np.sign(np.diagonal(upper, axis1=1, axis2=2))[:, None, :]
        return poses.reshape(len(values), 16)
    return values


def kernels_with_bounds(
    chain: Chain, ranges: Ranges, kernels: Sequence[Kernel], scalar: Scalar = DOUBLE
) -> dict[str, np.ndarray]:
    """Return the bounds of every entry of the results, one after the other, of those kernels that have some."""
    found, error_bounds = {}, ErrorBounds(chain, ranges, scalar)
    for kernel in kernels:
        with suppress(NoBound):
            found[kernel.qualified_name] = np.concatenate([*error_bounds.of(kernel).values()])
    return found


class Climb(NamedTuple):
    """Result of a search for large errors: largest error of every entry, number of states, and the worst states."""

    errors: np.ndarray
    states: int
    worst: list[np.ndarray]
    """Arguments, 30 states each, the worst one first."""


def climbed(
    measured: Measured,
    kernel: Kernel,
    ranges: Ranges,
    states: int,
    random: np.random.Generator,
    pool: int = 1000,
    *,
    bounds: np.ndarray | float = 1.0,
) -> Climb:
    """Search for large errors of every entry, as parts of ``bounds``: half of the states random, half near the worst.

    Half of the worst states have the largest part of a bound, half the largest error.
    """
    arguments = [argument.array(measured.chain) for argument in kernel.arguments]
    scalar = SCALARS[measured.number]
    sizes = argument_ends(measured.chain, kernel, ranges, scalar)
    largest, worst, errors_of_worst, count = np.zeros(1), None, np.zeros((0, 2)), 0
    while worst is None or count < states:
        given = draw(measured.chain, kernel, ranges, pool, random, scalar)
        if worst is not None:
            for k, (array, size) in enumerate(zip(arguments, sizes, strict=True)):
                chosen = worst[k][random.integers(0, len(worst[k]), pool // 2)]
                steps = 10.0 ** random.uniform(-14, 0, (pool // 2, 1)) * random.normal(size=chosen.shape)
                moved = np.clip(chosen + size * steps * (random.random(chosen.shape) < 0.3), -size, size)
                given[k][: pool // 2] = within(array.name, moved, measured.chain, scalar)
        errors = measured.errors(kernel.qualified_name, given)
        largest = np.maximum(largest, errors.max(axis=0))
        parts = (errors / np.maximum(bounds, 1e-300)).max(axis=1)
        of_states = np.stack([parts, errors.max(axis=1)], axis=1)
        if worst is None:
            worst, errors_of_worst = given, of_states
        else:
            worst = [np.concatenate(pair) for pair in zip(worst, given, strict=True)]
            errors_of_worst = np.concatenate([errors_of_worst, of_states])
        best = np.unique(np.argsort(-errors_of_worst, axis=0)[:15])
        worst, errors_of_worst = [each[best] for each in worst], errors_of_worst[best]
        count += pool
    return Climb(largest, count, worst)


def argument_ends(chain: Chain, kernel: Kernel, ranges: Ranges, scalar: Scalar = DOUBLE) -> list[np.ndarray]:
    """Return the largest entries of a kernel's arguments."""
    reach = chain_reach(kernel.scope(chain), ranges, scalar)
    return [np.array(argument_sizes(chain, argument, ranges, reach, scalar)) for argument in kernel.arguments]


def with_eighty_digits(measured: Measured, kernel: Kernel, arguments: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the largest error at some states against 80 digits (Arb).

    Returns:
        That error, and how much of it the measured errors are off at most.

    """
    stages = Stages.of(measured.chain, kernel)
    values, errors = measured.values_and_errors(kernel.qualified_name, arguments)
    largest, off = 0.0, 0.0
    with ctx.workdps(80):
        for state, (row, of_row) in enumerate(zip(values, errors, strict=True)):
            given = [arb(float(x)) for each in arguments for x in each[state].astype(SCALARS[measured.number].dtype)]
            for value, error, entry in zip(row, of_row, stages.run(given, arb, BALLS), strict=True):
                exactly = abs(entry - arb(float(value)))
                largest = max(largest, float(exactly.upper()))
                # A batch may be farther off than the value.
                off = max(off, float((exactly - arb(float(error))).upper()))
    return largest, off / largest if largest else off
