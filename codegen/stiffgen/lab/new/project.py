# SPDX-License-Identifier: MIT
"""Make a project from a robot's file: the generated folder, a loop, a simulated robot, a test, a script."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from stiffgen.cli.survey import missing_limits
from stiffgen.control.presets import Preset, motor_tables
from stiffgen.core.errors import ChainError, OutputError, StiffgenError, printable
from stiffgen.core.folder import swapped_in
from stiffgen.core.generate import generate_folder
from stiffgen.core.loading import chain_between, describe, located
from stiffgen.core.names import c_string, checked_identifier, comment, identifier
from stiffgen.core.options import GenerationOptions
from stiffgen.core.rendering import environment
from stiffgen.core.robot.chain import Chain, Coordinate
from stiffgen.core.robot.description import Description, Reading
from stiffgen.families.springs.springs import spring
from stiffgen.lab.new.licences import licences_of
from stiffgen.lab.new.questions import GENERATED, Answers, decide
from stiffgen.lab.new.ros2_package import check_robot, package_files, package_name
from stiffgen.rooms import optional

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


def new_project(
    urdf: str | Path,
    decide: Callable[[Description], Answers] = decide,
    *,
    reading: Reading | None = None,
    name: str | None = None,
    output: str | Path | None = None,
    build: bool = True,
    progress: Callable[[str], None] = lambda step: None,
    note: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write a project for the user, which builds and runs at once with a simulated robot.

    The folder appears whole or not at all; an existing folder is never replaced.

    Args:
        urdf: path of the robot's file, or its name; copies of the files become part of the project.
        decide: function that decides what the robot's description leaves open (default: asks nobody).
        reading: settings of the reader.
        name: prefix of the C names and name of the Python module (default: from the robot's name).
        output: the folder to write (default: NAME_control).
        build: compile the Python module.
        progress: called with a few words before each step.
        note: called with each sentence that the user should read and that changes nothing.

    Returns:
        Path of the project.

    Raises:
        StiffgenError: see :func:`stiffgen.generate`; also if something is ambiguous and nobody can answer.

    """
    urdf, reading = located(urdf, reading or Reading())
    description = describe(urdf, reading)
    name = identifier(description.robot) if name is None else checked_identifier(name)
    answers = decide(description)
    ros2 = answers.controller == "ros2"
    default = package_name(name) if ros2 else f"{name}_control"
    target = _free_folder(Path(default) if output is None else Path(output))
    options = _options(answers, reading, description.root)
    chain = chain_between(description, options)
    _check(chain, answers)
    if ros2:
        check_robot(urdf)
    copies, variables = _content(urdf, description, reading, name, chain, answers)
    with swapped_in(target) as staging:
        for file, content in copies.items():
            (staging / "urdf" / file).parent.mkdir(parents=True, exist_ok=True)
            (staging / "urdf" / file).write_bytes(content)
        build = build and not ros2  # colcon compiles the package
        options = replace(options, name=name, output=staging / "generated", build=build, progress=progress)
        generate_folder(urdf, options)
        progress("writing the project")
        _write(package_files(variables) if ros2 else _rendered(variables), staging)
    for sentence in _notes(chain, answers):
        note(sentence)
    return target


def _notes(chain: Chain, answers: Answers) -> Iterator[str]:
    """Yield what the user should read: limits that were guessed, and numbers that are probably in another unit."""
    if answers.controller in GENERATED:
        guesses = "src/defaults.hpp" if answers.controller == "ros2" else "src/control.hpp"
        yield from missing_limits(chain.source, chain.coordinates, guesses=guesses, is_mjcf=chain.is_mjcf)
    lint = optional("files.plausibility")
    for sentence in lint.doubts(chain) if lint else ():
        yield f"{printable(chain.source)}: {sentence}"


def _options(answers: Answers, reading: Reading, root: str) -> GenerationOptions:
    """Return the options that select the robot's chain and spring; ``root`` is the root link of the description."""
    return GenerationOptions(
        tip=answers.tip,
        base=None if answers.base == root else answers.base,
        tool=answers.tool,
        springs=() if answers.spring == "trace" else (answers.spring,),
        masses=answers.masses,
        **vars(reading),
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


def _content(
    urdf: Path, description: Description, reading: Reading, name: str, chain: Chain, answers: Answers
) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return the content of the folder ``urdf`` by file, and the variables of the templates."""
    files = _copied_files(urdf, description)
    licences = licences_of(files.values())
    # the launch file then needs neither xacro nor the template's packages
    is_expanded = answers.controller == "ros2" and (urdf.suffix == ".xacro" or bool(reading.arguments))
    expanded = f"{name}.expanded.urdf" if is_expanded else ""
    variables = _variables(name, chain, answers, f"urdf/{next(iter(files))}")
    variables |= {"licences": licences.sentence, "expanded": expanded}
    copies = {file: source.read_bytes() for file, source in (licences.files | files).items()}
    if expanded:
        copies[expanded] = _expanded(urdf, reading)
    return copies, variables


def _expanded(template: Path, reading: Reading) -> bytes:
    """Return the URDF of a template, which has been read already: its room is there."""
    templates = optional("files.templates")
    text: bytes = templates.expand(template, reading).text if templates else b""
    return text


def _check(chain: Chain, answers: Answers) -> None:
    """Refuse a floating base, and a generated controller that does not exist or does not take the robot."""
    if chain.floating:
        raise ChainError(
            f"{chain.source}: the base floats, and projects need a fixed base; "
            "choose a --base above which nothing moves, or use 'stiffgen generate'"
        )
    controller = optional("control.page")
    needs_controller = answers.controller in GENERATED
    if needs_controller and controller is None:
        raise StiffgenError("this stiffgen has no impedance controller; choose --controller spring")
    if needs_controller and controller and not controller.has_controller(chain):
        raise StiffgenError(
            f"{chain.source}: the impedance controller takes at most 40 coordinates, and this robot has {chain.dof}; "
            "choose --controller spring"
        )


def _variables(name: str, chain: Chain, answers: Answers, file: str) -> dict[str, Any]:
    """Return the variables of the templates; ``file`` is the copy of the robot's file in the project."""
    coordinates = chain.coordinates
    # limits to set because the URDF has none, by joint
    effort = {k: _FORCE for k, c in enumerate(coordinates) if not 1e-6 <= c.effort <= 1e5}
    velocity = {k: _SPEED for k, c in enumerate(coordinates) if not 2e-6 <= c.velocity <= 1e3}
    rotors = _rotors(chain, effort, velocity)
    return {
        "name": name,
        "macro": name.upper(),
        "robot": chain,
        "answers": answers,
        "group": spring(answers.spring).name,
        # the start configuration, away from limits and from a stretched arm
        "posture": tuple(float(f"{_start(k, coordinate):.4g}") for k, coordinate in enumerate(coordinates)),
        # inertia of the motors at the joints [kg m^2 or kg], which the generated controller has no default for
        "rotors": rotors.motor_inertia,
        "rotors_source": rotors.inertia_source,
        # friction fed forward [N m or N]: 0 until somebody has measured it
        "friction": answers.friction or (0.0,) * chain.dof,
        "effort": effort,
        "velocity": velocity,
        "regenerate": _command(name, chain, answers, file),
        "file": file,
    }


def _rotors(chain: Chain, effort: dict[int, float], velocity: dict[int, float]) -> Preset:
    """Return the motors' numbers of the generated controller; guessed limits take the place of missing ones."""
    limited = tuple(
        replace(c, effort=effort.get(k, c.effort), velocity=velocity.get(k, c.velocity))
        for k, c in enumerate(chain.coordinates)
    )
    return motor_tables(replace(chain, coordinates=limited))


def _command(name: str, chain: Chain, answers: Answers, file: str) -> str:
    """Return the command that generates the robot's folder again."""
    arguments = [f"{argument}:={value}" for argument, value in chain.arguments]
    parts = ["stiffgen", "generate", file, *arguments, "--name", name, "--tip", answers.tip, "--base", chain.base]
    parts += [] if chain.masses else ["--no-masses"]
    parts += [word for element in chain.ignored for word in ("--ignore", element)]
    parts += [word for each in chain.accepted for word in ("--accept-inertia", each.link)]
    parts += [] if answers.spring == "trace" else ["--spring", answers.spring]
    if (tool := answers.tool) is not None:
        for part, value in vars(tool).items():
            numbers = value if isinstance(value, Iterable) else (value,)
            parts += ["--tool", f"{part}={','.join(map(repr, numbers))}"] if any(numbers) else []
    return " ".join(map(_quoted, parts))


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


def _write(files: dict[str, str], folder: Path) -> None:
    for file, rendered in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(rendered, encoding="utf-8", newline="\n")


def _rendered(variables: dict[str, Any]) -> dict[str, str]:
    # in C++, Python and Markdown, names from the robot's file go through the filters
    templates = environment("stiffgen.lab.new", {"comment": comment, "c_string": c_string, "python": ascii})
    return {file: templates.get_template(template).render(variables) for file, template in FILES.items()}
