# SPDX-License-Identifier: MIT
"""The simulated robot that speaks FRI: messages, quality, states and faults."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fri.robot.faults import FaultError, FaultInjector, parse_faults
from fri.robot.messages import (
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
from fri.robot.robot import quaternion
from fri.robot.session import Policy, QualityMeter, Session

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
    """Return a monitoring message with all fields, and its bytes put together by hand."""
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
            # Numbers of blocks and fields are those of the protocol's description; enumerations are written as numbers.
            block(1, number(1, 0x245142), number(2, 300), number(3, 128)),  # header: identifier, sequence, reflected
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
            block(4, number(1, 4), number(2, 2), number(3, 5), number(4, 2)),  # state, quality, period, multiplier
            block(5, joints(1, ipo) if commanding else b"", number(10, 3), number(11, 0), double(12, 0.75)),
        ]
    )
    if version == "2.7":
        body = struct.pack("<I", len(body)) + body + struct.pack("<I", zlib.crc32(body))
    return message, body


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("commanding", [False, True])
def test_monitoring_message_byte_by_byte(version: str, commanding: bool) -> None:
    """Compare an encoded monitoring message with bytes put together by hand from the protocol's description."""
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
    """Compare an encoded torque command with bytes put together by hand; its size is the one seen on the wire."""
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
    """Decode damaged commands: each is refused with its reason, instead of moving the robot."""
    with pytest.raises(MessageError, match=reason):
        Protocol(version).decode_command(datagram)


def test_unknown_version() -> None:
    with pytest.raises(MessageError, match=r"1\.15, 2\.5, 2\.7"):
        Protocol("1.11")


def test_quaternion_is_the_rotation() -> None:
    """Compare the quaternion of rotations, half turns included, with SciPy's up to sign."""
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
    """Compare the quality with its thresholds: FAIR from 70 % of answers in time, GOOD from 95 %, EXCELLENT from 99
    %.
    """
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
    """Answer three cycles late, which the grace of three covers, and four cycles late, which it does not."""
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
    assert late.missing == 197  # 200 cycles less the three of the start


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_one_answer_is_due_in_so_many_messages(phase: int) -> None:
    """Answer each third message, as the receive multiplier asks for: none is missing."""
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
    """Step through the states of a session: 100 cycles are 1 s, and each state lasts as the policy says."""
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
    """Send incomplete commands: they count as no command, and after 100 cycles (1 s) the session ends."""
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
    """Leave out 100 commands (1 s), which the robot survives, and then 101, which end the motion."""
    script = Script(duration=10)
    script.to_active()
    script.cycles(100, complete=False)
    script.cycles(1)
    script.cycles(100, complete=False)
    assert script.session.state is S.COMMANDING_ACTIVE
    script.cycles(1, complete=False)
    assert script.session.state is S.MONITORING_READY


def test_quality_breaks_motions_off_and_they_start_again_so_often() -> None:
    """Let the quality fall twice with one restart allowed: the second fall ends the session."""
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
    """Break a motion off after 0.6 s: the next one lasts the remaining 0.4 s."""
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
    """Let the quality alternate for 10 s (1000 cycles): the session gives up instead of waiting for ever."""
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
    """Give misspelt fault options: each is refused with what is wrong."""
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
    """Inject one loss at 0.01 s and two duplicates at 0.03 s: counts and names tell of them."""
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
    """Decode messages with spoiled fields: six values, NaN, or no field, and nothing else changes."""
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
