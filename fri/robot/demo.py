# SPDX-License-Identifier: MIT
"""Wipe the bowl once through FRI: python -m fri.robot.demo, or make fri-demo.

Builds the C++ client, starts it and the simulated robot in lockstep, waits for both, holds what the robot received
against the controller stepped in Python, and draws the session. Everything goes to build/fri-demo.

Exit code 0, 1 if the session did not go as it should, 2 if something is missing or refused.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import shutil
import signal
import subprocess
import sys
import time as wall
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

try:
    import cmake
    import matplotlib as mpl
    import mujoco  # noqa: F401
    import numpy as np
    from google import protobuf  # noqa: F401
except ImportError as error:
    print(f"{error.name} is not installed: pip install -e '.[examples]'", file=sys.stderr)
    sys.exit(2)

from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from examples.style import AXES, CONVENTIONAL, CORRECTED, INK, SHADES, STYLE, themed_svg
from stiffgen import StiffgenError

from .__main__ import ROBOT, ROOT, RefusedError, load_robot
from .messages import VERSIONS, SessionState
from .replay import ClientLog, check_commands, compare, read_client_log

CLIENT = ROOT / "fri" / "client"
TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
OUTPUT = ROOT / "build" / "fri-demo"
APPROACH = 5.0
"""Time that the client takes to reach the trajectory [s]."""
TRAJECTORY_TIME = 13.96
"""Duration of the trajectory [s]."""
REST = 0.24
"""Pause after the trajectory [s]."""
LONGEST = 600.0
"""Wall time after which the demo gives up [s]."""


class BrokenOffError(Exception):
    """The session did not go as it should; the text says why."""


def arguments() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m fri.robot.demo", description="Wipe the bowl once through FRI, with no robot."
    )
    add = parser.add_argument
    add("--protocol", choices=VERSIONS, default="2.7", help="FRI version (%(default)s)")
    add("--port", type=int, default=30200, help="UDP port of the client (%(default)s)")
    add("--send-period", type=int, default=5, metavar="MS", help="1 to 10 ms (%(default)s)")
    add("--wall-clock", action="store_true", help="in real time instead of in lockstep")
    add("--robot", type=Path, default=ROBOT, metavar="DIR", help="the generated robot (build/robots/iiwa14_plate)")
    add("--output", type=Path, default=OUTPUT, metavar="DIR", help="for logs and figures (build/fri-demo)")
    return parser


def _die_with_parent() -> None:
    """End this child with the demo, however the demo ends (on Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)


@contextlib.contextmanager
def child(command: list[str], **files: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that does not outlive the block."""
    process = subprocess.Popen(command, cwd=ROOT, preexec_fn=_die_with_parent, **files)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def build_client(robot: Path, version: str, folder: Path, say: Callable[[str], None]) -> Path:
    """Configure and build the client with the machine's instructions, as the NumPy module is built; return the program.

    Parameters
    ----------
    robot, version, folder
        Folder of the generated robot, FRI version, folder of the build.
    say
        Called with each line of the build, which takes up to four minutes.

    Raises
    ------
    RefusedError
        A tool is missing, or it does not build; the text ends with the last lines.

    """
    if not shutil.which("c++") and not shutil.which("g++"):
        raise RefusedError("no C++ compiler (Debian: apt-get install g++ make)")
    program = str(Path(cmake.CMAKE_BIN_DIR) / "cmake")
    name = robot.name
    options = [f"-DOPEN_FRI_VERSION={version}", f"-DROBOT_DIR={robot}", f"-DROBOT_NAME={name}"]
    options += [f"-D{name.upper()}_NATIVE=ON", "-DCMAKE_BUILD_TYPE=Release"]
    for command in (
        [program, "-S", str(CLIENT), "-B", str(folder), *options],
        [program, "--build", str(folder), "-j2"],
    ):
        lines = []
        pipe: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        with subprocess.Popen(command, **pipe) as process:
            for line in process.stdout or ():
                lines.append(line.rstrip())
                say(lines[-1])
        if process.returncode:
            last = "\n".join(lines[-15:])
            raise RefusedError(f"the client does not build:\n{last}")
    return folder / "fri_wiping"


def run_session(options: argparse.Namespace, client: Path) -> None:
    """Run client and robot until both have ended.

    Raises
    ------
    RefusedError, BrokenOffError
        One of them refused something, or the session failed.

    """
    folder = options.output
    said = folder / "client.txt"
    duration = APPROACH + TRAJECTORY_TIME + REST
    wiping = [str(client), "--trajectory", str(TRAJECTORY), "--port", str(options.port), "--approach", str(APPROACH)]
    for name in ("client.csv", "client.json"):
        (folder / name).unlink(missing_ok=True)  # the client overwrites no log
    wiping += ["--log", str(folder / "client.csv"), "--summary", str(folder / "client.json")]
    wiping += [] if options.wall_clock else ["--simulated-time"]
    robot = [sys.executable, "-m", "fri.robot", "--protocol", options.protocol, "--port", str(options.port)]
    robot += ["--robot", str(options.robot), "--send-period", str(options.send_period), "--bowl", "--duration"]
    robot += [str(duration), "--log", str(folder / "robot.npz"), "--summary", str(folder / "robot.json")]
    robot += [] if options.wall_clock else ["--lockstep"]
    deadline = wall.monotonic() + LONGEST
    with said.open("wb") as output, child(wiping, stdout=output, stderr=output) as first, child(robot) as second:
        try:
            while second.poll() is None:
                if first.poll():  # refused or failed; the robot notices, unless it still waits for a client
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        second.wait(2.0)
                    break
                if wall.monotonic() > deadline:
                    raise BrokenOffError(f"the session did not end within {LONGEST:g} s")
                wall.sleep(0.05)
            client_code = first.wait(max(0.1, min(10.0, deadline - wall.monotonic())))
        except subprocess.TimeoutExpired as error:
            raise BrokenOffError("the client did not end with the session") from error
    robot_code = second.poll()
    if client_code or robot_code:
        last = "\n".join(said.read_text().strip().splitlines()[-1:])
        if client_code == 2:
            raise RefusedError(last)
        codes = f"exit code of the client {client_code}, of the robot {robot_code}"
        raise BrokenOffError(f"{codes}. The client's last words: {last}")


def antisymmetric_parts(robot: ModuleType, log: ClientLog) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the largest singular values [N m/rad] of the antisymmetric part of Kq at the client's states: (steps,).

    The first of the corrected formula, the second of the conventional one, from the generated kernels.
    """
    K = np.diag(log.summary["controller"]["task_stiffness"])
    kernels = robot.hybrid
    parts = []
    for stiffness in (kernels.joint_stiffness, kernels.joint_stiffness_uncorrected):
        Kq = stiffness(log["q"], log["wrench"], K)
        parts.append(np.linalg.norm((Kq - np.swapaxes(Kq, 1, 2)) / 2, 2, axis=(1, 2)))
    return parts[0], parts[1]


def draw(log: ClientLog, received: Mapping[str, NDArray[Any]], parts: tuple[NDArray[Any], NDArray[Any]]) -> str:
    """Draw the session as SVG: joint positions, torque on the wire, wrench estimated and true, antisymmetric part."""
    every = slice(None, None, max(1, len(log) // 400))
    time = log["time"][every]
    row = np.rint(log["time"] / log.summary["sample_time"]).astype(int)[every]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 7.0), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True)
        (joints, torque), (wrench, stiffness) = panels
        for joint, colour in enumerate(SHADES):
            joints.plot(time, np.degrees(log["q"][every, joint]), color=colour, label=f"A{joint + 1}")
            joints.plot(time, np.degrees(log["q0"][every, joint]), ":", color=colour)
            torque.plot(time, received["command_torque"][row, joint], color=colour)
        joints.plot([], [], color=INK, label="measured")
        joints.plot([], [], ":", color=INK, label="zero-force")
        joints.set(ylabel="[deg]", title="joint positions")
        torque.set(ylabel="[N m]", title="joint torques that the robot received")
        for axis, colour in enumerate(AXES):
            # The estimate shows on both sides of the simulation's thin line, which lies upon it.
            estimated = f"{'xyz'[axis]}, estimated"
            wrench.plot(time, log["wrench"][every, axis], color=colour, linewidth=2.4, label=estimated)
            wrench.plot(
                time, received["wrench"][row, axis], ":", color=INK, linewidth=0.9,
                label="in the simulation" if axis == 2 else None,
            )  # fmt: skip
        wrench.set(ylabel="[N]", xlabel="time [s]", title="force on the tool, base axes")
        stiffness.plot(time, parts[1][every], "--", color=CONVENTIONAL, label="conventional formula")
        stiffness.plot(time, parts[0][every], color=CORRECTED, linewidth=2, label="corrected")
        stiffness.set(
            ylabel="largest singular value [N m/rad]", xlabel="time [s]", title="antisymmetric part, same states"
        )
        begin = received["time"][received["state"] == SessionState.COMMANDING_ACTIVE][0] + APPROACH
        for axes in panels.flat:
            label = "trajectory begins" if axes is stiffness else None
            axes.axvline(begin, color=INK, linewidth=0.8, alpha=0.5, label=label)
            axes.margins(x=0.01)
        # Beside the panels, whose curves leave no room: the joints' colours hold for both of the upper ones.
        figure.legend(handles=joints.get_legend_handles_labels()[0], loc="outside upper center", ncols=9,
                      columnspacing=1.0, handlelength=1.4)  # fmt: skip
        for axes in (wrench, stiffness):
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
        return themed_svg(figure)


def report(options: argparse.Namespace, console: Console) -> bool:
    """Print and draw the session; return whether it went as planned."""
    folder = options.output
    robot = load_robot(options.robot)
    log = read_client_log(folder / "client.csv", folder / "client.json")
    with np.load(folder / "robot.npz") as arrays:
        received = {name: arrays[name] for name in arrays.files if name != "summary"}
    found, commands = compare(robot, log, received), check_commands(received, log.summary)
    parts = antisymmetric_parts(robot, log)
    told, faults = log.summary, log.summary["faults"]
    figure = folder / "session.svg"
    figure.write_text(draw(log, received, parts))
    table = Table(box=None, show_header=False, pad_edge=False)
    rows = [
        ("cycles", f"{told['cycles']} of {options.send_period} ms, {told['commanding_cycles']} commanding"),
        ("lost", f"{faults['lost_messages']} messages, {faults['lost_answers']} answers"),
        (
            "step time of the client",
            f"median {told['callback_median_us']:.0f} us, worst {told['callback_worst_us']:.0f} us",
        ),
        ("torque received - controller in Python", f"{found.worst:.1e} N m at most"),
        ("torque change", f"{100 * commands.worst_rate:.0f} % of the rate limit at most"),
        ("antisymmetric part, corrected formula", f"{np.max(parts[0]):.1e} N m/rad at most"),
        ("conventional formula, same states", f"{np.max(parts[1]):.2f} N m/rad at most"),
        ("figure", str(figure.relative_to(ROOT) if figure.is_relative_to(ROOT) else figure)),
    ]
    for name, value in rows:
        table.add_row(name, value)
    console.print(table)
    # Bars: the replay agrees up to rounding, 1e-10 N m; the torque's rate stays within its limit.
    good = told["trajectory_done"] and found.compared > 0 and found.worst <= 1e-10 and commands.worst_rate <= 1 + 1e-9
    return bool(good and commands.not_finite == commands.beyond_limit == 0)


def run(options: argparse.Namespace, console: Console) -> int:
    """Run the demo; return the exit code."""
    options.robot, options.output = options.robot.absolute(), options.output.absolute()
    load_robot(options.robot)
    options.output.mkdir(parents=True, exist_ok=True)
    for name in ("client.csv", "client.json", "client.txt", "robot.npz", "robot.json", "session.svg"):
        (options.output / name).unlink(missing_ok=True)  # remove results of an earlier run
    console.print("building the client, up to 4 minutes ...")
    folder = options.output / f"client-{options.protocol}"
    client = build_client(options.robot, options.protocol, folder, lambda line: console.print(line, markup=False))
    run_session(options, client)
    if report(options, console):
        return 0
    raise BrokenOffError("the session ended, but not as it should; see the figures above")


def main() -> int:
    """Run the command line; return the exit code."""
    options = arguments().parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        return run(options, Console())
    except (RefusedError, StiffgenError) as error:
        print(error, file=sys.stderr)
        return 2
    except BrokenOffError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
