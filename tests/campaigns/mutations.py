# SPDX-License-Identifier: MIT
"""Count the mutants of a folder's controller that the sessions of ``stiffgen verify`` kill.

    python tests/campaigns/mutations.py --count 128 --seed 0

A mutant has one change in the text of NAME_impedance.c: an operator, a comparison, a constant, an index, a statement
less. Those that do not compile, or compile to the same machine code, are not counted. The comparison of the text, which
finds every mutant, is left out: the count is that of differences in what the compiled controller does.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from stiffgen.emit.build import kernel_sources
from stiffgen.emit.fields import CONFIG
from stiffgen.opened import GeneratedRobot, open_robot
from stiffgen.verify.controller_library import ControllerLibrary
from stiffgen.verify.files import print_again
from stiffgen.verify.sessions import differences

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
    (r"\bfmax\b", ("fmin",)),
    (r"\bfmin\b", ("fmax",)),
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
        pattern = re.compile(rf"config->{field.name}(?:\[i\])? = ([^;]+);")
        match = pattern.search(text)
        if match is None:
            continue
        value = "2" if field.type == "int" else f"2.0 * ({match[1]}) + 0.01"
        after = f"{match[0].partition(' = ')[0]} = {value};"
        if after != match[0]:
            line = text.count("\n", 0, match.start()) + 1
            found.append(Mutant(line, match[0], after, text[: match.start()] + after + text[match.end() :]))
    return found


class Workshop:
    """Compiler of mutants against the kernels of one folder, compiled once."""

    def __init__(self, robot: GeneratedRobot, folder: Path) -> None:
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
        command = ["cc", "-std=gnu99", "-O1", "-w", "-fPIC", f"-I{self.folder}"]
        if subprocess.run([*command, "-c", str(source), "-o", str(made)], capture_output=True, check=False).returncode:
            return None
        code = made.read_bytes()
        subprocess.run(["cc", "-shared", str(made), *self.objects, "-lm", "-o", str(library)], check=True)
        return library, code

    def survives(self, library: Path, seed: int) -> bool:
        """Return whether the sessions see no difference; a crash or no end within a minute is a difference."""
        process = multiprocessing.get_context("fork").Process(target=self._compare, args=(library, seed))
        process.start()
        process.join(120.0)
        if process.is_alive():
            process.kill()
            process.join()
            return False
        return process.exitcode == 0

    def _compare(self, library: Path, seed: int) -> None:
        chain, name = self.robot.chain, self.robot.name
        both = (ControllerLibrary(each, name, chain) for each in (self.reference, library))
        sys.exit(1 if differences(*both, chain, seed, enough=1) else 0)


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
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "generated" / "iiwa14")
    parser.add_argument("--count", type=int, default=128, help="mutants drawn [128]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw and of the sessions [0]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="stiffgen-mutations-") as folder:
        workshop = Workshop(open_robot(options.folder), Path(folder))
        for title, drawn in (
            ("defaults", changed_defaults(workshop.text)),
            ("mutants", mutants(workshop.text, options.count, options.seed)),
        ):
            counted, survivors = count_survivors(workshop, drawn, options.seed)
            print(f"{title}: {counted - len(survivors)} of {counted} killed ({len(drawn)} drawn)", flush=True)


if __name__ == "__main__":
    main()
