# SPDX-License-Identifier: MIT
"""The program fri_wiping over UDP: endings, refusals, files, timing, other senders."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from fri.robot.replay import read_client_log
from fri.support.python_client import free_port
from fri.support.served import served, unread
from fri.support.session import (
    FULL,
    POSTURE,
    TRAJECTORY,
    Programs,
    RobotScript,
    button,
    write_short_trajectory,
)
from fri.support.wiping import (
    COMMANDING_ACTIVE,
    COMMANDING_WAIT,
    IDLE,
    MONITORING_READY,
    MONITORING_WAIT,
    fri_wiping,
    moving,
    moving_script,
    over_udp,
    position_mode,
)
from support.calibrations import calibration_text
from support.plate import PAYLOAD
from support.project import ROOT


def test_session_over_udp_ends_with_idle(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """End the session by IDLE after 200 samples: exit code 3 (ended early), with full log, states and timing."""
    script = moving_script(programs, robot, 200)
    script.add(MONITORING_READY, 3)
    script.add(IDLE)
    summary, log = tmp_path / "summary.json", tmp_path / "log.csv"
    code, out, errors = over_udp(programs, script, "--summary", summary, "--log", log)
    assert code == 3 and errors.startswith("fri_wiping: the robot ended the session before the trajectory's end")
    for line in ("IDLE -> MONITORING_WAIT", "COMMANDING_WAIT -> COMMANDING_ACTIVE", "MONITORING_READY -> IDLE"):
        assert line in out
    told = json.loads(summary.read_text())
    # 9 before, 200, 3 after
    assert (told["cycles"], told["commanding_cycles"], told["log_rows"], told["log_overruns"]) == (212, 200, 200, 0)
    assert 0 < told["callback_median_us"] <= told["callback_9999_us"] <= told["callback_worst_us"]
    assert read_client_log(log, summary)["time"].size == 200


def test_robot_that_falls_silent_is_a_fault(programs: Programs) -> None:
    script = programs.script()
    script.begin()
    code, _, errors = over_udp(programs, script, "--timeout", "200")
    assert code == 1 and "silent for 200 ms" in errors


def test_no_robot_is_a_fault(programs: Programs) -> None:
    done = fri_wiping(
        programs, "--trajectory", TRAJECTORY, "--port", str(free_port()), "--timeout", "50", "--wait", "0.1"
    )
    assert done.returncode == 1 and "no robot has sent anything" in done.stderr


REFUSALS: dict[str, tuple[Callable[[RobotScript], object], tuple[str, ...], str]] = {
    "position mode": (lambda s: s.add(COMMANDING_WAIT, 12, change=position_mode), (), "not in torque mode"),
    "send period": (lambda s: s.add(COMMANDING_WAIT, 12), ("--sample-time", "0.001"), "send period is 5 ms, 1 ms"),
    "no send period": (
        lambda s: s.add(COMMANDING_WAIT, 12, change=lambda m: m.connectionInfo.ClearField("sendPeriod")),
        (),
        "send period is 0 ms",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_robot_that_cannot_be_used_is_refused_in_one_line(name: str, programs: Programs) -> None:
    """Let the robot announce what the client cannot serve: exit code 2 and one line with the reason."""
    add, options, text = REFUSALS[name]
    script = programs.script()
    add(script)
    code, _, errors = over_udp(programs, script, *options)
    assert code == 2
    assert errors.count("\n") == 1 and text in errors


def _file(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[], str]:
    def text() -> str:
        values = change(np.loadtxt(TRAJECTORY, delimiter=",", dtype=object))
        return "\n".join(",".join(map(str, row)) for row in values) + "\n"

    return text


def _put(row: int, column: int, value: object) -> Callable[[], str]:
    def change(values: np.ndarray) -> np.ndarray:
        values[row, column] = value
        return values

    return _file(change)


def _add(row: int, start: int, value: float) -> Callable[[], str]:
    def change(values: np.ndarray) -> np.ndarray:
        values[row, start:] = [float(x) + value for x in values[row, start:]]
        return values

    return _file(change)


TRAJECTORIES: dict[str, tuple[Callable[[], str], str]] = {
    "six rows": (_file(lambda v: v[:6]), "6 rows of 2793 columns"),
    "empty": (lambda: "", "0 rows"),
    "ragged": (lambda: "1,2,3\n" * 6 + "1,2\n", "row 7 has 2 columns, row 1 has 3"),
    "word": (_put(2, 4, "abc"), "row 3, column 5: 'abc' is not a finite number"),
    "header": (lambda: "q_0,q_1\n1,2\n", "row 1, column 1: 'q_0'"),
    "nan": (_put(0, 0, "nan"), "row 1, column 1: 'nan'"),
    "infinite": (_put(6, 9, "1e999"), "row 7, column 10: '1e999'"),
    "blank": (_put(1, 1, ""), "row 2, column 2: ''"),
    "jump": (_add(3, 1000, 0.1), "joint A4 jumps by 0.1"),
    "jump at the beginning": (_add(0, 1, 0.005), "joint A1 starts at 1 rad/s"),
    "jump at the end": (_add(0, 2792, 0.005), "joint A1 ends at 1 rad/s"),
    "limit": (_add(1, 0, 1.0), "joint A2 is at"),
    "short": (lambda: "\n".join(["0,0"] * 7), "2 samples; it takes at least 3"),
}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_bad_trajectory_is_refused_in_one_line(name: str, one: Programs, tmp_path: Path) -> None:
    """Give a faulty trajectory file: exit code 2 (refused) and one line that names the file and the fault."""
    text, wanted = TRAJECTORIES[name]
    file = tmp_path / "trajectory.csv"
    file.write_text(text())
    done = fri_wiping(one, "--trajectory", file)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and wanted in done.stderr and str(file) in done.stderr


PRESSING: list[str | Path] = ["--trajectory", "x", "--press", "15", "--wrench", "sensor"]


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([], "no trajectory; name a file with --trajectory"),
        (["--trajectory", "missing.csv"], "missing.csv: No such file or directory"),
        (["--trajectory"], "--trajectory: its value is missing"),
        (["--port", "0"], "--port 0: it takes a number from 1 to 65535"),
        (["--port", "30200.5"], "--port 30200.5: it takes a whole number"),
        (["--stiffness", "1,2,3"], "--stiffness 1,2,3: it takes six numbers"),
        (["--stiffness", "1,2,3,4,5,-6"], "--stiffness -6: it takes a number from 0"),
        (["--wrench", "guess"], "--wrench guess: it takes external-torque or sensor"),
        (["--external-torque-sign", "0"], "it takes 1 or -1"),
        (["--effort-share", "nan"], "--effort-share nan"),
        (["--velocity", "3"], "--velocity: no such option"),
        (["--joint-damping", "1"], "--joint-damping: the controller damps by --damping-ratio"),
        (["--velocity-filter=0.004"], "--velocity-filter: give --velocity-span S, twice the old time constant"),
        (["--friction", "1,2"], "--friction 1,2: it takes seven numbers"),
        (["--friction", "1,1,1,1,1,1,-1"], "--friction -1: it takes a number from 0"),
        (["--press", "101"], "--press 101: it takes a number from 0 to 100"),
        (["--trajectory", "x", "--press", "15"], "--press: it takes --wrench sensor: external torques are no force"),
        ([*PRESSING, "--law", "paper"], "--press: it moves the springs of --law potential; leave --law out"),
        ([*PRESSING, "--settle", "35,3"], "and --settle back; give one of them"),
        ([*PRESSING, "--dry-run"], "--press: in a --dry-run nothing presses"),
        ([*PRESSING, "--position-quantum", "1e-5"], "--press: it takes positions that are finer than 1e-6 rad"),
        (PRESSING, "--wrench sensor: it takes --calibration FILE"),
        (["--settle", "35"], "--settle 35: it takes two numbers"),
        (["--settle", "101,3"], "--settle 101: it takes a number from 0 to 100"),
        (["--trajectory", "x", "--settle", "35,3", "--law", "paper"], "--settle: it moves the springs of --law poten"),
        (["--trajectory", "x", "--settle", "35,3", "--position-quantum", "1e-5"], "finer than 1e-6 rad, not"),
        (["--effort=0.5"], "--effort: no such option"),
        (["extra"], "extra: not an option"),
        (["--trajectory", TRAJECTORY, "--log", "/nowhere/log.csv"], "log /nowhere/log.csv"),
        (["--trajectory", TRAJECTORY, "--host", "robot.example"], "host robot.example"),
    ],
)
def test_bad_option_is_refused_in_one_line(arguments: list[str | Path], wanted: str, one: Programs) -> None:
    """Give a faulty option: exit code 2 (refused) and one line that names the option and its values."""
    done = fri_wiping(one, *arguments)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and wanted in done.stderr


def test_every_option_is_in_the_help(one: Programs) -> None:
    source = (ROOT / "fri" / "client" / "options.cpp").read_text()
    done = fri_wiping(one, "--help")
    told = re.findall(r"^  --([a-z-]+) +(?:[A-Z]+ )? *\S.{15}", done.stdout, re.M)
    assert done.returncode == 0 and len(told) > 30
    assert told == re.findall(r'^    \{"([a-z-]+)", (?:"[A-Z]+"|NULL), ', source, re.M)


def test_port_in_use_is_refused(one: Programs) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        port = taken.getsockname()[1]
        done = fri_wiping(one, "--trajectory", TRAJECTORY, "--port", str(port))
    assert done.returncode == 2 and f"port {port}: cannot be opened" in done.stderr


def test_wrench_from_a_sensor(one: Programs, robot: ModuleType, plate_folder: Path, tmp_path: Path) -> None:
    """Send readings as the sensor reports them: the log has the tip's wrench, and silence makes missed samples."""
    sensor_port = free_port()
    log, summary = tmp_path / "log.csv", tmp_path / "summary.json"
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 100)
    told, bias = np.array([1.0, -2.0, 3.0, 0.4, -0.5, 0.6]), np.array([3.0, 1.0, -2.0, 0.3, 0.1, -0.2])  # [N], [N m]
    calibration = tmp_path / "sensor.json"
    calibration.write_text(calibration_text(plate_folder, bias, PAYLOAD))
    options = ("--wrench", "sensor", "--sensor-port", sensor_port, "--calibration", calibration, "--log", log,
               "--summary", summary)  # fmt: skip
    with served(one.client, *options) as session:
        for k, datagram in enumerate(script.datagrams):
            # The sensor is silent from message 60 on; datagrams of another size never count.
            for sample in [struct.pack("<6d", *told)] * (k < 60) + [b"short"]:
                session.robot.sendto(sample, ("127.0.0.1", sensor_port))
            while unread(sensor_port):  # the sensor's thread is not in lockstep
                time.sleep(0.001)
            session.ask(datagram or b"")
        session.send(script.message(IDLE))
        assert session.end()[0] == 3
    steps = read_client_log(log, summary)
    valid = steps["sample_valid"].astype(bool)
    R = robot.forward_kinematics(POSTURE)[:3, :3]
    force, weight = R @ (bias - told)[:3], np.array([0.0, 0.0, -9.81 * PAYLOAD[0]])
    of_weight = np.cross(R @ [0, 0, PAYLOAD[3] / PAYLOAD[0]], weight)  # about the sensor, 0.24 m behind the tip
    moment = R @ (bias - told)[3:] - of_weight - np.cross(R @ [0, 0, 0.24], force - weight)
    expected = np.concatenate([force - weight, moment])
    np.testing.assert_array_equal(steps["reading"][10:50], np.tile(told, (40, 1)))
    np.testing.assert_allclose(steps["wrench"][10:50], np.tile(expected, (40, 1)), atol=1e-12)
    assert valid[10:50].all() and not valid[70:].any()
    assert steps.summary["faults"]["sensor_silent"] > 20


def test_a_sensor_takes_a_calibration(one: Programs, plate_folder: Path, tmp_path: Path) -> None:
    """Start with a sensor and no calibration, a file that is none, or another sensor's: each is refused."""
    text, file = calibration_text(plate_folder), tmp_path / "sensor.json"
    cases = {
        "it takes --calibration FILE": None,
        "cannot be read, or is none by 'stiffgen calibrate'": "{}",
        "is of another sensor than that of iiwa14_plate": text.replace('"link_ee robot', '"link_ee environment'),
    }
    for words, content in cases.items():
        file.write_text(content or "")
        given = () if content is None else ("--calibration", str(file))
        done = fri_wiping(one, "--trajectory", TRAJECTORY, "--wrench", "sensor", *given)
        assert done.returncode == 2 and words in done.stderr, done.stderr
    file.write_text(text)
    done = fri_wiping(one, "--trajectory", TRAJECTORY, "--calibration", str(file))
    assert done.returncode == 2 and "it belongs to --wrench sensor" in done.stderr


def watched_session(
    programs: Programs, robot: ModuleType, folder: Path, *arguments: str, registered: bool
) -> tuple[int, int, int]:
    """Allocations in all threads from the opening of the port to its closing; page faults, minor and major, of the FRI
    thread from the first datagram on. A session with everything in it, its faults too.
    """
    script = programs.script()
    ios = [button(False)] if registered else []
    for state, count in ((MONITORING_WAIT, 3), (MONITORING_READY, 3), (COMMANDING_WAIT, 3)):
        script.add(state, count, ios=ios)
    if not registered:
        script.add(COMMANDING_WAIT, 2, change=lambda m: m.ipoData.ClearField("jointPosition"))
        script.add(COMMANDING_WAIT, 2, change=position_mode)
    for k in range(300):
        q, _, torque = moving(robot, k * 0.005)
        script.add(COMMANDING_ACTIVE, position=q, external_torque=torque, ios=[button(k > 200)] if registered else [])
        if k in (100, 150):
            script.lose(k - 98)  # two, then a fault of the controller
    script.add(MONITORING_READY, 3, ios=ios)
    script.add(IDLE)
    result = folder / "allocations"
    environment = {"LD_PRELOAD": str(programs.folder / "liballocations.so"), "FRI_ALLOCATIONS": str(result)}
    code, _, _ = over_udp(
        programs, script, "--log", folder / "log.csv", "--summary", folder / "summary.json", *arguments,
        environment=environment,
    )  # fmt: skip
    assert code == 3
    told = json.loads((folder / "summary.json").read_text())
    assert told["faults"]["controller_faults"] == 1 and told["log_rows"] == 300
    allocations, datagrams, minor, major = map(int, result.read_text().split())
    assert datagrams == len(script.datagrams)
    return allocations, minor, major


@pytest.mark.parametrize("registered", [True, False])
def test_nothing_is_allocated_from_the_opening_of_the_port_to_its_closing(
    registered: bool, programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Checked in all threads, the log's among them, with an interposed allocator.

    Nor when the button is not registered, and what is needed is left out: the library throws no exception then.
    """
    assert watched_session(programs, robot, tmp_path, registered=registered)[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("registered", [True, False])
def test_with_locked_memory_the_fri_thread_meets_no_page_fault(
    registered: bool, programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Run with --realtime: the FRI thread must have no page fault and no allocation after its first message."""
    tried = fri_wiping(
        programs, "--trajectory", TRAJECTORY, "--port", str(free_port()), "--realtime", "1", "--wait", "0.1"
    )
    if "grant rtprio and memlock" in tried.stderr:
        pytest.skip("this user may not lock memory and have a real-time priority")
    assert watched_session(programs, robot, tmp_path, "--realtime", "1", registered=registered) == (0, 0, 0)


def test_answers_in_a_burst_do_not_move_the_torque_faster(one: Programs, tmp_path: Path) -> None:
    """Sixty messages without a pause: the torque moves by what the rate limit allows in this machine's time."""
    script = one.script()
    script.begin()
    script.add_resting(60)
    summary = tmp_path / "summary.json"
    answers = []
    with served(one.client, "--approach", "0.1", "--summary", summary) as session:
        begin = 0.0
        for k, datagram in enumerate(script.datagrams):
            begin = time.monotonic() if k <= 9 else begin
            answer = session.ask(datagram or b"")
            answers.append((time.monotonic() - begin, answer))  # not less than the client can have measured
        session.send(script.message(IDLE))
        session.end()
    torques = [(t, script.protocol.decode_command(data).torque) for t, data in answers[9:]]
    limit = np.array(json.loads(summary.read_text())["controller"]["torque_rate_limit"])
    assert len(torques) == 60 and np.abs(torques[-1][1]).max() > 0
    for t, torque in torques:
        assert (np.abs(torque) <= limit * (t + 0.01 + 0.005)).all()  # two periods that may be used at once


def test_the_trajectory_never_runs_ahead_of_this_machines_time(programs: Programs, tmp_path: Path) -> None:
    """Let the counter grow faster than messages come, without stamps: the trajectory keeps to this machine's time."""
    short = write_short_trajectory(tmp_path / "short.csv")
    script = programs.script()
    script.begin()
    for k in range(250):
        script.lose(k % 2)
        script.add_resting(1, change=lambda m: m.monitorData.ClearField("timestamp"))
    summary = tmp_path / "summary.json"
    with served(programs.client, "--trajectory", short, "--approach", "0.1", "--summary", summary, *FULL) as session:
        begin = time.monotonic()
        for datagram in script.datagrams:
            session.ask(datagram or b"")
        passed = time.monotonic() - begin
        session.send(script.message(IDLE))
        session.end()
    told = json.loads(summary.read_text())
    assert told["faults"]["lost_cycles"] == 125 and told["faults"]["controller_faults"] == 0
    assert not told["trajectory_done"] or passed > 1.1 - 8 * 0.005


def test_another_sender_takes_no_part_in_the_session(programs: Programs, tmp_path: Path) -> None:
    """Neither sound messages nor garbage from elsewhere are answered, nor do they turn answers away from the robot."""
    script = programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 30)
    foreign = [programs.script().message(IDLE), b"garbage", script.message(COMMANDING_ACTIVE)]
    summary = tmp_path / "summary.json"
    with (
        served(programs.client, "--simulated-time", "--summary", summary) as session,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        session.ask(script.datagrams[0] or b"")
        for k, datagram in enumerate(script.datagrams[1:], start=1):
            with session.stopped():  # all of them are there when it looks
                session.send(foreign[k % 3], stranger)
                session.send(datagram or b"")
                session.send(foreign[k % 3], stranger)
            assert script.protocol.decode_command(session.answer()).reflected == k + 1
        session.send(script.message(IDLE))
        session.end()
        stranger.setblocking(False)
        with pytest.raises(BlockingIOError):
            stranger.recv(1500)
    faults = json.loads(summary.read_text())["faults"]
    count = len(script.datagrams) - 1
    assert faults["datagram_sender"] == 2 * sum(k % 3 != 1 for k in range(1, count + 1))
    assert faults["bad_datagrams"] == 2 * count
    assert (faults["lost_messages"], faults["state_drops"]) == (1, 1)  # the one that the stranger had; the end


def test_nobody_reads_what_it_prints(one: Programs) -> None:
    """Close the pipe that reads the client's output: a session under torque does not end."""
    script = one.script()
    script.begin()
    script.add_resting(60)
    script.add(MONITORING_READY)
    with served(one.client, "--simulated-time", "--approach", "0.1") as session:
        assert session.client.stdout is not None
        for k, datagram in enumerate(script.datagrams):
            if k == 20:
                session.client.stdout.close()
            session.ask(datagram or b"")
        session.send(script.message(IDLE))
        assert session.client.wait(30) == 3


def test_a_flood_of_what_is_refused_does_not_keep_the_client(one: Programs) -> None:
    """--timeout holds under garbage that never pauses."""
    with served(one.client, "--wait", "1", "--timeout", "300") as session:
        session.robot.connect(("127.0.0.1", session.port))
        deadline = time.monotonic() + 60
        while session.client.poll() is None and time.monotonic() < deadline:
            with contextlib.suppress(ConnectionRefusedError):
                for _ in range(1000):
                    session.robot.send(b"x")
        assert session.client.returncode == 1
        assert "datagrams arrive but do not decode as FRI 2.7: datagram_frame" in session.end()[2]


def test_after_a_stop_the_newest_alone_is_answered(programs: Programs, tmp_path: Path) -> None:
    """Stop the client's process while messages come: only the newest is answered, and the torque moves by two
    periods.
    """
    asked, unanswered, period = 60, 80, 0.005  # messages before the stop and during it; [s]
    newest = asked + unanswered  # number of the last message during the stop, as the first is number 1
    script = programs.script()
    script.begin()
    script.add_resting(150)
    datagrams = [each for each in script.datagrams if each is not None]
    summary = tmp_path / "summary.json"
    with served(programs.client, "--approach", "0.1", "--summary", summary) as session:
        received = [session.ask(datagram) for datagram in datagrams[:asked]]
        with session.stopped():
            for datagram in datagrams[asked:newest]:
                session.send(datagram)
        received.append(session.answer())
        received += [session.ask(datagram) for datagram in datagrams[newest:]]
        session.send(script.message(IDLE))
        session.end()
    answers = [script.protocol.decode_command(datagram) for datagram in received]
    reflected = [answer.reflected for answer in answers]
    assert reflected == [*range(1, asked + 1), *range(newest, len(datagrams) + 1)]
    told = json.loads(summary.read_text())
    faults = told["faults"]
    overtaken = unanswered - 1  # all but the newest
    assert (faults["overtaken"], faults["lost_messages"], faults["lost_cycles"]) == (overtaken, 0, overtaken)
    limit = np.array(told["controller"]["torque_rate_limit"]) * 2 * period
    before, after = answers[asked - 1].torque, answers[asked].torque
    assert before is not None and after is not None
    assert np.abs(before).max() > 0 and (np.abs(after - before) <= limit).all()
