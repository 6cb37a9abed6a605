"""The command line: ``stiffgen generate | inspect | verify | bench``.

Exit code 0: done; 1: a check failed; 2: refused input or usage. Refusals are one message on standard error.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

import stiffgen
from stiffgen.bench import bench
from stiffgen.description import Description, JointElement, read_description
from stiffgen.emit.names import comment
from stiffgen.errors import StiffgenError
from stiffgen.generate import generate
from stiffgen.verify import Check, verify


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    try:
        return int(options.run(options))
    except StiffgenError as error:
        errors.print(f"stiffgen: {error}", markup=False)
        return 2
    except KeyboardInterrupt:
        errors.print("stiffgen: interrupted")
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="stiffgen", description=stiffgen.__doc__)
    parser.add_argument("--version", action="version", version=f"stiffgen {stiffgen.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("generate", help="write a robot's folder of C code and its Python module")
    command.add_argument("urdf", type=Path, metavar="URDF")
    command.add_argument("--tip", metavar="LINK", help="link where the wrench acts (default: the only leaf link)")
    command.add_argument("--base", metavar="LINK", help="first link of the chain (default: the root link)")
    command.add_argument("--name", help="prefix of all C names and name of the module (default: the robot's name)")
    command.add_argument("--output", type=Path, default=Path("generated"), metavar="DIR", help="default: generated")
    command.add_argument("--no-build", action="store_true", help="write the sources only, do not compile")
    command.set_defaults(run=_generate)

    command = commands.add_parser("inspect", help="show a URDF's chain, its tips and all its problems")
    command.add_argument("urdf", type=Path, metavar="URDF")
    command.set_defaults(run=_inspect)

    command = commands.add_parser("verify", help="check a robot's compiled kernels against independent oracles")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.add_argument("--samples", type=_positive, default=200, help="random postures (default: 200)")
    command.add_argument("--seed", type=int, default=0, help="of the random postures (default: 0)")
    command.set_defaults(run=_verify)

    command = commands.add_parser("bench", help="time a robot's compiled kernels on this machine")
    command.add_argument("folder", type=Path, metavar="DIR", help="a folder that 'stiffgen generate' wrote")
    command.set_defaults(run=_bench)
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


class _Progress:
    """Steps as a spinner on a terminal, as lines elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal else None

    def __call__(self, step: str) -> None:
        if self._status:
            self._status.update(escape(step))
        else:
            self._console.print(f"{step} ...", markup=False)

    @contextmanager
    def shown(self) -> Iterator[_Progress]:
        if self._status:
            with self._status:
                yield self
        else:
            yield self


def _generate(options: argparse.Namespace) -> int:
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    with _Progress(console).shown() as progress:
        folder = generate(
            options.urdf,
            tip=options.tip,
            base=options.base,
            name=options.name,
            output=options.output,
            build=not options.no_build,
            progress=progress,
        )
    print(folder)
    return 0


def _inspect(options: argparse.Namespace) -> int:
    description = read_description(options.urdf)
    console = _table_console()
    moving = sum(joint.type not in ("fixed",) for joint in description.joints.values())
    console.print(
        f"robot {comment(description.robot)}: {len(description.links)} links, {len(description.joints)} joints "
        f"({moving} moving), root link {comment(description.root)}",
        markup=False,
    )
    console.print(_joint_table(description))
    console.print("tips (leaf links): " + ", ".join(comment(leaf) for leaf in description.leaves), markup=False)
    if not description.problems:
        return 0
    console.print(f"{len(description.problems)} problems, each of which refuses the chains that use the element:")
    for problem in description.problems:
        console.print(f"  {problem.text}", markup=False, soft_wrap=True)
    return 1


def _joint_table(description: Description) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for column in ("joint", "type", "axis", "lower", "upper", "velocity", "effort", "link", "mass [kg]"):
        table.add_column(
            column, justify="right" if column in ("lower", "upper", "velocity", "effort", "mass [kg]") else "left"
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
    console = Console(stderr=True, highlight=False)
    with _Progress(console).shown() as progress:
        checks = verify(options.folder, count=options.samples, seed=options.seed, progress=progress)
    failed = [check for check in checks if not check.passed]
    _table_console().print(_check_table(checks))
    print(f"{len(checks) - len(failed)} of {len(checks)} comparisons within their bound, {options.samples} postures")
    return 1 if failed else 0


def _bench(options: argparse.Namespace) -> int:
    console = Console(stderr=True, highlight=False)
    with _Progress(console).shown() as progress:
        timings = bench(options.folder, progress=progress)
    table = Table(show_edge=False, pad_edge=False)
    for column in ("kernel", "one Python call [us]", "in a stack of 4096 [us]"):
        table.add_column(column, justify="left" if column == "kernel" else "right")
    for timing in timings:
        table.add_row(timing.kernel, f"{timing.call:.2f}", f"{timing.configuration:.3f}")
    _table_console().print(table)
    return 0


def _table_console() -> Console:
    """Standard output; wide enough for a whole table where no terminal sets a width."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=200)


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
