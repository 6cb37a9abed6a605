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
LAST_WORDS = 15
"""Last lines of a build that does not succeed, which are shown."""
MOST_DIFFERENCE = 1e-10
"""Largest torque received less the replayed one [N m]: the two agree up to rounding."""


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
    options = [f"-DOPEN_FRI_VERSION={version}", f"-DROBOT_DIR={robot}", f"-DROBOT_NAME={robot.name}"]
    options += [f"-D{robot.name.upper()}_NATIVE=ON", "-DCMAKE_BUILD_TYPE=Release"]
    _run_build([program, "-S", str(CLIENT), "-B", str(folder), *options], say)
    _run_build([program, "--build", str(folder), "-j2"], say)
    return folder / "fri_wiping"


def _run_build(command: list[str], say: Callable[[str], None]) -> None:
    """Run a command of the build and pass its lines on; RefusedError with the last ones if it fails."""
    lines = []
    pipe: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, **pipe) as process:
        for line in process.stdout or ():
            lines.append(line.rstrip())
            say(lines[-1])
    if process.returncode:
        last = "\n".join(lines[-LAST_WORDS:])
        raise RefusedError(f"the client does not build:\n{last}")


def run_session(options: argparse.Namespace, client: Path) -> None:
    """Run client and robot until both have ended.

    Raises
    ------
    RefusedError, BrokenOffError
        One of them refused something, or the session failed.

    """
    folder = options.output
    for name in ("client.csv", "client.json"):
        (folder / name).unlink(missing_ok=True)  # the client overwrites no log
    said = folder / "client.txt"
    with (
        said.open("wb") as output,
        child(_client_command(options, client), stdout=output, stderr=output) as wiping,
        child(_robot_command(options)) as robot,
    ):
        client_code = _wait_for_both(wiping, robot)
    robot_code = robot.poll()
    if client_code or robot_code:
        last = "\n".join(said.read_text().strip().splitlines()[-1:])
        if client_code == 2:
            raise RefusedError(last)
        codes = f"exit code of the client {client_code}, of the robot {robot_code}"
        raise BrokenOffError(f"{codes}. The client's last words: {last}")


def _client_command(options: argparse.Namespace, client: Path) -> list[str]:
    """Return the command line of the client: the trajectory once, with log and summary."""
    folder = options.output
    command = [str(client), "--trajectory", str(TRAJECTORY), "--port", str(options.port), "--approach", str(APPROACH)]
    command += ["--log", str(folder / "client.csv"), "--summary", str(folder / "client.json")]
    return command + ([] if options.wall_clock else ["--simulated-time"])


def _robot_command(options: argparse.Namespace) -> list[str]:
    """Return the command line of the simulated robot in the bowl, for as long as the client commands."""
    folder, duration = options.output, APPROACH + TRAJECTORY_TIME + REST
    command = [sys.executable, "-m", "fri.robot", "--protocol", options.protocol, "--port", str(options.port)]
    command += ["--robot", str(options.robot), "--send-period", str(options.send_period), "--bowl"]
    command += ["--duration", str(duration), "--log", str(folder / "robot.npz")]
    command += ["--summary", str(folder / "robot.json")]
    return command + ([] if options.wall_clock else ["--lockstep"])


def _wait_for_both(client: subprocess.Popen[bytes], robot: subprocess.Popen[bytes]) -> int:
    """Wait until the robot has ended the session, or the client has failed; return the client's exit code.

    Raises
    ------
    BrokenOffError
        The session did not end in time, or the client did not end with it.

    """
    deadline = wall.monotonic() + LONGEST
    try:
        while robot.poll() is None:
            if client.poll():  # refused or failed; the robot notices, unless it still waits for a client
                with contextlib.suppress(subprocess.TimeoutExpired):
                    robot.wait(2.0)
                break
            if wall.monotonic() > deadline:
                raise BrokenOffError(f"the session did not end within {LONGEST:g} s")
            wall.sleep(0.05)
        return client.wait(max(0.1, min(10.0, deadline - wall.monotonic())))
    except subprocess.TimeoutExpired as error:
        raise BrokenOffError("the client did not end with the session") from error


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
    """Draw the session as SVG: joint positions, torque on the wire, wrench estimated and true, antisymmetric part.

    ``parts`` are the antisymmetric parts of :func:`antisymmetric_parts`, corrected and conventional.
    """
    shown = slice(None, None, max(1, len(log) // 400))  # steps of the client that are drawn
    time = log["time"][shown]
    row = np.rint(log["time"] / log.summary["sample_time"]).astype(int)[shown]  # the robot's row of each of them
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 7.0), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True)
        (joints, torque), (wrench, stiffness) = panels
        _draw_joints(joints, torque, time, log["q"][shown], log["q0"][shown], received["command_torque"][row])
        _draw_wrench(wrench, time, log["wrench"][shown], received["wrench"][row])
        _draw_antisymmetric(stiffness, time, parts[0][shown], parts[1][shown])
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


def _draw_joints(
    joints: Any, torque: Any, time: NDArray[Any], q: NDArray[Any], q0: NDArray[Any], received: NDArray[Any]
) -> None:
    """Draw positions and zero-force positions (steps, 7) [rad] in one panel, received torques [N m] in the other."""
    for joint, colour in enumerate(SHADES):
        joints.plot(time, np.degrees(q[:, joint]), color=colour, label=f"A{joint + 1}")
        joints.plot(time, np.degrees(q0[:, joint]), ":", color=colour)
        torque.plot(time, received[:, joint], color=colour)
    joints.plot([], [], color=INK, label="measured")
    joints.plot([], [], ":", color=INK, label="zero-force")
    joints.set(ylabel="[deg]", title="joint positions")
    torque.set(ylabel="[N m]", title="joint torques that the robot received")


def _draw_wrench(panel: Any, time: NDArray[Any], estimated: NDArray[Any], simulated: NDArray[Any]) -> None:
    """Draw the force on the tool [N], as the client estimates it and as it is in the simulation (steps, 6)."""
    for axis, colour in enumerate(AXES):
        # The estimate shows on both sides of the simulation's thin line, which lies upon it.
        name = f"{'xyz'[axis]}, estimated"
        panel.plot(time, estimated[:, axis], color=colour, linewidth=2.4, label=name)
        panel.plot(
            time, simulated[:, axis], ":", color=INK, linewidth=0.9, label="in the simulation" if axis == 2 else None
        )
    panel.set(ylabel="[N]", xlabel="time [s]", title="force on the tool, base axes")


def _draw_antisymmetric(panel: Any, time: NDArray[Any], corrected: NDArray[Any], conventional: NDArray[Any]) -> None:
    """Draw the largest singular values (steps) [N m/rad] of the antisymmetric part by both formulas."""
    panel.plot(time, conventional, "--", color=CONVENTIONAL, label="conventional formula")
    panel.plot(time, corrected, color=CORRECTED, linewidth=2, label="corrected")
    panel.set(ylabel="largest singular value [N m/rad]", xlabel="time [s]", title="antisymmetric part, same states")


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
    has_replay = found.compared > 0 and found.worst <= MOST_DIFFERENCE
    keeps_limits = commands.worst_rate <= 1 + 1e-9 and commands.not_finite == commands.beyond_limit == 0
    return bool(told["trajectory_done"] and has_replay and keeps_limits)


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
