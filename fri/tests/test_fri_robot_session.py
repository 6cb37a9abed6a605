# SPDX-License-Identifier: MIT
"""The simulated robot that speaks FRI: the arm and whole sessions."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from examples.bowl_wiping.bowl import bowl_plant
from examples.experiments.plant import MOTOR_INERTIA, START_POSTURE
from fri.robot.link import LinkError
from fri.robot.messages import (
    VERSIONS,
    Command,
    CommandMode,
    IODirection,
    IOType,
    IOValue,
    Quality,
    SafetyState,
    SessionState,
)
from fri.robot.robot import Robot
from fri.robot.session import Policy
from fri.support.python_client import Outcome, PythonClient, emulate, follow, free_port, fri_robot
from support.project import ROOT

S = SessionState
BUTTON = IOValue("MediaFlange.UserButton", IOType.BOOLEAN, IODirection.INPUT, True)

# ---- the controller -------------------------------------------------------------------------------------------------

FREE = START_POSTURE + np.array([0.2, -0.6, 0.1, 0.2, 0.3, -0.4, 0.5])  # away from joint limits


def make_robot(plate: ModuleType, stiffness: float, mode: CommandMode = CommandMode.TORQUE) -> Robot:
    return Robot(bowl_plant(surface=False, q=FREE), plate, MOTOR_INERTIA, np.full(7, stiffness), mode, Policy())


def test_joint_impedance_gives_way_as_a_spring(plate: ModuleType) -> None:
    """Push with constant torques for 2 s: the deflection [rad] is torque / stiffness, and the arm is at rest."""
    robot = make_robot(plate, 200.0)  # [N m/rad]
    torque = np.array([15.0, -12, 10, 8, -6, 4, 5])  # [N m]
    robot.release()
    robot.command(Command(0, 0, FREE, torque, ()))
    for _ in range(400):
        robot.step(0.005)
    np.testing.assert_allclose(robot.q - FREE, torque / 200.0, rtol=2e-3)
    assert np.abs(robot.dq).max() < 1e-3  # [rad/s]


def test_without_stiffness_the_torque_alone_moves_the_arm(plate: ModuleType) -> None:
    """Step 1 ms without joint stiffness: dq [rad/s] is that of M^-1 torque, with the rotors' inertia."""
    robot = make_robot(plate, 0.0)
    torque = np.array([1.0, -1, 1, 1, -1, 1, -1])
    robot.release()
    robot.command(Command(0, 0, FREE + 0.1, torque, ()))
    robot.step(0.001)
    np.testing.assert_array_equal(robot.applied, torque)
    M = plate.mass_matrix(FREE) + MOTOR_INERTIA * np.eye(7)
    np.testing.assert_allclose(robot.dq, 0.001 * np.linalg.solve(M, torque), rtol=1e-3)


def test_hold_keeps_the_arm_where_it_is(plate: ModuleType) -> None:
    """Stop a moving arm: it stays within 1e-6 rad for 1 s and measures gravity alone."""
    robot = make_robot(plate, 0.0)
    robot.release()
    robot.command(Command(0, 0, FREE, np.full(7, 5.0), ()))
    robot.step(0.05)
    assert np.abs(robot.dq).max() > 0.1
    robot.hold()
    where = robot.q
    for _ in range(100):
        robot.step(0.01)
    np.testing.assert_allclose(robot.q, where, atol=1e-6)
    np.testing.assert_array_equal(robot.commanded_position, where)
    np.testing.assert_allclose(robot.measured_torque, robot.plant.data.qfrc_bias, atol=1e-3)


def test_pose_is_in_millimetres(plate: ModuleType) -> None:
    pose = make_robot(plate, 0.0).pose()
    expected = plate.forward_kinematics(FREE)
    np.testing.assert_allclose(pose[:3], 1000 * expected[:3, 3])
    np.testing.assert_allclose(Rotation.from_quat(pose[[4, 5, 6, 3]]).as_matrix(), expected[:3, :3], atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "position", "torque", "reason"),
    [
        (3, 0.18, 0.0, r"illegal axis delta: commanded position of \S+4 is \+10.3 degrees"),
        (3, -0.18, 0.0, "-10.3 degrees"),
        (0, 0.17, 320.0, None),
        (0, 0.0, 320.1, r"commanded torque of \S+1 is 320.1 N m, limit 320"),
        (6, 0.0, -40.1, "limit 40"),
        (2, np.nan, 0.0, r"position of \S+3 is nan"),
        (2, 0.0, np.inf, r"torque of \S+3 is inf"),
    ],
)
def test_objections(plate: ModuleType, joint: int, position: float, torque: float, reason: str | None) -> None:
    """Command values at the robot's limits: an axis delta of 10 degrees (0.1745 rad) per cycle, and the torque limits
    [N m].
    """
    at, of = FREE.copy(), np.zeros(7)
    at[joint] += position
    of[joint] = torque
    found = make_robot(plate, 0.0).objection(Command(0, 0, at, of, ()))
    assert (found is None) == (reason is None)
    assert reason is None or re.search(reason, found)


# ---- sessions -------------------------------------------------------------------------------------------------------

WAY = ["MONITORING_WAIT", "MONITORING_READY", "COMMANDING_WAIT", "COMMANDING_ACTIVE", "MONITORING_READY"]
LOCKSTEP = ("--lockstep", "--duration", 0.2, "--send-period", 5, "--answer-timeout", 5)


@pytest.fixture
def session(tmp_path: Path, plate_folder: Path) -> Iterator[Any]:
    def run(client: PythonClient, *options: object) -> Outcome:
        with client:
            return emulate(tmp_path, plate_folder, client.protocol.version, client.port, *options)

    yield run


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_a_session_in_each_version(session: Any, plate: ModuleType, version: str) -> None:
    """Run a whole session: states, fields of its messages, time stamps and counters are those of the FRI version."""
    client = PythonClient(version)
    outcome = session(client, *LOCKSTEP)
    assert (outcome.code, outcome.summary["end"]) == (0, "as planned")
    assert outcome.states == WAY
    active = [m for m in client.seen if m.connectionInfo.sessionState == S.COMMANDING_ACTIVE]
    assert len(active) == 40  # 0.2 s of 5 ms each
    message = active[20]
    q = np.array(message.monitorData.measuredJointPosition.value)
    pose = plate.forward_kinematics(q)
    if version == "1.15":
        # Commanded is what was measured a cycle before.
        assert list(message.monitorData.commandedJointPosition.value) == list(
            active[19].monitorData.measuredJointPosition.value
        )
    else:
        np.testing.assert_allclose(message.monitorData.measuredCartesianPose.element[:3], 1000 * pose[:3, 3])
        assert message.monitorData.measuredRedundancyInformation.value == q[2]
    assert (message.ipoData.clientCommandMode, message.ipoData.overlayType) == (CommandMode.TORQUE, 1)
    assert (message.robotInfo.controlMode, list(message.robotInfo.driveState)) == (2, [2] * 7)
    np.testing.assert_allclose(message.ipoData.jointPosition.value, START_POSTURE, atol=1e-9)
    assert message.ipoData.trackingPerformance == 1.0
    first = client.seen[0]
    assert not first.ipoData.HasField("jointPosition")
    assert (first.ipoData.clientCommandMode, first.robotInfo.controlMode, first.ipoData.trackingPerformance) == (
        0,
        0,
        0,
    )
    stamps = [m.monitorData.timestamp.sec * 10**9 + m.monitorData.timestamp.nanosec for m in client.seen]
    assert stamps[0] == 1_700_000_000 * 10**9
    assert set(np.diff(stamps)) == {5_000_000}
    count = len(client.seen)
    assert [m.header.sequenceCounter for m in client.seen] == list(range(count))
    # The answer to each message is there before the next one: reflected in it, and judged at once.
    assert [m.header.reflectedSequenceCounter for m in client.seen] == [0, *range(count - 1)]
    assert np.argmax(outcome.log["state"] == S.MONITORING_READY) == 95


@pytest.mark.slow
def test_lockstep_sessions_are_equal(session: Any) -> None:
    digests = [session(PythonClient("2.5"), *LOCKSTEP, "--bowl").summary["digest"] for _ in range(2)]
    assert digests[0] == digests[1]
    other = session(PythonClient("2.5", lambda m: (follow(m)[0], np.full(7, 1e-13))), *LOCKSTEP, "--bowl")
    assert other.summary["digest"] != digests[0]


@pytest.mark.parametrize("multiplier", [2, 3])
def test_receive_multiplier(session: Any, multiplier: int) -> None:
    """Ask for an answer to each 2nd or 3rd message: the robot accepts that many and misses none."""
    client = PythonClient("1.15")
    outcome = session(client, "--lockstep", "--duration", 0.1, "--send-period", 1, "--receive-multiplier", multiplier)
    assert outcome.code == 0
    assert outcome.summary["sent"] // multiplier == outcome.summary["accepted"]
    assert client.seen[0].connectionInfo.receiveMultiplier == multiplier
    assert outcome.log["tracking"].max() == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (lambda m: (follow(m)[0], None), "no complete command"),
        (lambda m: (None, np.zeros(7)), "no complete command"),
        (lambda m: (follow(m)[0] + 0.2, np.zeros(7)), "illegal axis delta"),
        (lambda m: (follow(m)[0], np.full(7, np.nan)), "is nan"),
        (lambda m: (follow(m)[0], np.full(7, 41.0)), "limit 40"),
    ],
)
def test_bad_commands_end_the_session(session: Any, answer: Any, reason: str) -> None:
    """Command what a robot must refuse: it names the reason, stops (safety stop 1) and stays finite."""
    outcome = session(PythonClient("2.7", answer), *LOCKSTEP)
    assert outcome.code == 1
    assert reason in outcome.summary["end"]
    assert reason in outcome.text
    assert outcome.states[:3] == WAY[:3]
    assert outcome.log["safety"][-1] == SafetyState.SAFETY_STOP_LEVEL_1
    assert np.isfinite(outcome.log["q"]).all()


def test_the_arm_that_moves_too_far_is_stopped(session: Any) -> None:
    outcome = session(PythonClient("2.5", lambda m: (follow(m)[0], np.array([0, 0, 0, 0, 0, 0, 39.0]))), *LOCKSTEP[:1],
                      "--duration", 3, "--send-period", 2)  # fmt: skip
    assert outcome.code == 1
    assert "is too fast" in outcome.summary["end"]


def test_position_mode_follows_the_commanded_position(session: Any) -> None:
    """Command positions 0.05 rad beside the interpolator's: the robot goes there, within 2 mrad."""
    shift = np.array([0, 0.05, 0, -0.05, 0, 0.05, 0])
    client = PythonClient(
        "2.5",
        lambda m: (
            np.array(m.ipoData.jointPosition.value) + shift if m.ipoData.HasField("jointPosition") else follow(m)[0],
            None,
        ),
    )
    outcome = session(client, "--lockstep", "--duration", 1.5, "--command-mode", "position", "--stiffness", 500)
    assert outcome.code == 0
    active = outcome.log["state"] == S.COMMANDING_ACTIVE
    np.testing.assert_allclose(outcome.log["q"][active][-1] - outcome.log["ipo"][active][0], shift, atol=2e-3)
    assert set(outcome.log["command_mode"][active]) == {CommandMode.POSITION}


def test_inputs_and_outputs(session: Any) -> None:
    """Set outputs and press the button from 0.1 to 0.2 s (messages 20 to 39): messages show values, unknown names are
    refused.
    """
    wish = (
        IOValue("A.Level", IOType.ANALOG, IODirection.OUTPUT, 0.25),
        IOValue("No.Such", IOType.BOOLEAN, IODirection.OUTPUT, 1),
    )
    client = PythonClient("2.7", outputs=wish)
    outcome = session(client, *LOCKSTEP, "--io", "A.Level=0.5", "--io", "B.Count=7", "--press-button", 0.1, 0.2)
    assert outcome.code == 0
    ios = [
        {io.name: (io.type, io.digitalValue, io.analogValue) for io in m.monitorData.readIORequest} for m in client.seen
    ]
    assert list(ios[0].values()) == [(0, 0, 0.0), (2, 0, 0.5), (1, 7, 0.0)]
    assert ios[1]["A.Level"] == (2, 0, 0.25)
    assert [k for k, io in enumerate(ios) if io["MediaFlange.UserButton"][1]] == list(range(20, 40))
    assert outcome.summary["rejected"] == {"IO": outcome.summary["accepted"]}


def test_state_and_quality_faults(session: Any) -> None:
    """Force a state and a quality: the session starts again after each, and both are counted."""
    outcome = session(PythonClient("1.15"), "--lockstep", "--duration", 0.4, "--send-period", 2,
                      "--faults", "state@0.5:monitoring_wait,quality@1.0-1.1:fair")  # fmt: skip
    assert outcome.code == 0
    assert outcome.states == [*WAY[:4], "MONITORING_WAIT", *WAY[1:4], "MONITORING_WAIT", *WAY[1:4], WAY[4]]
    assert outcome.summary["forced_states"] == 1
    low = (outcome.log["time"] > 0.999) & (outcome.log["time"] < 1.099)
    assert outcome.log["quality"][low].max() == Quality.FAIR
    assert outcome.summary["motions_broken_off"] == 2


@pytest.mark.slow
def test_faults_of_both_ways_in_lockstep(session: Any) -> None:
    """Inject faults both ways: counts of robot and client agree, and equal seeds give equal digests."""
    faults = "robot.garbage=0.02@0.2-0.8,client.drop=0.05@0.2-0.8,client.six=0.02@0.2-0.8,robot.drop=0.03@0.2-0.8"
    options = ("--lockstep", "--duration", 0.3, "--send-period", 2, "--thresholds", 0.6, 0.5, 0.4, "--faults", faults)
    client = PythonClient("2.5")
    outcome = session(client, *options)
    assert outcome.code == 0
    counts = outcome.summary["faults"]
    assert len(client.bad) == counts["robot"]["garbage"] > 0
    assert len(client.seen) - 1 == outcome.summary["sent"] - counts["robot"]["garbage"] - counts["robot"]["drop"]
    lost = sum(counts["robot"].values()) + sum(counts["client"].values())
    assert outcome.summary["missing_answers"] == lost
    assert outcome.summary["rejected"] == {"number of joint values": counts["client"]["six"]}
    again = session(PythonClient("2.5"), *options)
    assert again.summary["digest"] == outcome.summary["digest"]
    other = session(PythonClient("2.5"), *options, "--seed", 1)
    assert other.summary["digest"] != outcome.summary["digest"]


def test_commands_that_come_twice_or_late_are_dropped(session: Any) -> None:
    faults = "client.duplicate@0.2,client.duplicate@0.3,client.reorder@0.4"
    outcome = session(PythonClient("2.7"), *LOCKSTEP, "--faults", faults)
    assert outcome.code == 0
    assert outcome.summary["rejected"] == {"out of order or twice": 3}
    assert outcome.summary["accepted"] == outcome.summary["sent"] - 1


@pytest.mark.slow
def test_by_the_clock(session: Any) -> None:
    """Run by the real clock instead of lockstep: same states, and stamps 10 ms apart."""
    client = PythonClient("2.7")
    outcome = session(client, "--duration", 0.2, "--send-period", 10, "--thresholds", 0.5, 0.4, 0.3)
    assert outcome.code == 0
    assert outcome.states == WAY
    assert client.seen[0].monitorData.timestamp.sec > 1_700_000_000
    assert set(np.diff(outcome.log["timestamp"])) == {10_000_000}


def test_a_client_that_goes_is_noticed(session: Any) -> None:
    """Stop answering at message 50: the robot ends the session with exit code 1 and names the client."""
    client = PythonClient("1.15")

    def leave(message: Any) -> Any:
        if message.header.sequenceCounter == 50:
            client.socket.settimeout(0.01)
            return None
        return follow(message)

    client.answer = leave
    outcome = session(client, *LOCKSTEP[:5], "--answer-timeout", 0.5)
    assert outcome.code == 1
    assert "the client" in outcome.summary["end"]


def test_a_client_that_names_the_robots_host_takes_its_port_alone(session: Any) -> None:
    """Its socket is connected to the same port number; the kernel drops datagrams from anywhere else."""
    client = PythonClient("2.7", robot_host="127.0.0.2")
    outcome = session(client, *LOCKSTEP, "--robot-host", "127.0.0.2", "--robot-port", client.port)
    assert outcome.code == 0 and outcome.states[-2:] == WAY[-2:] and len(client.seen) > 200


def test_nobody_listens(tmp_path: Path, plate_folder: Path) -> None:
    with pytest.raises(LinkError, match="no client listens"):
        emulate(tmp_path, plate_folder, "2.7", free_port(), *LOCKSTEP[:5], "--answer-timeout", 0.2)
    assert not list(tmp_path.iterdir())


def test_a_robot_without_a_sensor_is_refused(robot_folder: Path) -> None:
    with pytest.raises(
        fri_robot.RefusedError, match=r"has no force-torque sensor: run 'make build/robots/iiwa14_plate'"
    ):
        fri_robot.load_robot(robot_folder)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--send-period", 0), "1 to 10 ms"),
        (("--send-period", 11), "1 to 10 ms"),
        (("--receive-multiplier", 0), "--receive-multiplier 0"),
        (("--port", 70000), "--port 70000"),
        (("--duration", 0), "--duration 0.0"),
        (("--stiffness", 1, 2), "one number or 7"),
        (("--stiffness", -1), "not negative"),
        (("--thresholds", 0.5, 0.6, 0.7), "falling"),
        (("--io", "x"), "Group.Name=true"),
        (("--start", 9, 0, 0, 0, 0, 0, 0), "beyond its limits"),
        (("--robot", "nowhere"), "make build/robots/iiwa14_plate"),
        (("--robot-port", 70000), "--robot-port 70000"),
        (("--sensor-port", 70000), "--sensor-port 70000"),
        (("--weight", 11), "--weight 11.0: takes 0 to 10 kg"),
        (("--robot-port", "taken"), "cannot send from 0.0.0.0:"),
        (("--host", "not.an.address.invalid"), "cannot send to"),
        (("--log", "nowhere/log.npz"), "no folder nowhere"),
    ],
)
def test_refusals(
    options: tuple[object, ...], reason: str, plate_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    """Give faulty options: exit code 2 (refused) and one line with the reason."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        words = [taken.getsockname()[1] if option == "taken" else option for option in options]
        given = ["fri_robot", "--protocol", "2.7", "--robot", plate_folder, "--port", 9, *words]
        monkeypatch.setattr(sys, "argv", list(map(str, given)))
        assert fri_robot.main() == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1


def test_the_module_runs_and_says_what_is_missing() -> None:
    hidden = "import runpy, sys; sys.modules['mujoco'] = None; runpy.run_module('fri.robot', run_name='__main__')"
    run = subprocess.run([sys.executable, "-c", hidden], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (2, "mujoco is not installed: pip install -e '.[examples]'\n")
