# SPDX-License-Identifier: MIT
"""The client's files and the signals that it gets: no file is overwritten, no signal ends the program under torque."""

from __future__ import annotations

import contextlib
import json
import resource
import signal
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from fri.support.python_client import free_port
from fri.support.served import served
from fri.support.session import FULL, TRAJECTORY, Programs, write_short_trajectory
from fri.support.wiping import COMMANDING_WAIT, IDLE, over_udp


def whole_session(
    one: Programs, folder: Path, *arguments: str | Path, limit: int | None = None, steps: int = 400
) -> tuple[int, str, str]:
    """Follow a short trajectory to its end, or for fewer steps; ``limit``: most bytes of a file."""
    script = one.script()
    script.begin()
    script.add_resting(steps)
    script.add(IDLE)
    short = write_short_trajectory(folder / "short.csv")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    if limit is not None:  # the client inherits it
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        return over_udp(one, script, "--trajectory", short, "--approach", "0.1", *FULL, *arguments)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("limit", [None, 200_000])
def test_a_log_that_does_not_fit_is_no_success(limit: int | None, one: Programs, tmp_path: Path) -> None:
    """Beyond the limit a write fails, and SIGXFSZ would end the program."""
    log, summary = tmp_path / "log.csv", tmp_path / "summary.json"
    code, out, errors = whole_session(one, tmp_path, "--log", log, "--summary", summary, limit=limit)
    told = json.loads(summary.read_text())
    text = log.read_text()
    assert text.endswith("\n") and text.count("\n") == told["log_rows"] + 2
    assert told["trajectory_done"] and told["exit_code"] == code
    if limit is None:
        assert (code, told["log_rows"]) == (0, 400)
    else:
        assert code == 1 and len(text) <= limit < len(text) + 2500
        assert f"the log is not complete: File too large, {told['log_rows']} rows written; make room" in errors
        assert "log: File too large; the rows from now on are lost" in out


@pytest.mark.parametrize(
    ("limit", "summary", "code"), [(None, "summary.json", 3), (20_000, "summary.json", 1), (None, "/dev/full", 1)]
)
def test_an_early_end_that_loses_its_record_is_a_fault(
    limit: int | None, summary: str, code: int, one: Programs, tmp_path: Path
) -> None:
    """End the session early: exit code 3, but 1 if log or summary is incomplete."""
    files = ("--log", tmp_path / "log.csv", "--summary", tmp_path / summary)
    found, _, errors = whole_session(one, tmp_path, *files, limit=limit, steps=100)
    assert (found, errors.count("\n")) == (code, 1)
    assert "the robot ended the session before the trajectory's end" in errors
    assert ("the log is not complete: File too large" in errors) == (limit is not None)
    assert ("summary /dev/full: No space left on device" in errors) == (summary == "/dev/full")


def test_an_interrupted_session_that_loses_its_summary_is_a_fault(one: Programs) -> None:
    """Interrupt a session whose summary cannot be written: exit code 1, and both facts are told."""
    script = one.script()
    script.begin()
    script.add_resting(120)
    with served(one.client, "--simulated-time", "--approach", "0.1", "--summary", "/dev/full") as session:
        for k, datagram in enumerate(script.datagrams):
            if k == 60:  # the 52nd sample of 5 ms: the session is commanding
                session.client.send_signal(signal.SIGINT)
                time.sleep(0.01)
            session.send(datagram or b"")
            try:
                session.answer(1.0)
            except (TimeoutError, ConnectionRefusedError):
                break
        code, _, errors = session.end()
    assert code == 1
    assert "interrupted; torque brought to zero" in errors and "summary /dev/full: No space left" in errors


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("--log", "old.csv"), "log old.csv: File exists; name a new file with --log, or remove this one"),
        (("--log", "new.csv", "--port", "taken"), "cannot be opened"),
        (("--log", "trajectory.csv"), "log trajectory.csv: File exists"),
        (("--summary", "trajectory.csv"), "summary trajectory.csv: the same file as the trajectory"),
        (("--summary", "link.csv"), "summary link.csv: the same file as the trajectory"),
        (("--log", "new.csv", "--summary", "new.csv"), "summary new.csv: the same file as the log"),
        (("--log", "new.csv", "--summary", "./new.csv"), "summary ./new.csv: the same file as the log"),
        (("--log", "/dev/full"), "log /dev/full: No space left on device; make room"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_refused_start_changes_no_file(
    arguments: tuple[str, ...], wanted: str, one: Programs, tmp_path: Path
) -> None:
    """Refuse the start: one line says why, and no file changes. "taken": a port of another socket."""
    (tmp_path / "trajectory.csv").write_bytes(TRAJECTORY.read_bytes())
    (tmp_path / "link.csv").symlink_to("trajectory.csv")
    (tmp_path / "old.csv").write_text("of yesterday")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        words = [str(taken.getsockname()[1]) if word == "taken" else word for word in arguments]
        # a later --port replaces the first
        words = ["--trajectory", "trajectory.csv", "--wait", "0.1", "--port", str(free_port()), *words]
        done = subprocess.run([one.client, *words], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and wanted in done.stderr
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_refused_session_leaves_no_empty_log(one: Programs, tmp_path: Path) -> None:
    script = one.script()
    script.add(COMMANDING_WAIT, 12)
    assert over_udp(one, script, "--sample-time", "0.001", "--log", tmp_path / "log.csv")[0] == 2
    assert not (tmp_path / "log.csv").exists()


# ---- signals ---------------------------------------------------------------------------------------------------------

ENDS = (signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM,
        signal.SIGVTALRM, signal.SIGPROF, signal.SIGXCPU, signal.SIGPOLL, signal.SIGRTMIN, signal.SIGRTMAX)  # fmt: skip
IGNORED = (signal.SIGPIPE, signal.SIGXFSZ, signal.SIGTTIN, signal.SIGTTOU)


@pytest.mark.parametrize(
    "number",
    [*ENDS[:3], *(pytest.param(each, marks=pytest.mark.slow) for each in (*ENDS[3:], *IGNORED))],
    ids=lambda number: getattr(number, "name", str(number)),
)
def test_no_signal_ends_the_program_under_torque(
    number: signal.Signals, one: Programs, request: pytest.FixtureRequest
) -> None:
    """Send a signal twice, since timers send theirs again: the torque goes down before the program ends."""
    before = signal.signal(number, signal.SIG_DFL)  # the client would inherit that it is ignored, as under nohup
    request.addfinalizer(lambda: signal.signal(number, before))
    script = one.script()
    script.begin()
    script.add_resting(120)
    torques = []
    with served(one.client, "--simulated-time", "--approach", "0.1") as session:
        for k, datagram in enumerate(script.datagrams):
            if k in (60, 70):
                session.client.send_signal(number)
                time.sleep(0.01)
            session.send(datagram or b"")
            try:
                torques.append(script.protocol.decode_command(session.answer(1.0)).torque)
            except (TimeoutError, ConnectionRefusedError):
                break
        with contextlib.suppress(ConnectionRefusedError):
            session.send(script.message(IDLE))
        code, _, errors = session.end()
    assert np.abs(torques[60]).max() > 0
    if number in IGNORED:
        assert code == 3 and len(torques) == len(script.datagrams)
    else:
        assert code == 4 and "interrupted; torque brought to zero" in errors
        assert not torques[-1].any() and len(torques) < len(script.datagrams)
