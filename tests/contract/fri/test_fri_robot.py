# SPDX-License-Identifier: MIT
"""The simulated robot that speaks FRI: messages, quality and states, faults, the controller, and sessions."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from examples.bowl_wiping.plant import MOTOR_INERTIA, START_POSTURE, Plant
from examples.fri_robot.emulator import LinkError
from examples.fri_robot.faults import FaultError, FaultInjector, parse_faults
from examples.fri_robot.messages import (
    VERSIONS,
    Command,
    CommandMode,
    IODirection,
    IOType,
    IOValue,
    MessageError,
    Monitoring,
    Protocol,
    Quality,
    SafetyState,
    SessionState,
)
from examples.fri_robot.robot import Robot, quaternion
from examples.fri_robot.session import Policy, QualityMeter, Session
from support.fri_python_client import Outcome, PythonClient, emulate, follow, free_port, fri_robot
from support.project import ROOT

S = SessionState
BUTTON = IOValue("MediaFlange.UserButton", IOType.BOOLEAN, IODirection.INPUT, True)

# ---- messages, against bytes written by hand from the wire format ---------------------------------------------------


def varint(value: int) -> bytes:
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def double(field: int, value: float) -> bytes:
    return varint(field << 3 | 1) + struct.pack("<d", value)


def block(field: int, *content: bytes) -> bytes:
    body = b"".join(content)
    return varint(field << 3 | 2) + varint(len(body)) + body


def joints(field: int, values: Any) -> bytes:
    return block(field, *(double(1, v) for v in values))


def packed(field: int, values: Any) -> bytes:
    return block(field, struct.pack(f"<{len(values)}d", *values))


def rows(count: int) -> np.ndarray:
    return np.arange(7.0 * count).reshape(count, 7) / 8


def example(version: str, commanding: bool) -> tuple[Monitoring, bytes]:
    q, torque, command, sent, external, ipo, pose = rows(7)
    message = Monitoring(
        state=S.COMMANDING_ACTIVE, quality=Quality.GOOD, send_period=5, receive_multiplier=2, sequence=300,
        reflected=128, safety=SafetyState.SAFETY_STOP_LEVEL_2, command_mode=CommandMode.TORQUE, position=q,
        torque=torque, commanded_position=command, commanded_torque=sent, external_torque=external,
        external_force=np.arange(6.0), pose=pose, redundancy=-0.5, ios=[BUTTON],
        ipo=ipo if commanding else None, tracking=0.75, sent_at=1_700_000_000_999_000_000,
    )  # fmt: skip
    is_2x = version != "1.15"
    body = b"".join(
        [
            block(1, number(1, 0x245142), number(2, 300), number(3, 128)),
            block(2, number(1, 7), number(2, 3), number(5, 2) * 7, number(6, 2), number(7, 0)),
            block(
                3,
                joints(1, q),
                joints(2, torque),
                b"" if is_2x else joints(3, command),
                joints(4, sent),
                joints(5, external),
                block(6, packed(1, np.arange(6.0))) if version == "2.7" else b"",
                block(8, block(1, b"MediaFlange.UserButton"), number(2, 0), number(3, 0), number(4, 1)),
                block(9, block(1, b""), packed(2, pose)) if is_2x else b"",
                block(10, number(1, 0), double(2, -0.5)) if is_2x else b"",
                block(15, number(1, 1_700_000_000), number(2, 999_000_000)),
            ),
            block(4, number(1, 4), number(2, 2), number(3, 5), number(4, 2)),
            block(5, joints(1, ipo) if commanding else b"", number(10, 3), number(11, 0), double(12, 0.75)),
        ]
    )
    if version == "2.7":
        body = struct.pack("<I", len(body)) + body + struct.pack("<I", zlib.crc32(body))
    return message, body


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("commanding", [False, True])
def test_monitoring_message_byte_by_byte(version: str, commanding: bool) -> None:
    message, datagram = example(version, commanding)
    protocol = Protocol(version)
    assert protocol.encode_monitoring(message) == datagram
    decoded = protocol.decode_monitoring(datagram)
    assert list(decoded.monitorData.externalTorque.value) == list(message.external_torque)


@pytest.mark.parametrize(("version", "size"), [("1.15", 501), ("2.5", 511), ("2.7", 571)])
def test_size_while_commanding(version: str, size: int) -> None:
    assert len(Protocol(version).encode_monitoring(example(version, commanding=True)[0])) == size


def test_size_while_monitoring() -> None:
    message, _ = example("1.15", commanding=False)
    message.sequence = message.reflected = 100
    assert len(Protocol("1.15").encode_monitoring(message)) == 434


@pytest.mark.parametrize(("version", "size"), [("1.15", 145), ("2.5", 145), ("2.7", 153)])
def test_torque_command_byte_by_byte(version: str, size: int) -> None:
    position, torque = rows(2)
    header = bytes.fromhex("0a0a 0881800d 10c701 18c801".replace(" ", ""))
    body = header + bytes.fromhex("128201") + joints(1, position) + joints(3, torque)
    protocol = Protocol(version)
    datagram = protocol.frame(body)
    assert len(datagram) == size
    assert protocol.encode_command(Command(199, 200, position, torque, ())) == datagram
    command = protocol.decode_command(datagram)
    assert (command.sequence, command.reflected) == (199, 200)
    np.testing.assert_array_equal([command.position, command.torque], [position, torque])


def test_packed_joint_values_are_read_too() -> None:
    header = block(1, number(1, 0x34001), number(2, 1), number(3, 2))
    body = header + block(2, block(3, packed(1, np.arange(7.0))))
    command = Protocol("1.15").decode_command(body)
    np.testing.assert_array_equal(command.torque, np.arange(7.0))
    assert command.position is None


def test_output_in_a_command() -> None:
    header = block(1, number(1, 0x34001), number(2, 1), number(3, 2))
    io = block(5, block(1, b"A.B"), number(2, 2), number(3, 1), double(5, 0.5))
    assert Protocol("2.5").decode_command(header + block(2, io)).ios == (
        IOValue("A.B", IOType.ANALOG, IODirection.OUTPUT, 0.5),
    )


GOOD_HEADER = block(1, number(1, 0x34001), number(2, 1), number(3, 2))


@pytest.mark.parametrize(
    ("version", "datagram", "reason"),
    [
        ("1.15", b"", "empty"),
        ("1.15", b"\xff" * 40, "no message"),
        ("1.15", block(1, number(1, 0x34001), number(3, 2)), "missing: header.sequenceCounter"),
        ("1.15", block(1, number(1, 0x34002), number(2, 1), number(3, 2)), "identifier 0x34002"),
        ("1.15", GOOD_HEADER + block(2, joints(3, range(6))), "jointTorque has 6 values"),
        ("1.15", GOOD_HEADER + block(2, joints(3, range(8))), "jointTorque has 8 values"),
        ("1.15", GOOD_HEADER + block(2, block(5, block(1, b"x"), number(2, 9), number(3, 0))), "IO 'x'"),
        ("2.7", GOOD_HEADER, "length"),
        ("2.7", b"1234567", "too short"),
        ("2.7", struct.pack("<I", 99) + GOOD_HEADER + b"1234", "length 99"),
        ("2.7", struct.pack("<I", len(GOOD_HEADER)) + GOOD_HEADER + b"1234", "CRC"),
    ],
)
def test_what_is_no_command(version: str, datagram: bytes, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        Protocol(version).decode_command(datagram)


def test_unknown_version() -> None:
    with pytest.raises(MessageError, match=r"1\.15, 2\.5, 2\.7"):
        Protocol("1.11")


def test_quaternion_is_the_rotation() -> None:
    turns = [
        *Rotation.random(50, rng=np.random.default_rng(2)),
        Rotation.from_euler("x", np.pi),
        Rotation.from_euler("z", np.pi),
    ]
    for turn in turns:
        x, y, z, w = turn.as_quat(canonical=True)
        found = quaternion(turn.as_matrix())
        np.testing.assert_allclose(found * np.sign(found @ [w, x, y, z]), [w, x, y, z], atol=1e-12)
        assert found[0] >= 0


# ---- quality and states ---------------------------------------------------------------------------------------------


def test_quality_is_the_share_of_answers_in_time() -> None:
    meter = QualityMeter(Policy(), multiplier=1, grace_cycles=0)
    found = {}
    for k in range(100):
        meter.answered(k)
        found[k + 1] = meter.judge(k)
    assert [found[k] for k in (69, 70, 94, 95, 98, 99)] == [Quality(q) for q in (0, 1, 1, 2, 2, 3)]
    for k, expected in ((100, Quality.EXCELLENT), (101, Quality.GOOD)):
        assert meter.judge(k) is expected
    assert meter.missing == 2


def test_late_answers_have_grace() -> None:
    meter = QualityMeter(Policy(), multiplier=1, grace_cycles=3)
    for k in range(200):
        if k >= 3:
            meter.answered(k - 3)
        meter.judge(k)
    assert meter.missing == 0
    late = QualityMeter(Policy(), multiplier=1, grace_cycles=3)
    for k in range(200):
        if k >= 4:
            late.answered(k - 4)
        late.judge(k)
    assert late.missing == 197


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_one_answer_is_due_in_so_many_messages(phase: int) -> None:
    meter = QualityMeter(Policy(), multiplier=3, grace_cycles=0)
    for k in range(300):
        if k % 3 == phase:
            meter.answered(k)
        quality = meter.judge(k)
    assert (quality, meter.missing) == (Quality.EXCELLENT, 0)


class Script:
    """A session of 10 ms that is told what each cycle brought."""

    def __init__(self, duration: float = 1.0, restarts: int = 1) -> None:
        self.changes: list[str] = []
        self.session = Session(
            0.01, Policy(), duration, restarts, lambda _old, new, _reason: self.changes.append(new.name)
        )
        self.session.open()

    def cycles(
        self, count: int, quality: Quality = Quality.EXCELLENT, answered: bool = True, complete: bool = True
    ) -> None:
        for _ in range(count):
            self.session.advance(quality, answered=answered, complete=complete)

    def to_active(self) -> None:
        self.cycles(1 + 100 + 20)
        assert self.session.state is S.COMMANDING_ACTIVE


def test_the_way_of_a_session() -> None:
    script = Script()
    session = script.session
    script.cycles(3, Quality.FAIR)
    assert session.state is S.MONITORING_WAIT
    script.cycles(1, Quality.GOOD)
    assert session.state is S.MONITORING_READY
    script.cycles(99)
    assert session.state is S.MONITORING_READY
    script.cycles(1)
    assert session.state is S.COMMANDING_WAIT
    script.cycles(19)
    assert session.state is S.COMMANDING_WAIT
    script.cycles(1)
    assert session.state is S.COMMANDING_ACTIVE
    script.cycles(99)
    assert session.state is S.COMMANDING_ACTIVE
    script.cycles(1)
    assert session.state is S.MONITORING_READY
    script.cycles(99)
    assert session.state is S.MONITORING_READY
    script.cycles(1)
    assert session.state is S.IDLE
    assert session.failure is None


def test_incomplete_commands_do_not_count_and_abort_after_a_second() -> None:
    script = Script()
    script.cycles(101)
    script.cycles(100, complete=False)
    assert script.session.state is S.COMMANDING_WAIT
    script.cycles(1, complete=False)
    assert script.session.state is S.MONITORING_READY
    script.cycles(100)
    assert script.session.state is S.IDLE
    assert "no complete command for 1 s" in script.session.failure


def test_a_missed_second_aborts_the_motion_a_shorter_gap_does_not() -> None:
    script = Script(duration=10)
    script.to_active()
    script.cycles(100, complete=False)
    script.cycles(1)
    script.cycles(100, complete=False)
    assert script.session.state is S.COMMANDING_ACTIVE
    script.cycles(1, complete=False)
    assert script.session.state is S.MONITORING_READY


def test_quality_breaks_motions_off_and_they_start_again_so_often() -> None:
    script = Script(restarts=1)
    script.to_active()
    script.cycles(1, Quality.FAIR)
    assert script.session.state is S.MONITORING_WAIT
    script.to_active()
    script.cycles(1, Quality.POOR)
    script.cycles(100, Quality.POOR)
    assert script.session.state is S.IDLE
    assert "broken off 2 times" in script.session.failure


def test_time_in_active_adds_up_over_motions() -> None:
    script = Script(duration=1.0)
    script.to_active()
    script.cycles(60)
    script.session.force(S.MONITORING_READY)
    script.cycles(120)
    assert script.session.state is S.COMMANDING_ACTIVE
    script.cycles(39)
    assert script.session.state is S.COMMANDING_ACTIVE
    script.cycles(1)
    assert script.session.state is S.MONITORING_READY
    script.cycles(100)
    assert (script.session.state, script.session.failure) == (S.IDLE, None)


def test_no_answer_for_two_seconds_ends_the_session() -> None:
    script = Script()
    script.cycles(200, Quality.POOR, answered=False, complete=False)
    assert script.session.state is S.MONITORING_WAIT
    script.cycles(1, Quality.POOR, answered=False, complete=False)
    assert script.session.state is S.IDLE
    assert "no answer" in script.session.failure


def test_quality_that_never_gets_good_ends_the_session() -> None:
    script = Script()
    for _ in range(500):
        script.cycles(1, Quality.GOOD)
        script.cycles(1, Quality.FAIR)
    assert script.session.state is not S.IDLE
    script.cycles(1, Quality.FAIR)
    assert script.session.state is S.IDLE
    assert "quality FAIR after 10 s" in script.session.failure


# ---- faults ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("drop", "give a probability"),
        ("drip=0.1", "no kind 'drip'; there are drop"),
        ("drop=1.5", "from 0 to 1"),
        ("drop=x", "form"),
        ("drop=0.1:7", "no argument"),
        ("delay=0.1:0", "number of cycles"),
        ("silence@2", "interval"),
        ("silence=0.1@2-3", "interval"),
        ("silence@3-2", "ends before"),
        ("state@2-3:idle", "a time"),
        ("state@2:asleep", "MONITORING_WAIT"),
        ("client.state@2:idle", "robot alone"),
        ("quality@2-3:bad", "POOR"),
        ("missing=0.1:elbow", "takes one of header.sequenceCounter"),
        ("client.missing=0.1:robotInfo", "jointTorque"),
        ("crc=0.1", "2.7 has"),
        ("drop=0.1;six=0.1", "form"),
    ],
)
def test_refused_faults(text: str, reason: str) -> None:
    with pytest.raises(FaultError, match=reason):
        parse_faults(text, "1.15")


def injector(text: str, direction: str = "robot", version: str = "2.7", seed: int = 1) -> FaultInjector:
    return FaultInjector(Protocol(version), direction, parse_faults(text, version).datagrams[direction], seed)


def through(faults: FaultInjector, count: int, period: float = 0.01) -> list[list[bytes]]:
    """Datagrams b"0", b"1", ... and what arrives in each cycle."""
    found = []
    for k in range(count):
        arriving = faults.send(str(k).encode(), k * period, k) + faults.release(k)
        found.append([delivery.datagram for delivery in arriving])
    return found


def test_probability_seed_and_interval() -> None:
    first, again, other = (through(injector("drop=0.1@1-9", seed=seed), 1000) for seed in (1, 1, 2))
    assert first == again != other
    lost = np.flatnonzero([not found for found in first])
    assert 50 < len(lost) < 110  # 80 expected
    assert lost.min() >= 100
    assert lost.max() < 900


def test_directions_have_random_numbers_of_their_own() -> None:
    assert through(injector("drop=0.5"), 64) != through(injector("drop=0.5", "client"), 64)
    assert through(injector("client.drop=0.5"), 64) == [[str(k).encode()] for k in range(64)]


def test_order_of_held_datagrams() -> None:
    assert through(injector("reorder@0.02"), 5) == [[b"0"], [b"1"], [], [b"3", b"2"], [b"4"]]
    both = injector("reorder@0.01,reorder@0.02,drop@0.03")
    assert through(both, 6) == [[b"0"], [], [], [], [b"4", b"1", b"2"], [b"5"]]
    assert through(injector("delay@0.01:3"), 6) == [[b"0"], [], [b"2"], [b"3"], [b"4", b"1"], [b"5"]]
    assert through(injector("duplicate@0.01"), 3) == [[b"0"], [b"1", b"1"], [b"2"]]
    assert through(injector("silence@0.01-0.03"), 4) == [[b"0"], [], [], [b"3"]]


def test_faults_are_counted_and_named() -> None:
    faults = injector("drop@0.01,duplicate=1@0.03-0.05")
    names = []
    for k in range(6):
        faults.send(b"x", k * 0.01, k)
        names.append(faults.last)
    assert names == [None, "drop", None, "duplicate", "duplicate", None]
    assert faults.counts == {"drop": 1, "duplicate": 2}


def spoiled(kind: str, version: str = "2.7", field: str = "") -> bytes:
    message, _ = example(version, commanding=True)
    (delivery,) = injector(f"{kind}@0{field and ':'}{field}", version=version).send(
        Protocol(version).encode_monitoring(message), 0.0, 0
    )
    assert not delivery.intact
    return delivery.datagram


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("crc", "CRC"), ("identifier", "identifier"), ("missing", "header.sequenceCounter"), ("empty", "empty")],
)
def test_spoiled_datagrams_are_what_they_claim(kind: str, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        Protocol("2.7").decode_monitoring(spoiled(kind))


def test_spoiled_values() -> None:
    protocol = Protocol("2.5")
    six = protocol.decode_monitoring(spoiled("six", "2.5"))
    values = [six.monitorData.measuredJointPosition, six.monitorData.externalTorque, six.ipoData.jointPosition]
    assert [len(v.value) for v in values] == [6, 6, 6]
    assert len(six.monitorData.measuredCartesianPose.element) == 7
    nan = protocol.decode_monitoring(spoiled("nan", "2.5"))
    assert np.isnan(nan.monitorData.measuredJointPosition.value).all()
    assert not protocol.decode_monitoring(spoiled("missing", "2.5", "ipoData")).HasField("ipoData")
    assert not protocol.decode_monitoring(spoiled("missing", "2.5", "monitorData.timestamp")).monitorData.HasField(
        "timestamp"
    )


# ---- the controller -------------------------------------------------------------------------------------------------

FREE = START_POSTURE + np.array([0.2, -0.6, 0.1, 0.2, 0.3, -0.4, 0.5])  # away from joint limits


def make_robot(plate: ModuleType, stiffness: float, mode: CommandMode = CommandMode.TORQUE) -> Robot:
    return Robot(Plant(bowl=False, q=FREE), plate, MOTOR_INERTIA, np.full(7, stiffness), mode, Policy())


def test_joint_impedance_gives_way_as_a_spring(plate: ModuleType) -> None:
    robot = make_robot(plate, 200.0)
    torque = np.array([15.0, -12, 10, 8, -6, 4, 5])
    robot.release()
    robot.command(Command(0, 0, FREE, torque, ()))
    for _ in range(400):
        robot.step(0.005)
    np.testing.assert_allclose(robot.q - FREE, torque / 200.0, rtol=2e-3)
    assert np.abs(robot.dq).max() < 1e-3


def test_without_stiffness_the_torque_alone_moves_the_arm(plate: ModuleType) -> None:
    robot = make_robot(plate, 0.0)
    torque = np.array([1.0, -1, 1, 1, -1, 1, -1])
    robot.release()
    robot.command(Command(0, 0, FREE + 0.1, torque, ()))
    robot.step(0.001)
    np.testing.assert_array_equal(robot.applied, torque)
    M = plate.mass_matrix(FREE) + MOTOR_INERTIA * np.eye(7)
    np.testing.assert_allclose(robot.dq, 0.001 * np.linalg.solve(M, torque), rtol=1e-3)


def test_hold_keeps_the_arm_where_it_is(plate: ModuleType) -> None:
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


@pytest.mark.parametrize("version", VERSIONS)
def test_a_session_in_each_version(session: Any, plate: ModuleType, version: str) -> None:
    client = PythonClient(version)
    outcome = session(client, *LOCKSTEP)
    assert (outcome.code, outcome.summary["end"]) == (0, "as planned")
    assert outcome.states == WAY
    active = [m for m in client.seen if m.connectionInfo.sessionState == S.COMMANDING_ACTIVE]
    assert len(active) == 40
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


def test_lockstep_sessions_are_equal(session: Any) -> None:
    digests = [session(PythonClient("2.5"), *LOCKSTEP, "--bowl").summary["digest"] for _ in range(2)]
    assert digests[0] == digests[1]
    other = session(PythonClient("2.5", lambda m: (follow(m)[0], np.full(7, 1e-13))), *LOCKSTEP, "--bowl")
    assert other.summary["digest"] != digests[0]


@pytest.mark.parametrize("multiplier", [2, 3])
def test_receive_multiplier(session: Any, multiplier: int) -> None:
    client = PythonClient("1.15")
    outcome = session(client, "--lockstep", "--duration", 0.1, "--send-period", 1, "--receive-multiplier", multiplier)
    assert outcome.code == 0
    assert outcome.summary["sent"] // multiplier == outcome.summary["accepted"]
    assert client.seen[0].connectionInfo.receiveMultiplier == multiplier
    assert outcome.log["tracking"].max() == 1.0


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
    outcome = session(PythonClient("1.15"), "--lockstep", "--duration", 0.4, "--send-period", 2,
                      "--faults", "state@0.5:monitoring_wait,quality@1.0-1.1:fair")  # fmt: skip
    assert outcome.code == 0
    assert outcome.states == [*WAY[:4], "MONITORING_WAIT", *WAY[1:4], "MONITORING_WAIT", *WAY[1:4], WAY[4]]
    assert outcome.summary["forced_states"] == 1
    low = (outcome.log["time"] > 0.999) & (outcome.log["time"] < 1.099)
    assert outcome.log["quality"][low].max() == Quality.FAIR
    assert outcome.summary["motions_broken_off"] == 2


def test_faults_of_both_ways_in_lockstep(session: Any) -> None:
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


def test_by_the_clock(session: Any) -> None:
    client = PythonClient("2.7")
    outcome = session(client, "--duration", 0.2, "--send-period", 10, "--thresholds", 0.5, 0.4, 0.3)
    assert outcome.code == 0
    assert outcome.states == WAY
    assert client.seen[0].monitorData.timestamp.sec > 1_700_000_000
    assert set(np.diff(outcome.log["timestamp"])) == {10_000_000}


def test_a_client_that_goes_is_noticed(session: Any) -> None:
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


def test_nobody_listens(tmp_path: Path, plate_folder: Path) -> None:
    with pytest.raises(LinkError, match="no client listens"):
        emulate(tmp_path, plate_folder, "2.7", free_port(), *LOCKSTEP[:5], "--answer-timeout", 0.2)
    assert not list(tmp_path.iterdir())


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
        (("--host", "not.an.address.invalid"), "cannot send to"),
        (("--log", "nowhere/log.npz"), "no folder nowhere"),
    ],
)
def test_refusals(
    options: tuple[object, ...], reason: str, plate_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    given = ["fri_robot", "--protocol", "2.7", "--robot", plate_folder, "--port", 9, *options]
    monkeypatch.setattr(sys, "argv", list(map(str, given)))
    assert fri_robot.main() == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1


def test_the_module_runs_and_says_what_is_missing() -> None:
    hidden = (
        "import runpy, sys; sys.modules['mujoco'] = None; runpy.run_module('examples.fri_robot', run_name='__main__')"
    )
    run = subprocess.run([sys.executable, "-c", hidden], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (2, "mujoco is not installed: pip install -e '.[examples]'\n")
