# SPDX-License-Identifier: MIT
"""Instructions that a contender executes, and the fewest cycles in which the processor's ports can execute them.

The instructions are counted by stepping through the calls (contenders/steps.c, Linux on x86-64), so that neither
counters nor a simulator of the vectors are needed. The bound is a table of ports of one processor: each instruction
occupies one of the units of its kind for some cycles, and no schedule is shorter than what any set of units has to do.
Latencies, caches and the order of instructions are left out, so that no code can reach more than 100 % of it.
"""

from __future__ import annotations

import itertools
import re
import subprocess
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.tools import HERE, run

COUNTED = {"run": 32, "run_batch": 128}
"""Configurations that are stepped through."""

MULTIPLIES, ADDS, SHUFFLES, ANY = (0, 1), (2, 3), (1, 2), (0, 1, 2, 3)
"""Vector units of Zen 4; what is not known to be restricted may go to any of them, which only lowers the bound."""
LOADS, STORES, DISPATCH = "loads", "stores", "dispatch"
_KINDS: tuple[tuple[str, tuple[int, ...], float], ...] = (
    (r"v?(div|sqrt)[ps]d", MULTIPLIES, 5.0),
    (r"v?(mul|fn?m(add|sub)\d*|fmaddsub\d*)[ps]d", MULTIPLIES, 1.0),
    (r"v?(add|sub|addsub|hadd)[ps]d", ADDS, 1.0),
    (r"v?(unpck|shuf|perm|insert|extract|align|broadcast|blend|movddup|mov[lh])\w*", SHUFFLES, 1.0),
    (r".*", ANY, 1.0),
)  # fmt: skip
"""Pattern of the mnemonic, units, and cycles that it occupies one of them at up to 256 bits; 512 bits take twice."""
_COPIES = re.compile(r"v?mov(ap[sd]|up[sd]|dq[au]\d*|[sq])$")
_NO_ACCESS = ("lea", "nop", "data16", "cs", "prefetch", "endbr64")


@dataclass(frozen=True)
class Instruction:
    """One instruction of a disassembly, in Intel's syntax."""

    mnemonic: str
    operands: str

    @property
    def width(self) -> int:
        """Return the bits of its widest vector, 64 for others."""
        return next((bits for name, bits in (("zmm", 512), ("ymm", 256), ("xmm", 128)) if name in self.operands), 64)

    @property
    def accesses(self) -> tuple[int, int]:
        """Return how many loads and stores it does."""
        if self.mnemonic.startswith(("push", "call")):
            return 0, 1
        if self.mnemonic.startswith(("pop", "ret")):
            return 1, 0
        if "[" not in self.operands or self.mnemonic.startswith(_NO_ACCESS):
            return 0, 0
        if "[" not in self.operands.split(",")[0] or self.mnemonic.startswith(("cmp", "test")):
            return 1, 0
        return (0, 1) if "mov" in self.mnemonic or "extract" in self.mnemonic else (1, 1)

    @property
    def unit(self) -> tuple[tuple[int, ...], float] | None:
        """Return the vector units it may go to and the cycles that it occupies one; None if it needs none."""
        if not re.search(r"[xyz]mm", self.operands):
            return None
        if _COPIES.match(self.mnemonic) and (sum(self.accesses) or self.width >= 128):
            return None  # loads and stores have units of their own; copies of whole registers are renamed
        units, cycles = next((units, cycles) for name, units, cycles in _KINDS if re.fullmatch(name, self.mnemonic))
        return units, cycles * (2 if self.width == 512 else 1)


def counted(steps: Path, inputs: Path, library: Path, function: str, count: int) -> Counter[Instruction]:
    """Return how often each instruction of a contender was executed, over ``count`` configurations.

    Raises:
        subprocess.CalledProcessError: the system forbids to step through a process.

    """
    lines = run([str(steps), str(inputs), str(count), str(library), function]).splitlines()
    by_file: dict[str, dict[int, int]] = {}
    for line in lines:
        file, offset, repeats = line.rsplit(" ", 2)
        by_file.setdefault(file, {})[int(offset, 16)] = int(repeats)
    found: Counter[Instruction] = Counter()
    for file, at in by_file.items():
        code = disassembled(Path(file), min(at), max(at))
        for place, times in at.items():
            found[code[place]] += times
    return found


def disassembled(file: Path, first: int, last: int) -> dict[int, Instruction]:
    """Return the instructions between two addresses of a file, by address."""
    command = ["objdump", "-d", "-M", "intel", "--no-show-raw-insn", f"--start-address={first}",
               f"--stop-address={last + 16}", str(file)]  # fmt: skip
    found = {}
    for line in run(command).splitlines():
        address, colon, text = line.partition(":\t")
        if colon:
            words = text.partition("#")[0].partition("<")[0].split(maxsplit=1)
            prefixes = ("rep", "repz", "repnz", "bnd", "notrack", "lock")
            if words and words[0] in prefixes and len(words) > 1:
                words = words[1].split(maxsplit=1)
            found[int(address, 16)] = Instruction(words[0], words[1].strip() if len(words) > 1 else "")
    return found


def has_table() -> bool:
    """Return whether this processor is the one of the table: AMD's family 25 with 512 bits (Zen 4)."""
    file = Path("/proc/cpuinfo")
    text = file.read_text() if file.exists() else ""
    return bool(re.search(r"^cpu family\s*: 25$", text, re.MULTILINE)) and " avx512f" in text


def least_cycles(executed: Counter[Instruction]) -> tuple[float, str]:
    """Return the fewest cycles of Zen 4 for these instructions, and what needs them.

    Six operations are dispatched in a cycle. Two vectors of 256 bits are loaded and one is stored; three and two of
    shorter ones.
    """
    occupied: dict[tuple[int, ...], float] = {}
    loads = stores = 0.0
    for instruction, times in executed.items():
        wide = {512: 2.0, 256: 1.0}.get(instruction.width, 0.5)
        loaded, stored = instruction.accesses
        loads += times * loaded * (1 / 3 if wide < 1 else wide / 2)
        stores += times * stored * wide
        if instruction.unit:
            units, cycles = instruction.unit
            occupied[units] = occupied.get(units, 0.0) + times * cycles
    bounds = {LOADS: loads, STORES: stores, DISPATCH: sum(executed.values()) / 6}
    for size in range(1, len(ANY) + 1):
        for units in itertools.combinations(ANY, size):
            work = sum(cycles for which, cycles in occupied.items() if set(which) <= set(units))
            bounds[_named(units)] = work / size
    what = max(bounds, key=lambda name: bounds[name])
    return bounds[what], what


def _named(units: Iterable[int]) -> str:
    names = {MULTIPLIES: "multiplications", ADDS: "additions", SHUFFLES: "shuffles", ANY: "vector units"}
    return names.get(tuple(units), f"vector units {', '.join(map(str, units))}")


def compiled_steps(folder: Path) -> Path:
    """Compile contenders/steps.c."""
    program = folder / "steps"
    run(["gcc", "-O2", str(HERE / "contenders" / "steps.c"), "-o", str(program), "-ldl"])
    return program


@dataclass(frozen=True)
class Work:
    """What a contender does per configuration; ``least_cycles`` is None on processors without a table."""

    instructions: float
    least_cycles: float | None
    busiest: str


def of_contender(steps: Path, inputs: Path, library: Path, function: str, count: int) -> Work | None:
    """Return the work per configuration of inputs for ``count`` of them; None where nothing can be counted."""
    count = min(COUNTED[function], count)
    try:
        executed = counted(steps, inputs, library, function, count)
    except (subprocess.CalledProcessError, FileNotFoundError):
        return None
    cycles, busiest = least_cycles(executed)
    return Work(sum(executed.values()) / count, cycles / count if has_table() else None, busiest)
