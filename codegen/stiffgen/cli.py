# SPDX-License-Identifier: MIT
"""The command line: ``stiffgen new | generate | inspect | verify | prove | bench | play | analyze``.

Exit code 0: done; 1: a check failed, or a recording has no row to analyse; 2: refused input or usage, or output that
cannot be written. Refusals are one message on standard error.
"""

from __future__ import annotations

import argparse
import errno
import io
import math
import os
import signal
import sys
import threading
import warnings
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TextIO, get_args

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

import stiffgen
from stiffgen.analyze.analysis import SUMMARY, analyze, checked_stiffness, read_stiffness
from stiffgen.analyze.options import GROUPS, AnalysisOptions, has_default, told
from stiffgen.analyze.report import TABLE_HEAD, statements, table_rows
from stiffgen.analyze.report import warnings as recording_warnings
from stiffgen.bench import bench
from stiffgen.errors import (
    DescriptionError,
    DescriptionWarning,
    EmptyRecordingError,
    StiffgenError,
    listed,
    printable,
    terminal_text,
)
from stiffgen.generate import generate
from stiffgen.lower.rounding import Ranges
from stiffgen.lower.scalar import DOUBLE, SCALARS
from stiffgen.names import comment
from stiffgen.new.project import new_project
from stiffgen.new.questions import CONTROLLERS, Given
from stiffgen.opened import open_robot
from stiffgen.play.page import write_page
from stiffgen.prove.run import PARTS, prove
from stiffgen.prove.safety_page import filed_for, targets_for
from stiffgen.prove.safety_page import write_page as write_safety_page
from stiffgen.prove.verdict import Outcome
from stiffgen.robot.chain import Tool
from stiffgen.robot.description import Description, JointElement
from stiffgen.robot.reader import read_description
from stiffgen.robot.survey import TipSurvey, survey_tip
from stiffgen.symbolic.potentials import SpringOptions, read_potential
from stiffgen.symbolic.springs import AXES, KINDS, Placement
from stiffgen.verify.result import Check
from stiffgen.verify.verify import default_count, verify


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        with _stopped_by_signals():
            if sys.stdout is None:  # closed
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            code = _run(arguments)
            sys.stdout.flush()
            return code
    except StiffgenError as error:
        message, code = str(error), 2
    except KeyboardInterrupt:
        message, code = "interrupted", 130
    except _Terminated as error:
        message, code = f"ended by {signal.Signals(error.number).name}", 128 + error.number
    except MemoryError:
        message, code = "the memory that this process may use is not enough (ulimit -v says how much); allow more", 2
    except OSError as error:
        where = "standard output" if error.filename is None else printable(str(error.filename), 200)
        message, code = f"{where}: {error.strerror or error}", 2
        _discard_output()
    with suppress(OSError):
        print(f"stiffgen: {terminal_text(message)}", file=sys.stderr, flush=True)
    return code


def _run(arguments: Sequence[str] | None) -> int:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of any script, terminals of any encoding
    try:
        options = _parser().parse_args(arguments)
    except SystemExit:
        sys.stdout.flush()  # of --help and --version
        raise
    with warnings.catch_warnings():
        warnings.simplefilter("always", DescriptionWarning)
        warnings.showwarning = _show_warning
        return int(options.run(options))


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    print(f"stiffgen: warning: {terminal_text(str(message))}", file=sys.stderr)


class _Terminated(BaseException):
    """A signal that asks the process to end; passes through every block that cleans up."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP end the block by an exception, so that nothing half-written stays."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise _Terminated(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = [(number, signal.getsignal(number)) for number in numbers]
    for number, handler in before:
        if handler is signal.SIG_DFL:  # nohup and whoever calls this from Python keep their own way
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before:
            if handler is not None:
                signal.signal(number, handler)


def _discard_output() -> None:
    """Python flushes standard output once more when it ends, and would say so if that fails."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w") as nowhere, suppress(OSError):
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


class _Console(Console):
    """A console on which a closed pipe is an error like any other; rich would end the process with exit code 1."""

    def on_broken_pipe(self) -> None:
        raise


class _Once(argparse.Action):
    """Stores a value, and refuses the option's second appearance: the one before would be lost without a word."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        given = namespace.__dict__.setdefault("_given", set())
        if option is not None and self.dest in given:
            parser.error(f"{option} is given twice; leave one of them out")
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class _OnceTrue(_Once):
    """The same for an option without a value."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, default=False, help=help)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        super().__call__(parser, namespace, True, option)


class _Parser(argparse.ArgumentParser):
    """Options that hold one value may be given once."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("action", None, _Once)
        self.register("action", "store_true", _OnceTrue)

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:  # argparse would hide that it cannot be written
            (file or sys.stderr).write(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="stiffgen", description=stiffgen.__doc__)
    parser.add_argument("--version", action="version", version=f"stiffgen {stiffgen.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("generate", help="write a robot's folder of C code and its Python module")
    command.add_argument("urdf", type=Path, metavar="URDF")
    command.add_argument(
        "--tip",
        metavar="LINK",
        action="append",
        help="link where the wrench acts (default: the only leaf link); repeat it for several tips with one q",
    )
    command.add_argument("--base", metavar="LINK", help="first link of the chain (default: the root link)")
    command.add_argument(
        "--floating-base",
        action="store_true",
        help="the base is free: functions take its pose, and its body twist comes before the joints' rates "
        "(a file's own floating root joint has the same effect)",
    )
    command.add_argument("--name", help="prefix of all C names and name of the module (default: the robot's name)")
    command.add_argument("--output", type=Path, default=Path("generated"), metavar="DIR", help="default: generated")
    command.add_argument("--no-masses", action="store_true", help="ignore all masses; the mass matrix is left out")
    command.add_argument(
        "--cuda", action="store_true", help="also write NAME.cu: CUDA for the functions that take many configurations"
    )
    command.add_argument(
        "--derivatives",
        action="store_true",
        help="also a function NAME_vjp for every function: reverse mode, gradients by all that it takes",
    )
    command.add_argument(
        "--scalar",
        choices=list(SCALARS),
        default=DOUBLE.name,
        help="type of all numbers (default: double); float has no controller, no --derivatives, and half the digits",
    )
    command.add_argument("--no-build", action="store_true", help="write the sources only, do not compile")
    command.add_argument(
        "--force", action="store_true", help="replace a folder whose robot has other joints, tips or arguments"
    )
    command.add_argument(
        "--lock",
        metavar="JOINT=VALUE",
        action="append",
        type=_lock,
        default=[],
        help="hold a joint [rad or m]; repeatable",
    )
    command.add_argument(
        "--range",
        metavar="NAME=VALUE",
        action="append",
        type=_range,
        default=[],
        help="largest argument for which bounds of the rounding errors are stated; NAME is one of "
        f"{', '.join(field.name for field in fields(Ranges))}; repeatable (defaults: docs/accuracy.md)",
    )
    _add_springs(command)
    tool = _add_tool(command, "fixed at generation, or a pose that the functions take at run time")
    tool.add_argument("--tool", choices=["runtime"], help="functions take the tool's pose (4x4, in the tip) after q")
    command.set_defaults(run=_generate)

    _add_new(commands)

    command = commands.add_parser(
        "inspect", help="show a URDF's joints, what a chain to each tip has, and all problems"
    )
    command.add_argument("urdf", type=Path, metavar="URDF")
    command.add_argument("--tip", metavar="LINK", help="show the chain to this link (default: to every leaf link)")
    command.add_argument("--base", metavar="LINK", help="from this link (default: the one nearest the root)")
    command.set_defaults(run=_inspect)

    command = commands.add_parser("verify", help="check a robot's compiled kernels against independent oracles")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.add_argument("--urdf", type=Path, metavar="URDF", help="read the robot's file again and compare the chain")
    command.add_argument(
        "--samples", type=_positive, help="random postures (default: 200 up to 7 joints, fewer for more)"
    )
    command.add_argument("--seed", type=_natural, default=0, help="of the random postures (default: 0)")
    command.add_argument("--report", type=Path, metavar="FILE.html", help="write the evidence as one page")
    command.add_argument(
        "--proofs", type=Path, metavar="FILE", help="verdicts of 'stiffgen prove --json', for the page"
    )
    command.add_argument(
        "--targets", type=Path, metavar="FILE", help="what tests/campaigns/targets.py --json measured, for the page"
    )
    command.add_argument("--date", metavar="TEXT", help="a date to print on the page (default: none)")
    command.set_defaults(run=_verify)

    command = commands.add_parser("prove", help="prove of a robot's C, for all inputs, that it keeps to its contracts")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.add_argument("--part", choices=PARTS, action="append", help="a part alone (default: all); repeatable")
    command.add_argument(
        "--only", metavar="KERNEL", action="append", default=[], help="a kernel (hybrid_joint_stiffness); repeatable"
    )
    command.add_argument(
        "--timeout", type=float, default=300.0, metavar="S", help="for one function [s] (default: 300)"
    )
    command.add_argument("--json", type=Path, metavar="FILE", help="write the verdicts")
    command.set_defaults(run=_prove)

    command = commands.add_parser("bench", help="time a robot's compiled kernels on this machine")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.set_defaults(run=_bench)

    command = commands.add_parser("play", help="write a robot's playground, a page for the browser, and open it")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.add_argument("--output", type=Path, metavar="FILE.html", help="file to write (default: NAME.html)")
    command.add_argument("--no-open", action="store_true", help="write the page only")
    command.set_defaults(run=_play)

    _add_analyze(commands)
    return parser


def _add_tool(command: argparse.ArgumentParser, meaning: str) -> Any:
    tool = command.add_argument_group("tool", meaning)
    tool.add_argument("--tool-xyz", type=float, nargs=3, metavar=("X", "Y", "Z"), help="tool frame in the tip [m]")
    tool.add_argument("--tool-rpy", type=float, nargs=3, metavar=("R", "P", "Y"), help="its roll, pitch, yaw [rad]")
    tool.add_argument("--tool-mass", type=float, metavar="KG", help="mass of the tool")
    tool.add_argument(
        "--tool-com", type=float, nargs=3, metavar=("X", "Y", "Z"), help="its centre of mass in the tip [m]"
    )
    tool.add_argument(
        "--tool-inertia",
        type=float,
        nargs=6,
        metavar=("IXX", "IXY", "IXZ", "IYY", "IYZ", "IZZ"),
        help="its inertia about the centre of mass in the tip's axes [kg m^2]",
    )
    return tool


def _add_new(commands: Any) -> None:
    command = commands.add_parser(
        "new", help="write a project of your own: a 1 kHz loop, a simulated robot, a test, a script"
    )
    command.add_argument("urdf", type=Path, metavar="URDF")
    command.add_argument("--tip", metavar="LINK", help="link that touches things (needed where there are several)")
    command.add_argument("--base", metavar="LINK", help="first link of the chain (default: the root link)")
    command.add_argument("--controller", choices=list(CONTROLLERS), help="what closes the loop (default: impedance)")
    command.add_argument("--spring", choices=KINDS, help="of --controller spring (default: trace)")
    command.add_argument("--name", help="prefix of all C names and name of the module (default: the robot's name)")
    command.add_argument("--output", type=Path, metavar="DIR", help="folder to write (default: NAME_control)")
    command.add_argument("--no-build", action="store_true", help="do not compile the Python module")
    _add_tool(command, "mounted on the tip link (default: none)")
    command.set_defaults(run=_new, tool=None, no_masses=False)


def _add_springs(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("springs", "energies with torque and tangent, beside the one of every robot")
    group.add_argument(
        "--spring", choices=KINDS, action="append", default=[], help="another one (default: trace alone); repeatable"
    )
    group.add_argument(
        "--potential",
        metavar="FILE.py:FUNCTION",
        action="append",
        default=[],
        help="your own U(p, R, parameters) of CasADi expressions; the file is run; repeatable",
    )
    group.add_argument(
        "--translation-axes", choices=AXES, help="of the translation stiffness (default: base; coupled: equilibrium)"
    )
    group.add_argument(
        "--rotation-axes", choices=AXES, default="equilibrium", help="of the rotation stiffness (default: equilibrium)"
    )
    group.add_argument(
        "--spring-centre",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        default=(0.0, 0.0, 0.0),
        help="centre of stiffness in the tip's frame [m] (default: its origin)",
    )


def _springs(options: argparse.Namespace) -> SpringOptions:
    x, y, z = options.spring_centre
    if not all(map(math.isfinite, (x, y, z))):
        raise StiffgenError("--spring-centre must be three finite numbers")
    placement = Placement(options.translation_axes, options.rotation_axes, (x, y, z))
    potentials = tuple(map(read_potential, options.potential))
    return SpringOptions(tuple(options.spring), placement, potentials, options.derivatives)


def _add_analyze(commands: Any) -> None:
    """The fields of :class:`AnalysisOptions` as options; the recording is what stands without one."""
    command = commands.add_parser("analyze", help="joint stiffness along a recording, corrected and conventional")
    groups = {"": command} | {title: command.add_argument_group(title, text) for title, text in GROUPS.items()}
    for option in fields(AnalysisOptions):
        said = told(option)
        if said.command is None:
            continue
        more = dict(said.command)
        name, text = option.name.replace("_", "-"), said.meaning.replace("%", "%%")
        if isinstance(option.default, bool):
            names = [f"--no-{name}" if option.default else f"--{name}"]
            more |= {"dest": option.name, "action": "store_false" if option.default else "store_true"}
        elif option.name == "log":
            names = ["log"]
        else:
            names = [f"--{name}"]
            more |= {"default": option.default} if has_default(option) else {"required": True}
            text += "" if more.get("default") is None else " (default: %(default)s)"
        groups[said.group].add_argument(*names, help=text, **more)
    command.set_defaults(run=_analyze)


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def _lock(text: str) -> tuple[str, float]:
    joint, separator, value = text.rpartition("=")
    if not separator or not joint:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=VALUE")
    return joint, float(value)


def _range(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    known = [field.name for field in fields(Ranges)]
    if name not in known:
        raise argparse.ArgumentTypeError(f"'{text}' is none of the ranges {', '.join(known)}; write NAME=VALUE")
    try:
        size = float(value)
    except ValueError:
        size = math.nan
    if not 0 < size < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}': the largest {name} has to be a positive number")
    return name, size


def _locks(options: argparse.Namespace) -> dict[str, float]:
    names = [joint for joint, _ in options.lock]
    for joint in names:
        if names.count(joint) > 1:
            raise StiffgenError(f"--lock names joint '{printable(joint)}' twice; leave one of them out")
    return dict(options.lock)


def _tool(options: argparse.Namespace) -> Tool | None:
    given: dict[str, Any] = {}
    for field in ("xyz", "rpy", "mass", "com", "inertia"):
        value = getattr(options, f"tool_{field}")
        if value is not None:
            given[field] = tuple(value) if isinstance(value, list) else value
    if not given:
        return None
    if options.no_masses and given.keys() - {"xyz", "rpy"}:
        raise StiffgenError(
            "--no-masses ignores all masses; leave out --tool-mass, --tool-com and --tool-inertia, or it"
        )
    if options.tool == "runtime" and ("xyz" in given or "rpy" in given):
        raise StiffgenError("--tool runtime takes the tool's pose at run time; leave out --tool-xyz and --tool-rpy")
    return Tool(**given)


class _Progress:
    """Steps as a spinner on a terminal, as lines elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal else None

    def __call__(self, step: str) -> None:
        if self._status:
            self._status.update(escape(terminal_text(step)))
        else:
            self._console.print(f"{terminal_text(step)} ...", markup=False)

    @contextmanager
    def shown(self) -> Iterator[_Progress]:
        if self._status:
            with self._status:
                yield self
        else:
            yield self


def _generate(options: argparse.Namespace) -> int:
    console = _Console(stderr=True, highlight=False, soft_wrap=True)
    with _Progress(console).shown() as progress:
        folder = generate(
            options.urdf,
            tip=options.tip[0] if options.tip and len(options.tip) == 1 else options.tip,
            base=options.base,
            tool=_tool(options),
            runtime_tool=options.tool == "runtime",
            lock=_locks(options),
            name=options.name,
            output=options.output,
            build=not options.no_build,
            masses=not options.no_masses,
            cuda=options.cuda,
            springs=_springs(options),
            floating_base=options.floating_base,
            ranges=replace(Ranges(), **dict(options.range)),
            scalar=options.scalar,
            force=options.force,
            progress=progress,
        )
    print(folder)
    return 0


def _new(options: argparse.Namespace) -> int:
    tool = _tool(options)
    progress = _Progress(_Console(stderr=True, highlight=False, soft_wrap=True))
    with ExitStack() as spinner:

        def ready() -> None:  # the questions are answered
            spinner.enter_context(progress.shown())

        project = new_project(
            options.urdf,
            given=Given(options.tip, options.base, tool is not None, options.spring, options.controller),
            tool=tool,
            name=options.name,
            output=options.output,
            build=not options.no_build,
            ask=_ask if sys.stdin is not None and sys.stdin.isatty() else None,
            ready=ready,
            progress=progress,
        )
    print(project)
    return 0


def _ask(question: str) -> str:
    """On standard error, so that standard output holds the result alone."""
    print(f"{question} ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise StiffgenError("standard input ended before the questions did; give --tip, --controller and the like")
    return answer.rstrip("\n")


_MOST_TIPS = 100
"""Tips that ``inspect`` looks at; humanoids with hands have some 40."""


def _inspect(options: argparse.Namespace) -> int:
    try:
        description = read_description(options.urdf)
    except DescriptionError as error:
        raise StiffgenError(error.full) from error  # all problems, where other commands show the first ones
    console = _table_console()
    moving = sum(joint.type not in ("fixed",) for joint in description.joints.values())
    console.print(
        f"robot {comment(description.robot)}: {len(description.links)} links, {len(description.joints)} joints "
        f"({moving} moving), root link {comment(description.root)}",
        markup=False,
    )
    console.print(_joint_table(description))
    tips = description.leaves if options.tip is None else [options.tip]
    surveys = [survey_tip(description, tip, options.base) for tip in tips[:_MOST_TIPS]]
    console.print()
    console.print(_tip_table(surveys, names=20 if options.tip else 4))
    if len(tips) > _MOST_TIPS:
        console.print(f"and {len(tips) - _MOST_TIPS} more tips; --tip shows one", markup=False)
    if not description.problems:
        return 0
    print(f"\n{len(description.problems)} problems; each refuses the chains that it can change, and leaves the others:")
    print("\n".join(f"  {problem.text}" for problem in description.problems))
    return 1


def _tip_table(surveys: list[TipSurvey], names: int) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for column in ("tip", "base", "coordinates (q)", "left out of q"):
        table.add_column(column)
    for survey in surveys:
        coordinates = f"{len(survey.coordinates)}: {listed(survey.coordinates)}" if survey.coordinates else ""
        lines = [coordinates, survey.hindrance] if survey.hindrance else [coordinates]
        table.add_row(
            escape(comment(survey.tip)),
            escape(comment(survey.base) + (", which floats" if survey.floating else "")),
            escape("\n".join(filter(None, lines))),
            escape("\n".join(f"{what}: {len(joints)} ({listed(joints, names)})" for what, joints in survey.left_out)),
        )
    return table


def _joint_table(description: Description) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for column in ("joint", "type", "axis", "lower", "upper", "velocity", "effort", "parent", "link", "mass [kg]"):
        table.add_column(
            escape(column),
            justify="right" if column in ("lower", "upper", "velocity", "effort", "mass [kg]") else "left",
        )
    for joint in _from_root(description):
        inertial = description.inertials[joint.child]
        limits = (joint.lower, joint.upper, joint.velocity, joint.effort)
        moves = joint.type in ("revolute", "continuous", "prismatic")
        kind = joint.type if joint.mimic is None else f"{joint.type}, mimics {comment(joint.mimic.joint)}"
        table.add_row(
            escape(comment(joint.name)),
            escape(kind),
            " ".join(f"{value:.4g}" for value in joint.axis) if moves else "",
            *(f"{value:.6g}" if moves and math.isfinite(value) else "" for value in limits),
            escape(comment(joint.parent)),
            escape(comment(joint.child)),
            "" if inertial is None else f"{inertial.mass:.6g}",
        )
    return table


def _from_root(description: Description) -> Iterator[JointElement]:
    """Joints depth first from the root, so that a chain stands in order."""
    below: dict[str, list[JointElement]] = {}
    for joint in description.joints.values():
        below.setdefault(joint.parent, []).append(joint)
    stack = list(reversed(below.get(description.root, [])))
    while stack:
        joint = stack.pop()
        yield joint
        stack.extend(reversed(below.get(joint.child, [])))


def _verify(options: argparse.Namespace) -> int:
    console = _Console(stderr=True, highlight=False)
    if options.report is None and any(each is not None for each in (options.proofs, options.targets, options.date)):
        raise StiffgenError("--proofs, --targets and --date are for the page; give --report FILE.html, too")
    if options.report is not None:
        open_robot(options.folder).require_doubles("the page of --report")
    if options.proofs is not None:  # before the long part
        filed_for(open_robot(options.folder), options.proofs)
    if options.targets is not None:
        targets_for(open_robot(options.folder), options.targets)
    with _Progress(console).shown() as progress:
        checks = verify(options.folder, urdf=options.urdf, count=options.samples, seed=options.seed, progress=progress)
    failed = [check for check in checks if not check.passed]
    _table_console().print(_check_table(checks))
    for check in failed:
        if check.detail:
            print(f"{check.kernel}, {check.oracle}: {check.detail}")
    print(f"{len(checks) - len(failed)} of {len(checks)} comparisons within their bound")
    if options.urdf is None:
        print("the chain is the manifest's; --urdf URDF compares it with the robot's file")
    if options.report is not None:
        write_safety_page(
            options.folder,
            checks,
            options.report,
            postures=options.samples or default_count(open_robot(options.folder).chain),
            seed=options.seed,
            urdf=options.urdf,
            proofs=options.proofs,
            targets=options.targets,
            date=options.date,
        )
        print(options.report)
    return 1 if failed else 0


def _prove(options: argparse.Namespace) -> int:
    with _Progress(_Console(stderr=True, highlight=False)).shown() as progress:
        verdicts = prove(
            options.folder,
            parts=tuple(options.part or PARTS),
            only=tuple(options.only),
            timeout=options.timeout,
            json=options.json,
            progress=progress,
        )
    table = Table(show_edge=False, pad_edge=False)
    for column in ("function", "for all inputs", "by", "time [s]", ""):
        table.add_column(column, justify="right" if column == "time [s]" else "left")
    for each in verdicts:
        table.add_row(each.function, each.claims, each.tool, f"{each.seconds:.1f}", each.outcome)
    _table_console().print(table)
    tally = {outcome: sum(each.outcome == outcome for each in verdicts) for outcome in get_args(Outcome)}
    for each in verdicts:
        if each.outcome != "proved":
            print(f"{each.outcome}: {each.function}, by {each.tool}: {each.detail}")
    print(", ".join(f"{count} {outcome}" for outcome, count in tally.items()))
    if options.json is not None:
        print(options.json)
    return 1 if tally["FAILED"] else 0


def _bench(options: argparse.Namespace) -> int:
    console = _Console(stderr=True, highlight=False)
    with _Progress(console).shown() as progress:
        timings = bench(options.folder, progress=progress)
    table = Table(show_edge=False, pad_edge=False)
    for column in ("kernel", "Python call [us]", "of a stack of 4096 [us]", "C call [us]"):
        table.add_column(column, justify="left" if column == "kernel" else "right")
    for timing in timings:
        c = f"{timing.c:.3f}" if math.isfinite(timing.c) else "no compiler"
        table.add_row(timing.kernel, f"{timing.call:.2f}", f"{timing.configuration:.3f}", c)
    _table_console().print(table)
    return 0


def _play(options: argparse.Namespace) -> int:
    with _Progress(_Console(stderr=True, highlight=False, soft_wrap=True)).shown() as progress:
        page = write_page(options.folder, options.output, progress)
    print(page)
    if not options.no_open and _has_screen() and not webbrowser.open(page.resolve().as_uri()):
        print("stiffgen: warning: no browser was found; open the file in one", file=sys.stderr)
    return 0


def _has_screen() -> bool:
    """Whether a browser can show itself; elsewhere one that runs in the terminal would take the terminal."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class _Bar:
    """A progress bar on a terminal; elsewhere a line for each step and each tenth."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            "{task.description}",
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task("", total=1.0)
        self._said = ("", -1)

    def __call__(self, step: str, done: float) -> None:
        if self._console.is_terminal:
            self._bar.update(self._task, description=escape(terminal_text(step)), completed=done)
            return
        now = (step, int(10 * done))
        if now != self._said:
            self._said = now
            self._console.print(f"{terminal_text(step)} ..." + (f" {10 * now[1]} %" if now[1] else ""), markup=False)

    @contextmanager
    def shown(self) -> Iterator[_Bar]:
        with self._bar:
            yield self


def _analyze(options: argparse.Namespace) -> int:
    # Six numbers, or one name of a file; anything else is refused with the reason.
    stiffness = options.task_stiffness
    K = read_stiffness(stiffness[0]) if len(stiffness) == 1 else checked_stiffness(stiffness)
    chosen = {each.name: getattr(options, each.name) for each in fields(AnalysisOptions) if each.name in options}
    with _Bar(_Console(stderr=True, highlight=False, soft_wrap=True)).shown() as progress:
        try:
            analysis = analyze(**chosen | {"task_stiffness": K, "progress": progress})
        except EmptyRecordingError as error:
            print(f"stiffgen: {terminal_text(str(error))}", file=sys.stderr)
            return 1
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    shown = [k for k, column in enumerate(TABLE_HEAD) if column not in ("mean", "least at", "most at")]
    for column in (TABLE_HEAD[k] for k in shown):
        words = column in ("quantity", "unit")
        table.add_column(column, justify="left" if words else "right", no_wrap=column != "quantity")
    for row in table_rows(analysis.summary):
        table.add_row(*(escape(row[k]) for k in shown))
    console = _Console(highlight=False)
    (console if console.is_terminal else _Console(highlight=False, width=80)).print(table)
    print(terminal_text("\n".join(statements(analysis.recording, analysis.result, analysis.summary))))
    for line in recording_warnings(analysis.recording, analysis.result):
        print(f"stiffgen: warning: {terminal_text(line)}", file=sys.stderr)
    print(terminal_text(str(analysis.folder / ("report.html" if options.figures else SUMMARY))))
    return 0


def _table_console() -> Console:
    """Standard output; wide enough for a whole table where no terminal sets a width."""
    console = _Console(highlight=False)
    return console if console.is_terminal else _Console(highlight=False, width=200)


def _check_table(checks: list[Check]) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for column in ("kernel", "held against", "worst relative error", "bound", ""):
        table.add_column(column, justify="right" if column in ("worst relative error", "bound") else "left")
    for check in checks:
        table.add_row(
            check.kernel, check.oracle, f"{check.error:.1e}", f"{check.bound:.0e}", "ok" if check.passed else "FAILED"
        )
    return table


if __name__ == "__main__":
    sys.exit(main())
