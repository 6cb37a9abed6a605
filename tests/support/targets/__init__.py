# SPDX-License-Identifier: MIT
"""Compile a robot's C code for other machines (:data:`MACHINES`), run it in QEMU and count its instructions.

A guest program prints the results of functions for given arguments bit by bit. On request it then calls each function
at many states while a plugin of QEMU counts.
"""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffgen.core.lower.scalar import DOUBLE, FLOAT, Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel
from support.targets.call_graph import CallGraph, compiled_object

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Machine:
    """Machine, its compiler and its emulator; ``packages`` are the Debian packages of both."""

    name: str
    compiler: tuple[str, ...]
    emulator: tuple[str, ...]
    packages: tuple[str, ...]
    bare: bool = False
    """No operating system: the program has its own start code and uses semihosting."""
    software: bool = False
    """Double precision is computed in software."""

    @property
    def prefix(self) -> str:
        """Prefix of the names of its binary tools."""
        return self.compiler[0].removesuffix("gcc") if self.compiler[0].endswith("-gcc") else ""


_M7 = (
    *("qemu-system-arm", "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none"),
    *("-semihosting-config", "enable=on,target=native", "-kernel"),
)
_ARM = ("gcc-arm-none-eabi", "libnewlib-arm-none-eabi", "qemu-system-arm")


def _m7(name: str, fpu: str, *, software: bool = False) -> Machine:
    flags = ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", f"-mfpu={fpu}", "--specs=rdimon.specs")
    return Machine(name, ("arm-none-eabi-gcc", *flags), _M7, _ARM, bare=True, software=software)


MACHINES = (
    Machine("x86-64 gcc", ("gcc", "-static"), ("qemu-x86_64",), ("gcc", "qemu-user")),
    Machine("x86-64 gcc AVX2", ("gcc", "-static", "-mavx2", "-mfma"), ("qemu-x86_64",), ("gcc", "qemu-user")),
    Machine("x86-64 clang", ("clang", "-static"), ("qemu-x86_64",), ("clang", "qemu-user")),
    Machine(
        "aarch64", ("aarch64-linux-gnu-gcc", "-static"), ("qemu-aarch64",),
        ("gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross", "qemu-user"),
    ),
    Machine(
        "riscv64", ("riscv64-linux-gnu-gcc", "-static"), ("qemu-riscv64",),
        ("gcc-riscv64-linux-gnu", "libc6-dev-riscv64-cross", "qemu-user"),
    ),
    _m7("Cortex-M7, FPU for double", "fpv5-d16"),
    _m7("Cortex-M7, FPU for float", "fpv5-sp-d16", software=True),
)  # fmt: skip
"""All of them."""

_MAIN = """
#include "{name}.h"
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef STATES
#define STATES 0
#endif

{arrays}
static {number} results[4096];

__attribute__((noinline)) void mark_begin(void) {{ __asm__ volatile(""); }}
__attribute__((noinline)) void mark_end(void) {{ __asm__ volatile("" ::: "memory"); }}
__attribute__((noinline)) void mark_report(void) {{ __asm__ volatile("nop"); }}

static void show(int count)
{{
    for (int k = 0; k < count; ++k) {{
        {word} bits;
        memcpy(&bits, &results[k], sizeof bits);
        printf("%08lx%08lx ", (unsigned long)((uint64_t)bits >> 32), (unsigned long)(bits & 0xffffffffu));
    }}
    printf("\\n");
}}

static uint64_t state = 88172645463325252ull;

static uint64_t random_bits(void)
{{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}}

/* A number of one of eight kinds, within low and high unless it may be any. */
static {number} number(int kind, {number} low, {number} high, int any)
{{
    const {number} between = low + (high - low) * ({number})(random_bits() >> {dropped}) * {grain};
    {number} x = between;
    {word} bits = ({word})random_bits();
    switch (kind) {{
    case 0: x = bits & 1 ? low : high; break;
    case 1: bits &= {denormal}; memcpy(&x, &bits, sizeof x); break; /* denormal */
    case 2: x = bits & 1 ? 0 : -({number})0; break;
    case 3: x = between * {tiny}; break;
    case 4: if (any) {{ bits |= {nan}; memcpy(&x, &bits, sizeof x); }} break; /* NaN */
    case 5: if (any) {{ x = between * {huge}; }} break;
    case 6: if (any) {{ x = bits & 1 ? INFINITY : -INFINITY; }} break;
    default: break;
    }}
    return x;
}}

static void fill({number} *x, int count, const {number} *low, const {number} *high, int kind, int any)
{{
    for (int k = 0; k < count; ++k) {{
        x[k] = number(kind, low ? low[k] : -1, high ? high[k] : 1, any);
    }}
}}

int main(void)
{{
{golden}
#if STATES > 0
    static {number} given[8][256];
{counted}
#endif
    return {name}_self_check();
}}
"""
_NUMBERS = {
    DOUBLE: {
        "number": "double", "word": "uint64_t", "dropped": "11", "grain": "0x1p-53", "tiny": "1e-160", "huge": "1e300",
        "denormal": "0x800fffffffffffffull", "nan": "0x7ff8000000000000ull",
    },
    FLOAT: {
        "number": "float", "word": "uint32_t", "dropped": "40", "grain": "0x1p-24f", "tiny": "1e-25f", "huge": "1e30f",
        "denormal": "0x807fffffu", "nan": "0x7fc00000u",
    },
}  # fmt: skip


def _program(
    name: str,
    chain: Chain,
    calls: Sequence[tuple[Kernel, Sequence[np.ndarray]]],
    counted: Sequence[Kernel],
    scalar: Scalar,
) -> str:
    """Return the C program that prints golden values and counts instructions on the target."""
    arrays, golden, counts = [], [], []
    for side, ends in (("low", [c.lower for c in chain.coordinates]), ("high", [c.upper for c in chain.coordinates])):
        turn = -math.pi if side == "low" else math.pi  # where a joint has no limit
        values = ", ".join(f"{float(x if math.isfinite(x) else turn).hex()}{scalar.suffix}" for x in ends)
        arrays.append(f"static const {scalar.name} q_{side}[] = {{{values}}};")
    for index, (kernel, arguments) in enumerate(calls):
        given = []
        for k, values_of in enumerate(arguments):
            values = ", ".join(f"{float(x).hex()}{scalar.suffix}" for x in np.ravel(values_of))
            arrays.append(f"static const {scalar.name} a{index}_{k}[] = {{{values}}};")
            given.append(f"a{index}_{k}")
        golden += [*_call(name, chain, kernel, given, "    "), f"    show({_size(chain, kernel)});"]
    for kernel in counted:
        given = [f"given[{k}]" for k in range(len(kernel.arguments))]
        counts.append("    for (int s = 0; s < STATES; ++s) {")
        for k, argument in enumerate(kernel.arguments):
            angles = argument.name == "q"
            limits = "q_low, q_high" if angles else "NULL, NULL"
            size = argument.array(chain).size
            counts.append(f"        fill(given[{k}], {size}, {limits}, s % 8, {int(not angles)});")
        call = _call(name, chain, kernel, given, "        ")
        counts += ["        mark_begin();", *call, "        mark_end();", "    }", "    mark_report();"]
    parts = {"arrays": arrays, "golden": golden, "counted": counts}
    return _MAIN.format(name=name, **_NUMBERS[scalar], **{part: "\n".join(lines) for part, lines in parts.items()})


def _size(chain: Chain, kernel: Kernel) -> int:
    return sum(result.array(chain).size for result in kernel.results)


def _call(name: str, chain: Chain, kernel: Kernel, given: Sequence[str], indent: str) -> list[str]:
    into, start = [], 0
    for result in kernel.results:
        into.append(f"results + {start}")
        start += result.array(chain).size
    return [f"{indent}{name}_{kernel.qualified_name}({', '.join([*given, *into])});"]


def built(
    machine: Machine,
    folder: Path,
    chain: Chain,
    calls: Sequence[tuple[Kernel, Sequence[np.ndarray]]],
    work: Path,
    counted: Sequence[Kernel] = (),
    states: int = 0,
    scalar: Scalar = DOUBLE,
) -> Path:
    """Compile a folder's kernels, which take ``scalar``, for a machine together with a program that runs them."""
    name, program = folder.name, work / "program"
    (work / "main.c").write_text(_program(name, chain, calls, counted, scalar))
    flags = ["-O2", "-std=gnu99", f"-I{folder}", f"-DSTATES={states}"]
    own = [str(HERE / "cortex_m.c"), f"-T{HERE / 'cortex_m.ld'}"] if machine.bare else []
    sources = [str(folder / f"{name}.c"), str(work / "main.c")]
    subprocess.run([*machine.compiler, *flags, *sources, *own, "-o", str(program), "-lm"], check=True)
    return program


def run(machine: Machine, program: Path, scalar: Scalar = DOUBLE) -> list[np.ndarray]:
    """Return the results that a program shows; it must end with a self-check that finds nothing."""
    done = subprocess.run([*machine.emulator, str(program)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    words = [[int(word, 16) for word in line.split()] for line in done.stdout.splitlines()]
    return [np.array(line, dtype=f"u{scalar.bytes}").view(scalar.dtype) for line in words]


@dataclass(frozen=True)
class Count:
    """Instructions of a function, from its call to its return: number of states, the fewest and the most."""

    states: int
    fewest: int
    most: int


def counts(machine: Machine, program: Path, work: Path) -> list[Count]:
    """Count the instructions of the functions that a program was built to count."""
    plugin, out = work / "count.so", work / "counts.txt"
    subprocess.run(["gcc", "-O2", "-fPIC", "-shared", str(HERE / "count.c"), "-o", str(plugin)], check=True)
    symbols = subprocess.run([f"{machine.prefix}nm", str(program)], capture_output=True, text=True, check=True).stdout
    marks = {}
    for mark in ("begin", "end", "report"):
        found = re.search(rf"^([0-9a-f]+) \w mark_{mark}$", symbols, flags=re.M)
        assert found is not None
        marks[mark] = int(found[1], 16) & (~1 if machine.bare else ~0)
    arguments = ",".join(f"{mark}={address:#x}" for mark, address in marks.items())
    command = [machine.emulator[0], "-plugin", f"{plugin},{arguments},out={out}", *machine.emulator[1:], str(program)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=3000)
    return [Count(*map(int, line.split())) for line in out.read_text().splitlines()]


@dataclass(frozen=True)
class Footprint:
    """Sizes [bytes]: code and constants of NAME.c, its permanent memory, its deepest stack, and that of a step.

    Of NAME_impedance.c the same two, and the stack of each public function, with the kernels that it calls. Stacks are
    None, or none, for clang, which writes no graph of calls.
    """

    flash: int
    ram: int
    stack: int | None
    step_stack: int | None
    controller_flash: int | None
    controller_ram: int | None
    controller_stacks: dict[str, int]


def footprint(machine: Machine, folder: Path, work: Path) -> Footprint:
    """Measure the sizes of a folder's kernels, without batches, and those of its controller."""
    graph, name = CallGraph(), folder.name
    graph.add(compiled_object(machine, folder / f"{name}.c", work))
    kernels = [function for function in graph.sizes if function.startswith(f"{name}_")]
    stack = max((graph.depth(function) for function in kernels), default=None)
    controller = folder / f"{name}_impedance.c"
    own: tuple[int | None, int | None] = None, None
    stacks: dict[str, int] = {}
    if controller.exists():
        graph.add(compiled_object(machine, controller, work))
        own = _sizes(machine, work / f"{controller.stem}.o")
        public = [each for each in graph.sizes if each.startswith(f"{name}_") and each not in kernels]
        stacks = {each.removeprefix(f"{name}_"): graph.depth(each) for each in sorted(public)}
    return Footprint(
        *_sizes(machine, work / f"{name}.o"), stack, stacks.get("impedance_step"), *own, controller_stacks=stacks
    )


def _sizes(machine: Machine, compiled: Path) -> tuple[int, int]:
    """Return code with constants, and permanent memory, of an object [bytes]."""
    command = [f"{machine.prefix}size", str(compiled)]
    table = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, table.splitlines()[1].split()[:3])
    return text, data + bss


_LONGEST = """
static void to_modes(const modes_t *m, const double *A, double *y);
static void from_modes(const modes_t *m, const double *A, double *y);

/* The modes, and before them those of a copy with all turns that there may be. */
static void find_modes(double *A, modes_t *m)
{
    double copy[NN], y[N] = {0.0};
    modes_t longest;
    memcpy(copy, A, sizeof copy);
    find_longest_modes(copy, &longest);
    to_modes(&longest, copy, y);
    from_modes(&longest, copy, y);
    __asm__ volatile("" : : "r"(y), "r"(copy) : "memory");
    find_own_modes(A, m);
}
"""


def with_longest_iterations(source: str) -> str:
    """Return the controller's C with additional modes of as many turns as their bound permits."""
    found = re.search(r"^static void find_modes\(double \*A, modes_t \*m\)\n\{.*?^}\n", source, flags=re.M | re.S)
    assert found is not None
    going_on = "e[last] > negligible"
    assert found[0].count(going_on) == 1
    longest = found[0].replace("find_modes", "find_longest_modes").replace(going_on, "1")
    own = found[0].replace("find_modes", "find_own_modes")
    return source[: found.start()] + longest + own + _LONGEST + source[found.end() :]


def step_count(machine: Machine, folder: Path, work: Path, steps: int, *, longest: bool = False) -> Count:
    """Count the instructions of the impedance controller's step, in smooth and hostile motions in turn.

    ``work`` is a folder of this machine and robot, in which the kernels are kept from count to count.

    ``longest``: with all turns of the modes (:func:`with_longest_iterations`).
    """
    name, program = folder.name, work / "step"
    own = [str(HERE / "cortex_m.c"), f"-T{HERE / 'cortex_m.ld'}"] if machine.bare else []
    (work / "robot.h").write_text(
        f'#include "{name}_impedance.h"\n#define ROBOT(x) {name}_impedance_##x\n'
        f"#define CLOCK {name.upper()}_CLOCK_COUNTER\n"
    )
    controller, text = work / "controller.c", (folder / f"{name}_impedance.c").read_text()
    controller.write_text(with_longest_iterations(text) if longest else text)
    flags = ["-O2", "-std=gnu99", f"-I{folder}", f"-I{work}", f"-DSTATES={steps}"]
    kernels = work / "kernels_of_step.o"
    if not kernels.exists():  # both controllers call the same
        subprocess.run([*machine.compiler, *flags, "-c", str(folder / f"{name}.c"), "-o", str(kernels)], check=True)
    sources = [str(kernels), str(controller), str(HERE / "step.c")]
    subprocess.run([*machine.compiler, *flags, *sources, *own, "-o", str(program), "-lm"], check=True)
    (count,) = counts(machine, program, work)
    return count
