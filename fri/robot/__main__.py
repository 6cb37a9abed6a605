# SPDX-License-Identifier: MIT
"""Run the robot: python -m fri.robot --protocol 2.7 --lockstep --duration 15 --bowl.

Exit code 0 after a session that ended as planned, 1 if it did not, 2 if something was refused at the start.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

try:
    import mujoco  # noqa: F401
    import numpy as np
    from google import protobuf  # noqa: F401
except ImportError as error:
    print(f"{error.name} is not installed: pip install -e '.[examples]'", file=sys.stderr)
    sys.exit(2)

from rich.console import Console
from rich.live import Live
from rich.text import Text

from examples.bowl_wiping.bowl import bowl_plant
from examples.experiments.plant import MOTOR_INERTIA
from stiffgen import StiffgenError, open_robot

from . import faults
from .cycles import Settings
from .emulator import Emulator
from .link import Link, LinkError
from .messages import (
    JOINTS,
    VERSIONS,
    CommandMode,
    IODirection,
    IOType,
    IOValue,
    Protocol,
    SessionState,
)
from .record import Recorder, digest
from .robot import Robot
from .session import Policy, Session

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "build" / "robots" / "iiwa14_plate"
TIMESTEP = 0.001
"""Time step [s] of the controller and the plant, whatever the send period."""


class RefusedError(Exception):
    """Refusal of an option; the text names the option and the remedy."""


def arguments() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m fri.robot",
        description="A simulated LBR iiwa 14 that speaks FRI. Start a client on the same port, in any order.",
        epilog=f"Faults: {faults.__doc__.split('A specification', 1)[1]}" if faults.__doc__ else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--protocol", choices=VERSIONS, required=True, help="FRI version")
    add("--host", default="127.0.0.1", help="IPv4 address of the client (%(default)s)")
    add("--port", type=int, default=30200, help="port of the client (%(default)s)")
    add("--robot-host", default="", metavar="ADDRESS", help="IPv4 address that the robot sends from (any)")
    add("--robot-port", type=int, default=0, metavar="PORT", help="port that the robot sends from (any free one)")
    add("--send-period", type=int, default=5, metavar="MS", help="1 to 10 ms (%(default)s)")
    add(
        "--receive-multiplier",
        type=int,
        default=1,
        metavar="N",
        help="the client answers every N messages (%(default)s)",
    )
    add(
        "--lockstep",
        action="store_true",
        help="wait for each answer instead of for the clock: repeatable to the last bit",
    )
    add("--duration", type=float, default=15.0, metavar="S", help="time in COMMANDING_ACTIVE (%(default)s)")
    add(
        "--command-mode",
        choices=("torque", "position"),
        default="torque",
        help="what the client commands (%(default)s)",
    )
    add("--stiffness", type=float, nargs="+", default=[0.0], metavar="K",
        help="stiffness of the joint impedance control, one or seven [N m/rad] (0)")  # fmt: skip
    add("--bowl", action="store_true", help="put the bowl under the tool")
    add("--weight", type=float, default=0.0, metavar="KG", help="hang a weight at the tip [kg] (0)")
    add("--sensor-port", type=int, default=0, metavar="PORT",
        help="port that the sensor sends its readings to (none)")  # fmt: skip
    add("--start", type=float, nargs=JOINTS, metavar="Q", help="joint positions at the start [rad] (the experiment's)")
    add("--press-button", type=float, nargs=2, metavar=("FROM", "TO"), help="press MediaFlange.UserButton [s]")
    add(
        "--io",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an output: true or false, 3, or 0.5; may be repeated",
    )
    add("--thresholds", type=float, nargs=3, default=[Policy.excellent, Policy.good, Policy.fair],
        metavar=("EXCELLENT", "GOOD", "FAIR"), help="share of answers in time for each (%(default)s)")  # fmt: skip
    add(
        "--restarts",
        type=int,
        default=3,
        metavar="N",
        help="how often a broken-off motion is started again (%(default)s)",
    )
    add("--answer-timeout", type=float, default=20.0, metavar="S",
        help="wall time to wait for a client and, in lockstep, for an answer (%(default)s)")  # fmt: skip
    add(
        "--robot",
        type=Path,
        default=ROBOT,
        metavar="DIR",
        help="the generated robot with its tool (build/robots/iiwa14_plate)",
    )
    add("--faults", default="", metavar="SPEC", help="faults, see below")
    add(
        "--deaf",
        action="store_true",
        help="do not notice when the client closes its port: silence alone tells, as behind a firewall",
    )
    add("--seed", type=int, default=0, metavar="N", help="seed of random faults (%(default)s)")
    add("--log", type=Path, metavar="FILE.npz", help="write what was sent and received in each cycle")
    add("--summary", type=Path, metavar="FILE.json", help="write the counts of the session")
    return parser


def load_robot(folder: Path) -> ModuleType:
    """Load the generated Python module of the robot with its tool.

    Raises
    ------
    RefusedError
        The folder has no generated robot, or one without a sensor.

    """
    if not (folder / "__init__.py").is_file():
        raise RefusedError(
            f"no generated robot in {folder}: run 'make build/robots/iiwa14_plate', or name another with --robot"
        )
    module = open_robot(folder).module
    if not hasattr(module, "sensor"):
        raise RefusedError(
            f"the robot in {folder} has no force-torque sensor: run 'make build/robots/iiwa14_plate', or generate it "
            "with --sensor link_ee --sensor sign=robot"
        )
    return module


def _check(options: argparse.Namespace) -> None:
    """Refuse options that are out of range, before the session starts."""
    if not 1 <= options.send_period <= 10:
        raise RefusedError(f"--send-period {options.send_period}: commanding takes 1 to 10 ms")
    if not 1 <= options.receive_multiplier <= 100:
        raise RefusedError(f"--receive-multiplier {options.receive_multiplier}: takes 1 to 100")
    if not 1 <= options.port <= 65535:
        raise RefusedError(f"--port {options.port}: takes 1 to 65535; KUKA's default is 30200")
    if not 0 <= options.sensor_port <= 65535:
        raise RefusedError(f"--sensor-port {options.sensor_port}: takes 0 to 65535; 0 is none")
    if not 0 <= options.weight <= 10:
        raise RefusedError(f"--weight {options.weight}: takes 0 to 10 kg")
    if not 0 <= options.robot_port <= 65535:
        raise RefusedError(f"--robot-port {options.robot_port}: takes 0 to 65535; 0 is any free one")
    for name in ("duration", "answer_timeout"):
        if not 0 < getattr(options, name) < float("inf"):
            raise RefusedError(
                f"--{name.replace('_', '-')} {getattr(options, name)}: takes a positive number of seconds"
            )
    if len(options.stiffness) not in (1, JOINTS):
        raise RefusedError(f"--stiffness: takes one number or {JOINTS}, not {len(options.stiffness)}")
    if not all(0 <= k < float("inf") for k in options.stiffness):
        raise RefusedError("--stiffness: takes numbers that are not negative")
    if options.restarts < 0 or options.seed < 0:
        raise RefusedError("--restarts and --seed: take numbers that are not negative")
    if not 1 >= options.thresholds[0] >= options.thresholds[1] >= options.thresholds[2] > 0:
        raise RefusedError("--thresholds: take three shares from 1 down to 0, falling")
    for name in ("log", "summary"):
        file = getattr(options, name)
        if file and not file.absolute().parent.is_dir():
            raise RefusedError(f"--{name} {file}: there is no folder {file.parent}")


def _io(text: str) -> IOValue:
    """Parse Group.Name=VALUE into an output: true or false, a whole number, or another number."""
    name, _, value = text.partition("=")
    try:
        if not 0 < len(name) <= 63:
            raise ValueError(name)
        if value in ("true", "false"):
            return IOValue(name, IOType.BOOLEAN, IODirection.OUTPUT, value == "true")
        if value.isdecimal():
            return IOValue(name, IOType.DIGITAL, IODirection.OUTPUT, int(value))
        return IOValue(name, IOType.ANALOG, IODirection.OUTPUT, float(value))
    except ValueError as error:
        raise RefusedError(f"--io {text}: takes Group.Name=true, =false, =3 or =0.5") from error


def _robot(options: argparse.Namespace, policy: Policy) -> Robot:
    """Return the emulated robot in the bowl, with the weight [kg] hung on it."""
    model = load_robot(options.robot)
    start = {} if options.start is None else {"q": options.start}
    if options.start and not ((np.array(options.start) > model.LOWER) & (np.array(options.start) < model.UPPER)).all():
        raise RefusedError("--start: a joint is beyond its limits")
    mode = CommandMode[options.command_mode.upper()]
    stiffness = np.broadcast_to(np.array(options.stiffness, dtype=float), JOINTS).copy()
    plant = bowl_plant(TIMESTEP, surface=options.bowl, **start)
    plant.hang(options.weight)
    return Robot(plant, model, MOTOR_INERTIA, stiffness, mode, policy)


def summary(options: argparse.Namespace, emulator: Emulator, recorder: Recorder | None) -> dict[str, Any]:
    """Return the figures of a session, for JSON."""
    session, statistics = emulator.session, emulator.statistics
    return {
        "protocol": options.protocol,
        "send_period_ms": options.send_period,
        "receive_multiplier": options.receive_multiplier,
        "lockstep": options.lockstep,
        "seed": options.seed,
        "end": session.failure or "as planned",
        "robot_time_s": emulator.time,
        "commanding_active_s": session.active_time,
        "motions_broken_off": session.broken,
        "sent": statistics.sent,
        "received": statistics.received,
        "accepted": statistics.accepted,
        "rejected": dict(statistics.rejected),
        "missing_answers": emulator.meter.missing,
        "forced_states": emulator.forced_states,
        "faults": {direction: dict(injector.counts) for direction, injector in emulator.injectors.items()},
        "contact_share": statistics.in_contact / max(statistics.observed, 1),
        "largest_force_n": statistics.largest_force,
        "worst_latency_s": statistics.worst_latency,
        "overruns": statistics.overruns,
        "slip_s": statistics.slip,
        "digest": digest(recorder.rows) if recorder else None,
    }


@contextlib.contextmanager
def _status_line(console: Console, emulator: Emulator) -> Iterator[None]:
    """Show one line that follows the session on a terminal; rich draws it from a thread of its own."""
    if not console.is_terminal:
        yield
        return

    def line() -> Text:
        """Return the line of the display: state, quality, time, counts and force [N]."""
        session, statistics = emulator.session, emulator.statistics
        contact = "contact" if emulator.in_contact else "free"
        force = float(np.linalg.norm(emulator.wrench[:3]))
        return Text(
            f"{session.state.name:17s} {session.quality.name:9s} {emulator.time:8.2f} s  cycles {statistics.sent}  "
            f"lost {emulator.meter.missing}  rejected {statistics.rejected.total()}  {contact} {force:5.1f} N",
            style="bold" if session.state is SessionState.COMMANDING_ACTIVE else "",
            no_wrap=True,
        )

    with Live(get_renderable=line, console=console, refresh_per_second=5, transient=True):
        yield


def run(options: argparse.Namespace, console: Console) -> int:
    """Run one session; return the exit code.

    Raises
    ------
    RefusedError, LinkError, FaultError, StiffgenError
        Something cannot be used, or no client came.

    """
    _check(options)
    excellent, good, fair = options.thresholds
    policy = Policy(excellent=excellent, good=good, fair=fair)
    plan = faults.parse_faults(options.faults, options.protocol)
    settings = Settings(
        period=options.send_period,
        multiplier=options.receive_multiplier,
        lockstep=options.lockstep,
        mode=CommandMode[options.command_mode.upper()],
        answer_timeout=options.answer_timeout,
        button=tuple(options.press_button) if options.press_button else None,
        ios=tuple(map(_io, options.io)),
        sensor_port=options.sensor_port,
    )
    robot = _robot(options, policy)
    recorder = Recorder() if options.log else None

    def report(old: SessionState, new: SessionState, reason: str) -> None:
        console.print(f"{emulator.time:9.3f} s  {old.name} -> {new.name}  ({reason})", highlight=False, soft_wrap=True)

    session = Session(options.send_period / 1000, policy, options.duration, options.restarts, report)
    link = Link(options.host, options.port, options.deaf, (options.robot_host, options.robot_port))
    emulator = Emulator(
        link, Protocol(options.protocol), robot, session, policy, settings, plan, options.seed, recorder
    )
    interrupted = {signal.SIGINT, signal.SIGTERM}
    before = {number: signal.signal(number, lambda *_: emulator.interrupt()) for number in interrupted}
    try:
        with _status_line(console, emulator):
            emulator.run()
    finally:
        link.close()
        for number, handler in before.items():
            signal.signal(number, handler)
    result = summary(options, emulator, recorder)
    if recorder:
        recorder.write(options.log, result)
    if options.summary:
        options.summary.write_text(json.dumps(result, indent=2) + "\n")
    _print(console, result)
    return 0 if session.failure is None else 1


def _print(console: Console, result: dict[str, Any]) -> None:
    """Print the result of a session."""
    counts = {f"{d}.{kind}": n for d, kinds in result["faults"].items() for kind, n in kinds.items()}
    lines = [
        f"session ended {result['end']}" if result["end"] == "as planned" else f"session failed: {result['end']}",
        f"{result['sent']} sent, {result['accepted']} commands accepted, {result['missing_answers']} answers missing, "
        f"{sum(result['rejected'].values())} datagrams rejected",
        f"{result['commanding_active_s']:.2f} s commanded, contact {100 * result['contact_share']:.1f} % of it, "
        f"largest force {result['largest_force_n']:.1f} N",
    ]
    if counts:
        lines.append("faults put in: " + ", ".join(f"{name} {n}" for name, n in sorted(counts.items())))
    if not result["lockstep"]:
        lines.append(f"late cycles of the emulator: {result['overruns']}, by {1000 * result['slip_s']:.1f} ms in all")
    if result["digest"]:
        lines.append(f"digest {result['digest']}")
    console.print("\n".join(lines), highlight=False, soft_wrap=True)


def main() -> int:
    """Run the command line; return the exit code."""
    options = arguments().parse_args()
    try:
        return run(options, Console())
    except (RefusedError, LinkError, faults.FaultError, StiffgenError) as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
