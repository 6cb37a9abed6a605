# SPDX-License-Identifier: MIT
"""Count the mutants of a folder's C that the comparisons of values of ``stiffgen verify`` kill.

    python tests/campaigns/mutations.py --count 128 --seed 0
    python tests/campaigns/mutations.py --part kernels --count 128 --seed 0

A mutant has one change in the text of NAME_impedance.c, or of the kernels' sources: an operator, a comparison, a
constant, an index, a statement less. Those that do not compile, or compile to the same machine code, are not counted.
The comparison of the text, which finds every mutant, is left out: the count is that of differences in what the compiled
code does. Mutants of the controller run in hostile sessions; mutants of kernels, in single calls and batches, are
compared with CasADi, with the stated bounds, with NaN and infinity, and with guard pages around their arguments.
"""

from __future__ import annotations

import argparse
import ctypes
import itertools
import random
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.control.core.config import CONFIG
from stiffgen.control.sessions.library import CAREFUL
from stiffgen.control.sessions.sessions import differences, open_controller
from stiffgen.core.emit.build import kernel_sources
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.folder.bounds import check_bounds
from stiffgen.core.verify.folder.files import check_c_tables, print_again
from stiffgen.core.verify.folder.forked import confined
from stiffgen.core.verify.kernels.batches import LONG, check_c_batches
from stiffgen.core.verify.kernels.formulas import check_against_casadi, check_far_angles
from stiffgen.core.verify.kernels.not_finite import check_not_finite
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import Check
from stiffgen.families.rounding.certified import check_certified_bounds

ROOT = Path(__file__).parents[2]
OPERATORS = (
    (r" \+ ", (" - ",)),
    (r" - ", (" + ",)),
    (r" \* ", (" + ",)),
    (r" / ", (" * ",)),
    (r" <= ", (" < ", " >= ")),
    (r" >= ", (" > ", " <= ")),
    (r" < ", (" <= ", " >= ")),
    (r" > ", (" >= ", " <= ")),
    (r" == ", (" != ",)),
    (r" != ", (" == ",)),
    (r" && ", (" || ",)),
    (r" \|\| ", (" && ",)),
    (r" \+= ", (" -= ", " = ")),
    (r" -= ", (" += ",)),
    (r"\(!(?=[a-z(])", ("(",)),
    (r"\bif \((?=[a-z])", ("if (!",)),
    (r"\blarger\b", ("smaller",)),
    (r"\bsmaller\b", ("larger",)),
    (r"\bfabs\b", ("",)),
    (r"\[i\]", ("[0]",)),
    (r"(?<![\w.\[{])\d+\.\d+(?:e-?\d+)?\b(?=[^\n]*;)", ("2.0", "0.0")),
    (r"\n +[a-z][\w.>\[\]-]* [-+*/]?= [^;\n]+;", ("\n    ;",)),
    (r"\n +[a-z_]+\([^;\n]*\);", ("\n    ;",)),
)


@dataclass(frozen=True)
class Mutant:
    """One change: the line before and after, and the whole text."""

    line: int
    before: str
    after: str
    text: str


def mutants(text: str, count: int, seed: int) -> list[Mutant]:
    """Draw mutants of the functions of a C text, spread over its lines; comments and prototypes are left alone."""
    blank = re.sub(
        r"/\*.*?\*/|^#.*?$", lambda found: re.sub(r"[^\n]", "~", found[0]), text, flags=re.DOTALL | re.MULTILINE
    )
    places = [
        (found.start(), found.end(), replacement)
        for pattern, replacements in OPERATORS
        for found in re.finditer(pattern, blank)
        for replacement in replacements
        if replacement != found[0]
    ]
    chosen = random.Random(seed).sample(places, min(count, len(places)))
    drawn = []
    for start, end, replacement in chosen:
        changed = text[:start] + replacement + text[end:]
        line = text.count("\n", 0, start + (text[start] == "\n"))
        drawn.append(Mutant(line + 1, text.splitlines()[line].strip(), changed.splitlines()[line].strip(), changed))
    return drawn


def changed_defaults(text: str) -> list[Mutant]:
    """Change every default of the configuration, one at a time."""
    found = []
    for field in CONFIG:
        pattern = re.compile(rf"config->{field.name}(?:\[\w\])? = ([^;]+);")
        match = pattern.search(text)
        if match is None:
            continue
        value = "1.0" if "NAN" in match[1] else f"2.0 * ({match[1]}) + 0.01"
        value = "2" if field.type == "int" else value
        after = f"{match[0].partition(' = ')[0]} = {value};"
        if after != match[0]:
            line = text.count("\n", 0, match.start()) + 1
            found.append(Mutant(line, match[0], after, text[: match.start()] + after + text[match.end() :]))
    return found


class Workshop:
    """Compiler of mutants against the kernels of one folder, compiled once."""

    def __init__(self, robot: GeneratedRobot, folder: Path) -> None:
        """Print the robot's sources, compile its kernels once, and keep the unchanged controller as reference."""
        self.robot, self.folder, self.built = robot, folder, 0
        for file, text in print_again(robot).items():
            if file.endswith((".c", ".h")):
                (folder / file).parent.mkdir(exist_ok=True)
                (folder / file).write_text(text)
        self.text = (folder / f"{robot.name}_impedance.c").read_text()
        self.objects = []
        for source in kernel_sources(folder, robot.name):
            made = f"{source}.o"
            subprocess.run(["cc", "-std=gnu99", "-O1", "-fPIC", "-c", str(source), "-o", made], check=True)
            self.objects.append(made)
        reference = self.compile(self.text)
        assert reference is not None
        self.reference, self.code = reference

    def compile(self, text: str) -> tuple[Path, bytes] | None:
        """Return the library and the machine code of a controller's text; None if it does not compile."""
        self.built += 1
        source = self.folder / "mutant.c"
        made, library = self.folder / "mutant.o", self.folder / f"mutant_{self.built}.so"
        source.write_text(text)
        command = ["cc", "-std=gnu99", *CAREFUL, "-w", "-fPIC", f"-I{self.folder}"]
        if subprocess.run([*command, "-c", str(source), "-o", str(made)], capture_output=True, check=False).returncode:
            return None
        code = made.read_bytes()
        subprocess.run(["cc", "-shared", str(made), *self.objects, "-lm", "-o", str(library)], check=True)
        return library, code

    def survives(self, library: Path, seed: int) -> bool:
        """Return whether no difference is seen; a crash, and no end within five minutes, are differences."""
        return confined(lambda: self.faults(library, seed), 300) == []

    def faults(self, library: Path, seed: int) -> list[str]:
        """Return the first fault that the sessions see."""
        reference, changed = (open_controller(each, self.robot) for each in (self.reference, library))
        return differences(reference, changed, self.robot.chain, seed, enough=1)


class KernelWorkshop(Workshop):
    """Compiler of mutants of one source of the kernels; the others are compiled once."""

    def __init__(self, robot: GeneratedRobot, folder: Path, file: str) -> None:
        super().__init__(robot, folder)
        self.objects = [each for each in self.objects if each != f"{folder / file}.o"]
        self.text, self.batch = (folder / file).read_text(), file.endswith("_batch.c")
        reference = self.compile(self.text)
        assert reference is not None
        self.reference, self.code = reference

    def faults(self, library: Path, seed: int) -> list[str]:
        """Return the first comparison that fails."""
        return next(([check.kernel] for check in self._checks(ctypes.CDLL(str(library)), seed) if not check.passed), [])

    def _checks(self, built: ctypes.CDLL, seed: int) -> Iterator[Check]:
        """Yield the comparisons of ``verify`` that look at the changed source, the fast ones first."""
        robot, rounding = self.robot, self.robot.manifest["rounding"]
        chain, table, name, scalar = robot.chain, robot.table, robot.name, robot.scalar
        functions = {kernel.qualified_name: _of_c(built, name, kernel, chain, batch=self.batch) for kernel in table}
        pool, libraries = argument_samples(chain, LONG, seed, robot.springs), {"native": built}
        yield from check_c_tables(robot, libraries)
        yield from check_against_casadi(functions, chain, 20, seed, robot.springs)
        yield from check_certified_bounds([functions], table, chain, scalar, rounding, rounding, pool)
        for kernel in table:
            yield from check_not_finite(functions, (kernel,), pool, scalar)
            yield from check_bounds(built, name, (kernel,), chain, pool, scalar)
            if self.batch:
                yield from check_c_batches(libraries, name, functions, (kernel,), chain, pool, scalar)
        yield from check_far_angles(functions, chain, seed, robot.springs)


def _of_c(library: ctypes.CDLL, name: str, kernel: Kernel, chain: Chain, *, batch: bool) -> Callable[..., Any]:
    """Return a C function of one configuration, or its batch, as a function of one or of a stack."""
    batch = batch and kernel.batch
    function = library[f"{name}_{kernel.qualified_name}{'_batch' if batch else ''}"]
    shapes = [argument.array(chain).shape for argument in kernel.arguments]
    shapes_of_results = [result.array(chain).shape for result in kernel.results]

    def call(*arguments: Any) -> Any:
        """Call the compiled kernel for one state, or for leading dimensions of states."""
        stacks = [
            np.reshape(np.ascontiguousarray(each, float), (-1, *shape))
            for each, shape in zip(arguments, shapes, strict=True)
        ]
        results = [np.empty((len(stacks[0]), *shape)) for shape in shapes_of_results]
        if batch:
            given = ((ctypes.c_void_p(each.ctypes.data), ctypes.c_ssize_t(each[0].size)) for each in stacks)
            outs = (ctypes.c_void_p(each.ctypes.data) for each in results)
            function(ctypes.c_size_t(len(stacks[0])), *itertools.chain(*given), *outs)
        else:
            for row in range(len(stacks[0])):
                function(*(ctypes.c_void_p(each[row : row + 1].ctypes.data) for each in (*stacks, *results)))
        if np.ndim(arguments[0]) == len(shapes[0]):
            results = [each[0] for each in results]
        return tuple(results) if len(results) > 1 else results[0]

    return call


def count_survivors(workshop: Workshop, drawn: list[Mutant], seed: int) -> tuple[int, list[Mutant]]:
    """Return the number of mutants that differ in machine code, and those of them that survive."""
    counted, survivors = 0, []
    for mutant in drawn:
        built = workshop.compile(mutant.text)
        if built is None or built[1] == workshop.code:
            continue
        counted += 1
        if workshop.survives(built[0], seed):
            survivors.append(mutant)
            print(f"survives: line {mutant.line}: {mutant.before}  ->  {mutant.after}", flush=True)
        built[0].unlink()
    return counted, survivors


def main() -> None:
    """Make mutants of the controller or the kernels, run the comparisons of ``stiffgen verify`` on each, and count
    the killed.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "generated" / "iiwa14")
    parser.add_argument("--part", choices=("controller", "kernels"), default="controller", help="sources [controller]")
    parser.add_argument("--count", type=int, default=128, help="mutants drawn, and most defaults [128]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw and of the sessions [0]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="stiffgen-mutations-") as folder:
        robot = open_robot(options.folder)
        draws: list[tuple[Workshop, dict[str, list[Mutant]]]] = []
        if options.part == "controller":
            workshop = Workshop(robot, Path(folder))
            defaults = changed_defaults(workshop.text)[: options.count]
            drawn = {"defaults": defaults, "mutants": mutants(workshop.text, options.count, options.seed)}
            draws = [(workshop, drawn)]
        else:
            files = [source.name for source in kernel_sources(robot.folder, robot.name)]
            for number, file in enumerate(files):
                place = Path(folder) / str(number)
                place.mkdir()
                of_file = KernelWorkshop(robot, place, file)
                draws.append((of_file, {file: mutants(of_file.text, options.count // len(files), options.seed)}))
        for workshop, titled in draws:
            assert workshop.survives(workshop.reference, options.seed), f"{[*titled]}: the folder itself does not pass"
            for title, drawn in titled.items():
                counted, survivors = count_survivors(workshop, drawn, options.seed)
                print(f"{title}: {counted - len(survivors)} of {counted} killed ({len(drawn)} drawn)", flush=True)


if __name__ == "__main__":
    main()
