# SPDX-License-Identifier: MIT
"""The C++ client against unfriendly robots: scenarios of the emulator (--faults), for each version."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from examples.experiments.plant import START_POSTURE
from fri.robot.messages import SessionState
from fri.support.run import Run, newest, versions
from fri.support.served import served
from fri.support.session import RobotScript, write_short_trajectory

DONE, FAULT, REFUSED, EARLY, INTERRUPTED = range(5)
REST = 0.3
"""[s] at the end of the trajectory."""
RELEASE = 0.3
"""[s] within which the torque must be down."""
TOLERANT = ("--thresholds", 0.6, 0.5, 0.3)


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A trajectory of 1 s near the start posture."""
    return write_short_trajectory(tmp_path / "short.csv", START_POSTURE)


class Scenario:
    """Sessions with that trajectory: 0.1 s to approach it, 1 s along it, 0.3 s of rest."""

    def __init__(self, session: Callable[..., Run], trajectory: Path) -> None:
        self._session = session
        self._trajectory = trajectory

    def __call__(
        self,
        version: str,
        faults: str = "",
        *options: object,
        period: int = 5,
        client: tuple[object, ...] = (),
        lockstep: bool = True,
        **more: Any,
    ) -> Run:
        """Run a session of the short trajectory; `faults` are the emulator's, `period` is the send period [ms]."""
        run = self._session(
            version, *(["--lockstep"] if lockstep else []), "--send-period", period, "--duration", 1.1 + REST,
            *(["--faults", faults] if faults else []), *options, client=("--approach", 0.1, *client),
            trajectory=self._trajectory, **more,
        )  # fmt: skip
        if run.client is not None and len(run.client) and lockstep:
            run.check_sent()
        return run


@pytest.fixture
def scenario(session: Callable[..., Run], short: Path) -> Scenario:
    return Scenario(session, short)


def trajectory_time(run: Run) -> float:
    """From the start to the end of the trajectory [s], by the client's log."""
    assert run.client is not None
    done = np.flatnonzero(run.client["events"].astype(int) & 1 << 9)
    assert len(done) == 1, "the trajectory's end was not reached"
    return float(run.client["time"][done[0]] - run.client["time"][0])


def last_line(run: Run) -> str:
    return (run.error or run.output).strip().splitlines()[-1]


def release_time(run: Run) -> float:
    """Return the time [s] from the client's letting go to the first torque of zero that it sent, by its log."""
    assert run.client is not None
    size = np.abs(run.client["sent_torque"]).max(axis=1)
    let_go = np.flatnonzero(run.client["events"].astype(int) & 1 << 17)
    assert len(let_go), "the client did not let go"
    assert size[-1] == 0.0, "the last command is not zero"
    zero = np.flatnonzero(size != 0)[-1] + 1
    return float(run.client["time"][zero] - run.client["time"][let_go[0]])


# ---- time -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@versions
@pytest.mark.parametrize(
    ("faults", "period"),
    [
        ("jitter@0-9:0.3", 5),
        ("clock@1.5-9:-0.9", 5),
        ("robot.missing@1.5-1.9:monitorData.timestamp", 5),
        pytest.param("jitter@0-9:0.9", 5, marks=pytest.mark.wide),
        pytest.param("resolution@0-9:1,jitter@0-9:0.3", 1, marks=pytest.mark.wide),
        pytest.param("resolution@0-9:10", 5, marks=pytest.mark.wide),
        pytest.param("clock@1.5-9:-0.012", 5, marks=pytest.mark.wide),
        pytest.param("clock@1.5-1.52:7", 5, marks=pytest.mark.wide),
        pytest.param("clock@1.5-9:-3600", 5, marks=pytest.mark.wide),
    ],
)
def test_the_trajectory_takes_as_long_as_ever_whatever_the_clock_does(
    scenario: Scenario, version: str, faults: str, period: int
) -> None:
    """Spoil the robot's time stamps: the trajectory advances by the messages' counter, so that its 1.1 s stay 1.1 s."""
    run = scenario(version, faults, period=period)
    assert (run.robot.code, run.code) == (0, DONE)
    assert run.client is not None
    assert abs(trajectory_time(run) - 1.1) <= period / 1000 + 1e-9
    assert run.client["sample_valid"].all()
    assert run.faults["lost_cycles"] == run.faults["controller_faults"] == 0
    assert np.abs(run.client["dq"]).max() < 0.6  # 0.2 rad in 1 s: 0.375 rad/s


@versions
def test_losses_cost_no_time_and_no_velocity(scenario: Scenario, version: str) -> None:
    run = scenario(version, "robot.drop=0.1@1.3-2.2,jitter@0-9:0.3", *TOLERANT)
    assert (run.robot.code, run.code) == (0, DONE)
    assert run.faults["lost_cycles"] == run.robot.summary["faults"]["robot"]["drop"] > 5
    assert abs(trajectory_time(run) - 1.1) <= 0.005 + 1e-9
    assert np.nanmax(np.abs(run.client["dq"])) < 0.6  # type: ignore[index]


# ---- the arm ---------------------------------------------------------------------------------------------------------


@newest
@pytest.mark.parametrize(
    ("option", "limit", "what"),
    [
        pytest.param(
            "--error-limit",
            0.03,
            "the tip's distance from where the trajectory wants it stayed at its limit of 0.03 m",
            marks=pytest.mark.slow,
        ),
        ("--energy-limit", 0.3, "the energy stored in the spring stayed at its limit of 0.3 J"),
        pytest.param("--force-limit", 15, "the contact force stayed at its limit of 15 N", marks=pytest.mark.slow),
    ],
)
def test_a_held_arm_stops_the_trajectory_and_is_let_go(
    scenario: Scenario, plate: ModuleType, version: str, option: str, limit: float, what: str
) -> None:
    """Hold the arm from 1.4 s on: each of the three limits stops the trajectory, and 0.3 s later (--hold-time) the
    client lets go.
    """
    run = scenario(version, "held@1.4-9", client=(option, limit, "--hold-time", 0.3))
    assert run.code == FAULT
    assert f"the arm is held: {what}" in last_line(run)
    assert run.client is not None
    if option == "--error-limit":
        wanted, there = (plate.forward_kinematics(run.client[name])[:, :3, 3] for name in ("q0", "q"))
        assert np.nanmax(np.linalg.norm(wanted - there, axis=1)) < limit + 0.1  # and what it covers in 0.25 s
    elif option == "--energy-limit":
        assert run.client["elastic_energy"].max() < 1.05 * limit  # the controller holds its reference
    assert run.client["pace"][-1] < 0.02
    assert release_time(run) <= RELEASE
    assert "slowed: " in run.output and "let go: " in run.output


@newest
def test_an_arm_that_is_held_for_a_while_goes_on(scenario: Scenario, version: str) -> None:
    """Hold the arm for 0.6 s, less than --hold-time: the trajectory slows down, continues and reaches its end."""
    run = scenario(
        version,
        "held@1.0-1.6",
        "--duration",
        3,
        client=("--energy-limit", 0.3, "--hold-time", 1.0, "--effort-share", 1, "--torque-rise", 0.1),
    )
    assert run.code == DONE, last_line(run)
    assert run.faults["slowed"] > 20  # samples of 5 ms: at least 0.1 s of the hold
    assert 1.3 < trajectory_time(run) < 2.6  # [s] 1.1 s of trajectory, longer by up to the hold and its slow-down


def test_the_defaults_for_commissioning_are_low(scenario: Scenario) -> None:
    run = scenario("2.7")
    assert run.client is not None
    told = run.client.summary["controller"]
    assert told["effort_limit"] == [80, 80, 44, 44, 27.5, 10, 10]
    np.testing.assert_allclose(told["torque_rate_limit"], 4 * np.array(told["effort_limit"]))


@newest
def test_an_arm_that_is_too_fast_is_let_go(scenario: Scenario, version: str) -> None:
    run = scenario(version, client=("--speed-share", 0.1))
    assert run.code == FAULT and "rad/s; see --speed-share" in last_line(run)
    assert release_time(run) <= RELEASE


# ---- the end ---------------------------------------------------------------------------------------------------------


def interrupt(process: Any, number: signal.Signals = signal.SIGINT) -> None:
    process.send_signal(number)
    time.sleep(0.05)


@versions
def test_interrupted_it_brings_the_torque_down_while_it_still_answers(scenario: Scenario, version: str) -> None:
    """Interrupt the client: the torque comes down in answers, since the robot cannot hear that the port is closed."""
    run = scenario(version, "", "--deaf", "--answer-timeout", 2, at=[(1.8, interrupt)])
    assert run.code == INTERRUPTED
    assert last_line(run) == "fri_wiping: interrupted; torque brought to zero, the client leaves"
    assert 0.1 <= release_time(run) <= RELEASE
    assert "did not answer" in run.robot.summary["end"]
    run.check_sent()


@pytest.mark.slow
def test_interrupted_twice_it_leaves_at_once(scenario: Scenario) -> None:
    run = scenario("2.7", "", "--deaf", "--answer-timeout", 2, at=[(1.8, interrupt), (1.81, interrupt)])
    assert run.code == INTERRUPTED and "the client left at once" in last_line(run)


@pytest.mark.slow
def test_interrupted_before_anything_moves_it_leaves(scenario: Scenario) -> None:
    run = scenario("2.7", "", "--deaf", "--answer-timeout", 2, at=[(0.3, interrupt)])
    assert run.code == INTERRUPTED
    assert len(run.torque) == 0


@versions
def test_a_session_that_ends_in_mid_motion_says_so(scenario: Scenario, version: str) -> None:
    run = scenario(version, "state@1.6:idle")
    assert run.code == EARLY
    assert "before the trajectory's end, at 0.4" in last_line(run)


@versions
def test_cut_and_incomplete_messages_are_refused_and_counted(scenario: Scenario, version: str) -> None:
    """Send one message of each bad kind, apart from each other: each is refused and counted."""
    parts = ("monitorData", "connectionInfo", "ipoData")
    cut = [f"truncate@{1.3 + 0.05 * k:.2f}:{field}" for k, field in enumerate(("robotInfo", *parts))]
    left_out = [f"robot.missing@{1.6 + 0.1 * k:.1f}:{field}" for k, field in enumerate(parts)]
    run = scenario(version, ",".join(cut + left_out), *TOLERANT)
    assert (run.robot.code, run.code) == (0, DONE)
    framed = version == "2.7"
    assert run.faults["datagram_frame"] == (len(cut) if framed else 0)
    assert run.faults["datagram_incomplete"] == len(left_out) + (0 if framed else len(cut))
    assert run.faults["state_drops"] == 0


# ---- what --wait and --timeout say ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("version", "other", "found"),
    [
        ("2.7", "1.15", "datagram_frame"),
        ("2.7", "2.5", "datagram_frame"),
        ("1.15", "2.7", ""),
        pytest.param("2.5", "2.7", "", marks=pytest.mark.wide),
    ],
)
def test_the_other_framing_is_named(
    client_program: Callable[[str], Path], version: str, other: str, found: str
) -> None:
    """Send messages of another FRI version: the client names the version that the robot speaks."""
    message = RobotScript(other).message(SessionState.MONITORING_WAIT)
    with served(client_program(version), "--wait", 2, "--timeout", 3000) as session:
        while session.client.poll() is None:
            with contextlib.suppress(ConnectionRefusedError):
                session.send(message)
            time.sleep(0.002)
        code, _, errors = session.end()
    assert code == FAULT
    assert f"datagrams arrive but do not decode as FRI {version.replace('1.15', '1.x')}: {found}" in errors
    assert f"the robot speaks {'2.7' if other == '2.7' else '1.x or 2.5'}: build the client for it" in errors


@pytest.mark.slow
@pytest.mark.parametrize(("version", "other"), [("1.15", "2.5"), pytest.param("2.5", "1.15", marks=pytest.mark.wide)])
def test_another_version_of_the_same_framing_is_told(scenario: Scenario, version: str, other: str) -> None:
    run = scenario(version, robot_version=other)
    assert run.client is not None and run.faults["other_version"] >= run.client.summary["cycles"]
    assert "other version: " in run.output


# ---- the robot's own states -----------------------------------------------------------------------------------------


@pytest.mark.slow
@versions
@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("safety@1.7-9:SAFETY_STOP_LEVEL_1", "the robot reports a safety stop while commanding"),
        ("drives@1.7-9:OFF", "the robot's drives are not active while commanding"),
        ("operation@1.7-9:T1", "the robot's operation mode changed while commanding"),
        ("period@1.7-9:2", "the robot's send period changed from 5 to 2 ms while commanding"),
    ],
)
def test_the_robots_own_states_are_heeded(scenario: Scenario, version: str, fault: str, text: str) -> None:
    """Change a state of the robot while commanding, from 1.7 s on: the client names the state and lets go in time."""
    run = scenario(version, fault)
    assert run.code == FAULT
    assert text in last_line(run)
    assert release_time(run) <= RELEASE
    assert "robot stopped: " in run.output or "send period: " in run.output


@versions
def test_a_few_odd_messages_end_no_session(scenario: Scenario, version: str) -> None:
    odd = "period@0.46-0.48:0,period@1.06-1.08:30,period@1.6-1.62:2,drives@1.7-1.72:TRANSITIONING"
    run = scenario(version, odd)
    assert (run.robot.code, run.code) == (0, DONE)
    assert abs(trajectory_time(run) - 1.1) <= 0.005 + 1e-9
    assert run.faults["other_periods"] == 12


# ---- the person at the arm ------------------------------------------------------------------------------------------

FAR = ("--start", *(START_POSTURE + np.array([0.9, 0, 0, 0, 0, 0, 0])))


@versions
def test_a_long_way_to_the_trajectory_is_refused_without_a_terminal(scenario: Scenario, version: str) -> None:
    run = scenario(version, "", *FAR)
    assert run.code == REFUSED
    assert "A1 is 0.90 rad from where the trajectory begins" in last_line(run)
    assert len(run.torque) == 0


@pytest.mark.slow
def test_a_long_way_to_the_trajectory_is_gone_when_told_to(scenario: Scenario) -> None:
    assert scenario("2.7", "", *FAR, "--duration", 8, client=("--approach-anyway",)).code == DONE


class Person:
    """At a terminal; answers the client's questions once they are asked."""

    def __init__(self, terminal: int, output: Callable[[], str]) -> None:
        self._terminal = terminal
        self._output = output
        self._asked = 0

    def types(self, text: bytes) -> None:
        """Whatever it is for."""
        os.write(self._terminal, text)

    def answers(self, text: bytes) -> Callable[[object], None]:
        """Return a receiver of messages that types the text once the client has asked once more."""

        def answer(_: object) -> None:
            self._asked += 1
            while self._output().count("[y/n]") < self._asked:
                time.sleep(0.005)
            self.types(text)
            time.sleep(0.1)

        return answer


@pytest.fixture
def person(tmp_path: Path) -> Iterator[tuple[Person, Any]]:
    """A person, and the client's standard input."""
    master, terminal = pty.openpty()
    with os.fdopen(master, "wb"), os.fdopen(terminal, "rb") as stdin:
        yield Person(master, lambda: "".join(file.read_text() for file in tmp_path.glob("client-*.txt"))), stdin


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "code"), [(b"y\n", DONE), (b"n\n", INTERRUPTED)])
def test_a_long_way_to_the_trajectory_is_asked_about(
    scenario: Scenario, person: tuple[Person, Any], answer: bytes, code: int
) -> None:
    """Start far from the trajectory: the arm is held until the question is answered; text typed before is no answer."""
    person[0].types(b"y\n")
    run = scenario("2.7", "", *FAR, "--duration", 8, terminal=person[1], at=[(1.8, person[0].answers(answer))])
    assert run.code == code
    assert "is 0.90 rad from where the trajectory begins. The arm is held. Move there? [y/n]" in run.output
    assert run.client is not None
    waiting = run.client["time"] < 1.8
    assert np.ptp(run.client["q"][waiting], axis=0).max() < 0.01
    if code == INTERRUPTED:
        assert "the move to the trajectory was declined" in last_line(run) and not run.torque[-1].any()


def test_a_yes_is_for_one_way_and_not_for_the_next(scenario: Scenario, person: tuple[Person, Any]) -> None:
    yes, no = person[0].answers(b"y\n"), person[0].answers(b"n\n")
    run = scenario("2.7", "state@2.0:monitoring_ready", *FAR, "--duration", 8, terminal=person[1],
                   at=[(1.8, yes), (3.5, no)])  # fmt: skip
    assert run.code == INTERRUPTED and "the move to the trajectory was declined" in last_line(run)
    assert run.output.count("Move there?") == 2


@versions
def test_faults_are_told_as_they_happen(scenario: Scenario, version: str) -> None:
    run = scenario(version, "robot.drop@1.5,robot.garbage@1.6,robot.nan@1.7")
    lines = {line.split("  ")[-1].split(":")[0] for line in run.output.splitlines() if " s  " in line}
    assert {"lost cycles", "bad datagram", "missing field", "trajectory done"} <= lines
