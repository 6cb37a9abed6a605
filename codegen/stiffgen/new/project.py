# SPDX-License-Identifier: MIT
"""Make a project from a robot's file: the generated folder, a loop, a simulated robot, a test, a script."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from stiffgen.emit.controller import has_controller
from stiffgen.errors import ChainError, OutputError, StiffgenError, printable
from stiffgen.folder import swapped_in
from stiffgen.generate import generate_folder
from stiffgen.loading import chain_between, describe, located
from stiffgen.names import c_string, checked_identifier, comment, identifier
from stiffgen.new.questions import Answers, Ask, Given, decide
from stiffgen.options import GenerationOptions
from stiffgen.rendering import environment
from stiffgen.robot.chain import Chain, Coordinate, Tool
from stiffgen.robot.description import Description, Reading
from stiffgen.robot.survey import missing_limits
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.springs import spring

FILES = {
    "CMakeLists.txt": "CMakeLists.txt.j2",
    "README.md": "README.md.j2",
    ".gitignore": "gitignore.j2",
    "src/main.cpp": "main.cpp.j2",
    "src/control.hpp": "control.hpp.j2",
    "src/simulated_robot.hpp": "simulated_robot.hpp.j2",
    "src/first_steps.c": "first_steps.c.j2",
    "python/first_steps.py": "first_steps.py.j2",
    "tests/test_control.cpp": "test_control.cpp.j2",
}
"""Templates by the file that they become."""
_FORCE, _SPEED = 100.0, 2.0
"""Limits in place of missing or unusable limits of the URDF: [N m or N], [rad/s or m/s]. The README names them."""


@dataclass(frozen=True)
class _Page:
    """Values for the templates.

    Attributes:
        name, macro: prefixes of C names and macros.
        robot: the chain.
        answers: the decisions.
        group: namespace of the spring, with the namespace of the tip if there is one.
        posture: the start configuration, away from limits and from a stretched arm.
        zone: width of the zone inside the limits that pushes back [rad or m].
        rotors: inertia of the motors at the joints [kg m^2 or kg]: the file's, or a guess.
        effort, velocity: limits to set because the URDF has none, by joint.
        regenerate: the command that made the generated folder.
        file: the copy of the robot's file in the project.

    """

    name: str
    macro: str
    robot: Chain
    answers: Answers
    group: str
    posture: tuple[float, ...]
    zone: float
    rotors: tuple[float, ...]
    effort: dict[int, float]
    velocity: dict[int, float]
    regenerate: str
    file: str


def new_project(
    urdf: str | Path,
    *,
    given: Given | None = None,
    reading: Reading | None = None,
    tool: Tool | None = None,
    name: str | None = None,
    output: str | Path | None = None,
    build: bool = True,
    ask: Ask | None = None,
    ready: Callable[[], None] = lambda: None,
    progress: Callable[[str], None] = lambda step: None,
    note: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write a project for the user, which builds and runs at once with a simulated robot.

    The folder appears whole or not at all; an existing folder is never replaced.

    Args:
        urdf: path of the robot's file, or its name; copies of the files become part of the project.
        given: decisions already made: tip, base, spring, controller, masses.
        reading: settings of the reader.
        tool: the tool on the tip link.
        name: prefix of the C names and name of the Python module (default: from the robot's name).
        output: the folder to write (default: NAME_control).
        build: compile the Python module.
        ask: function that asks for open decisions; None if nobody can answer.
        ready: called after the last question.
        progress: called with a few words before each step.
        note: called with each sentence that the user should read and that changes nothing.

    Returns:
        Path of the project.

    Raises:
        StiffgenError: see :func:`stiffgen.generate`; also if something is ambiguous and nobody can answer.

    """
    urdf, reading = located(urdf, reading or Reading())
    given = given or Given(tool=tool is not None)
    description = describe(urdf, reading)
    name = identifier(description.robot) if name is None else checked_identifier(name)
    target = _free_folder(Path(f"{name}_control") if output is None else Path(output))
    answers = decide(description, given, ask)
    ready()
    tool = tool or (None if answers.tool_xyz is None else Tool(xyz=answers.tool_xyz))
    options = _options(answers, given.masses, reading, tool, description.root)
    chain = chain_between(description, options.chain)
    _check(chain, answers)
    files = _copied_files(urdf, description)
    page = _page(name, chain, answers, tool, f"urdf/{next(iter(files))}")
    with swapped_in(target) as staging:
        for file, source in files.items():
            (staging / "urdf" / file).parent.mkdir(parents=True, exist_ok=True)
            (staging / "urdf" / file).write_bytes(source.read_bytes())
        options = replace(options, name=name, output=staging / "generated", build=build, progress=progress)
        generate_folder(urdf, options)
        progress("writing the project")
        _write(page, staging)
    if answers.controller == "impedance":
        for sentence in missing_limits(chain.source, chain.coordinates, guesses="src/control.hpp"):
            note(sentence)
    return target


def _options(answers: Answers, masses: bool, reading: Reading, tool: Tool | None, root: str) -> GenerationOptions:
    """Return the options that select the robot's chain and spring; ``root`` is the root link of the description."""
    return GenerationOptions(
        tip=answers.tip,
        base=None if answers.base == root else answers.base,
        tool=tool,
        springs=SpringOptions(() if answers.spring == "trace" else (answers.spring,)),
        masses=masses,
        ignore=reading.ignored,
        arguments=reading.arguments,
        package_path=reading.package_path,
    )


def _free_folder(target: Path) -> Path:
    """Return the folder to write; refuse one that exists."""
    if target.exists() or target.is_symlink():
        raise OutputError(
            f"{printable(str(target), 200)}: exists, and a project is never overwritten; choose another --output"
        )
    return target


def _copied_files(urdf: Path, description: Description) -> dict[str, Path]:
    """Return the files to copy by their path in the project, the robot's own file first.

    Files that a template finds in packages stay there; the README's command needs --package-path for them.
    """
    files = {".": urdf.resolve()}
    folder = urdf.resolve().parent
    files |= {each.file: (folder / each.file).resolve() for each in description.inputs if "://" not in each.file}
    root = Path(os.path.commonpath([path.parent for path in files.values()]))
    return {path.relative_to(root).as_posix(): path for path in files.values()}


def _check(chain: Chain, answers: Answers) -> None:
    if chain.floating:
        raise ChainError(
            f"{chain.source}: the base floats, and projects need a fixed base; "
            "choose a --base above which nothing moves, or use 'stiffgen generate'"
        )
    if answers.controller == "impedance" and not has_controller(chain):
        raise StiffgenError(
            f"{chain.source}: the impedance controller takes at most 40 coordinates, and this robot has {chain.dof}; "
            "choose --controller spring"
        )


def _page(name: str, chain: Chain, answers: Answers, tool: Tool | None, file: str) -> _Page:
    coordinates = chain.coordinates
    arguments = [f"{argument}:={value}" for argument, value in chain.arguments]
    parts = ["stiffgen", "generate", file, *arguments, "--name", name, "--tip", answers.tip, "--base", chain.base]
    parts += [] if chain.masses else ["--no-masses"]
    parts += [word for element in chain.ignored for word in ("--ignore", element)]
    parts += [] if answers.spring == "trace" else ["--spring", answers.spring]
    if tool is not None:
        for option, value in (("xyz", tool.xyz), ("rpy", tool.rpy), ("com", tool.com), ("inertia", tool.inertia)):
            parts += [f"--tool-{option}", *map(repr, value)] if any(value) else []
        parts += ["--tool-mass", repr(tool.mass)] if tool.mass else []
    return _Page(
        name=name,
        macro=name.upper(),
        robot=chain,
        answers=answers,
        group=spring(answers.spring).name,
        posture=tuple(float(f"{_start(k, coordinate):.4g}") for k, coordinate in enumerate(coordinates)),
        zone=min(0.1, *(float(f"{0.2 * (c.upper - c.lower):.2g}") for c in coordinates)),
        rotors=tuple(c.motor_inertia or (1.0 if c.type == "prismatic" else 0.1) for c in coordinates),
        effort={k: _FORCE for k, c in enumerate(coordinates) if not 1e-6 <= c.effort <= 1e5},
        velocity={k: _SPEED for k, c in enumerate(coordinates) if not 2e-6 <= c.velocity <= 1e3},
        regenerate=" ".join(map(_quoted, parts)),
        file=file,
    )


def _quoted(word: str) -> str:
    """Quote a word for a shell, on one line of printable ASCII whatever a link or a file is called."""
    if word.isascii() and word.isprintable():
        return shlex.quote(word)
    plain = set(range(0x20, 0x7F)) - {ord("'"), ord("\\")}
    return "$'" + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in os.fsencode(word)) + "'"


def _range(coordinate: Coordinate) -> tuple[float, float]:
    """Return the range in which a joint may start: near zero, at most three rad or m wide."""
    lower, upper = max(coordinate.lower, -1.5), min(coordinate.upper, 1.5)
    if lower < upper:
        return lower, upper
    beyond = coordinate.lower > 0  # the whole range is above 1.5
    lower, upper = (coordinate.lower, lower + 1.0) if beyond else (upper - 1.0, coordinate.upper)
    return max(lower, coordinate.lower), min(upper, coordinate.upper)


def _start(index: int, coordinate: Coordinate) -> float:
    """Return a bent arm: joints alternately below and above the middle of their ranges."""
    lower, upper = _range(coordinate)
    return lower + (upper - lower) * (0.7 if index % 2 else 0.4)


def _write(page: _Page, folder: Path) -> None:
    for file, rendered in _rendered(page).items():
        path = folder / file
        path.parent.mkdir(exist_ok=True)
        path.write_text(rendered, encoding="utf-8", newline="\n")


def _rendered(page: _Page) -> dict[str, str]:
    # in C++, Python and Markdown, names from the robot's file go through the filters
    templates = environment("stiffgen.new", {"comment": comment, "c_string": c_string, "python": ascii})
    return {file: templates.get_template(template).render(vars(page)) for file, template in FILES.items()}
