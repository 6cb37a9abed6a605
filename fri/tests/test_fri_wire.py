# SPDX-License-Identifier: MIT
"""The FRI library and the client against an independent codec: fields, states, hostile datagrams.

The robot's messages come from fri/robot/messages.py (protobuf, a schema of its own), so that the two codecs
check each other. They run against the open library, against the stand-in for KUKA's (fri/support/native/standin), and
with FRI_SDK_ROOT (and FRI_SDK_VERSION, if its headers do not tell) against an installed SDK.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fri.robot.messages import IODirection, IOType, IOValue, Protocol
from fri.support.session import (
    POSTURE,
    TIMEOUT,
    Programs,
    RobotScript,
    build,
    fuzz,
)
from fri.support.wiping import (
    COMMANDING_ACTIVE,
    COMMANDING_WAIT,
    IDLE,
    MONITORING_READY,
    MONITORING_WAIT,
)


def counters(line: str) -> bytes:
    """Bytes of a hexadecimal string with spaces."""
    return bytes.fromhex(line.replace(" ", ""))


# ---- building ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["-DFRI_SDK_ROOT=/nowhere"], "no friLBRClient.h or no libFRIClient there"),
        (["-DOPEN_FRI_VERSION=3.0"], "'3.0' is no version of the FRI"),
        (["-DROBOT_NAME=nobody"], "has no nobody_impedance.h"),
    ],
)
def test_wrong_build_option_is_refused_with_the_remedy(options: list[str], wanted: str, tmp_path: Path) -> None:
    """Configure with a wrong option: CMake stops and says what is missing."""
    with pytest.raises(AssertionError, match=re.escape(wanted)):
        build(tmp_path, options, compiler="gcc", flags="")


@pytest.mark.parametrize(("version", "said_by"), [("1.11", "header"), ("1.13", "option"), ("1.9", "option")])
def test_an_sdk_older_than_the_interface_is_refused(version: str, said_by: str, tmp_path: Path) -> None:
    """Configure with an SDK before 1.14, which lacks what the client calls: CMake says so, not the compiler."""
    root = tmp_path / "sdk"
    (root / "include").mkdir(parents=True)
    (root / "lib").mkdir()
    (root / "include" / "friLBRClient.h").touch()
    (root / "lib" / "libFRIClient.a").touch()
    options = [f"-DFRI_SDK_ROOT={root}"]
    if said_by == "header":
        major, minor = version.split(".")
        macros = f"#define FRI_CLIENT_VERSION_MAJOR {major}\n#define FRI_CLIENT_VERSION_MINOR {minor}\n"
        (root / "include" / "friClientVersion.h").write_text(macros)
    else:
        options.append(f"-DFRI_SDK_VERSION={version}")
    with pytest.raises(AssertionError, match=rf"FRI {version} is older than 1\.14, which the client needs"):
        build(tmp_path / "build", options, compiler="gcc", flags="")


# ---- the wire ------------------------------------------------------------------------------------------------------


def test_torque_command_is_byte_for_byte_what_was_seen_on_the_wire(every: Programs) -> None:
    """Compare a command with the bytes recorded from KUKA's client: 145 bytes, 153 with the frame of FRI 2.7."""
    script = every.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 200 - script.sequence - 1)
    torque = np.array([1.0, -2.0, 0.5, 1e-300, -0.0, 320.0, 1 / 3])
    script.add(COMMANDING_ACTIVE, external_torque=torque, position=POSTURE)
    steps = every.probe(script)[:-1]
    values = [b"".join(b"\x09" + struct.pack("<d", x) for x in array) for array in (POSTURE, torque)]
    body = counters("0a0a 0881800d 10c701 18c801 128201 0a3f") + values[0] + counters("1a3f") + values[1]
    assert len(body) == 145
    framed = struct.pack("<I", 145) + body + struct.pack("<I", zlib.crc32(body))
    expected = framed if every.version == "2.7" else body
    assert steps[-1]["sent"] == expected.hex()
    assert len(expected) == (153 if every.version == "2.7" else 145)


def random_fields(rng: np.random.Generator) -> dict[str, Any]:
    """Return random values of all fields of a monitoring message; the pose is in mm."""
    arrays = ("position", "torque", "commanded_position", "commanded_torque", "external_torque", "ipo")
    quaternion = rng.normal(size=4)
    return {
        **{name: rng.normal(size=7) for name in arrays},
        "external_force": rng.normal(size=6),
        "pose": np.concatenate([rng.normal(size=3) * 1e3, quaternion / np.linalg.norm(quaternion)]),
        "redundancy": rng.normal(),
        "quality": int(rng.integers(4)),
        "safety": int(rng.integers(4)),
        "drive": int(rng.integers(3)),
        "operation": int(rng.integers(3)),
        "control": int(rng.integers(4)),
        "overlay": int(rng.integers(3)),
        "tracking": rng.uniform(),
        "ios": [
            IOValue("Group.Lamp", IOType.BOOLEAN, IODirection.OUTPUT, bool(rng.integers(2))),
            IOValue("Group.Word", IOType.DIGITAL, IODirection.OUTPUT, int(rng.integers(2**63)) * 2 + 1),
            IOValue("Group.Level", IOType.ANALOG, IODirection.OUTPUT, rng.normal()),
        ],
    }


def rotation(quaternion: np.ndarray) -> np.ndarray:
    w, v = quaternion[0], quaternion[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def repack(datagram: bytes, protocol: Protocol) -> bytes:
    """Return the message with each array of numbers in the other encoding, fields reversed, and an unknown field."""
    message = protocol.decode_monitoring(datagram)

    def key(number: int, wire: int) -> bytes:
        return varint(number << 3 | wire)

    def varint(value: int) -> bytes:
        out = b""
        while value > 127:
            out += bytes([value & 127 | 128])
            value >>= 7
        return out + bytes([value])

    def encode(m: Any) -> bytes:
        """Return the message in wire format with its fields in reverse order, unpacked arrays packed and the reverse,
        and an unknown field.
        """
        fields = []
        for descriptor, value in m.ListFields():
            number, repeated = descriptor.number, hasattr(value, "append")
            if descriptor.message_type is not None:
                for part in value if repeated else [value]:
                    inside = encode(part)
                    fields.append(key(number, 2) + varint(len(inside)) + inside)
            elif descriptor.type == descriptor.TYPE_STRING:
                fields.append(key(number, 2) + varint(len(value.encode())) + value.encode())
            elif descriptor.type != descriptor.TYPE_DOUBLE and repeated:
                inside = b"".join(map(varint, value))
                fields.append(key(number, 2) + varint(len(inside)) + inside)
            elif descriptor.type != descriptor.TYPE_DOUBLE:
                fields.append(key(number, 0) + varint(value))
            elif m.DESCRIPTOR.name == "JointValues":
                fields.append(key(number, 2) + varint(8 * len(value)) + struct.pack(f"<{len(value)}d", *value))
            else:  # the last first, since all fields are turned round below
                fields += [key(number, 1) + struct.pack("<d", x) for x in (value if repeated else [value])][::-1]
        fields.append(key(77, 2) + varint(5) + b"hello")
        return b"".join(reversed(fields))

    return protocol.frame(encode(message))


def assert_seen(seen: dict[str, Any], sent: dict[str, Any], script: RobotScript, version: str) -> None:
    """Fail unless the client's getters returned what the message contained."""
    for name in ("position", "torque", "commanded_torque", "external_torque", "ipo"):
        np.testing.assert_array_equal(seen[name], sent[name], err_msg=name)
    for name in ("quality", "safety", "drive", "operation", "control", "overlay", "tracking"):
        assert seen[name] == sent[name], name
    assert (seen["state"], seen["mode"], seen["sample_time"]) == (COMMANDING_WAIT, 3, 0.005)
    assert (seen["seconds"], seen["nanoseconds"]) == divmod(script.clock, 10**9)
    lamp, word, level = (io.value for io in sent["ios"])
    assert (seen["lamp"], int(seen["word"]), seen["level"]) == (lamp, word, level)
    assert "lamp_as_analog" not in seen  # another type: refused
    if version == "1.15":
        np.testing.assert_array_equal(seen["commanded_position"], sent["commanded_position"])
    else:
        np.testing.assert_array_equal(seen["pose"], sent["pose"])
        matrix = np.reshape(seen["matrix"], (3, 4))
        np.testing.assert_allclose(matrix[:, :3], rotation(sent["pose"][3:]), atol=1e-14)
        np.testing.assert_array_equal(matrix[:, 3], sent["pose"][:3])
        assert seen["redundancy"] == [sent["redundancy"]]
    if version == "2.7":
        np.testing.assert_array_equal(seen["external_force"], sent["external_force"])


def test_every_getter_gives_what_an_independent_codec_sent(every: Programs) -> None:
    """Send ten messages with random fields, encoded by protobuf: each getter returns its field."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        script, fields = every.script(), random_fields(rng)
        script.add(COMMANDING_WAIT, **fields)
        seen = every.probe(script)[0]
        assert seen["callback"] == "waitForCommand"
        assert_seen(seen, fields, script, every.version)


def test_arrays_in_either_encoding_unknown_fields_and_any_order(every: Programs) -> None:
    script, fields = every.script(), random_fields(np.random.default_rng(4))
    script.datagrams.append(repack(script.message(COMMANDING_WAIT, **fields), script.protocol))
    assert_seen(every.probe(script)[0], fields, script, every.version)


def test_commands_are_read_by_an_independent_codec(every: Programs) -> None:
    """Decode the client's commands by protobuf: position, torque and outputs are what it was told to send."""
    rng = np.random.default_rng(5)
    script = every.script()
    sent = [random_fields(rng) for _ in range(5)]
    for fields in sent:
        script.add(COMMANDING_ACTIVE, **fields)
    for k, (step, fields) in enumerate(zip(every.probe(script), sent, strict=False)):
        command = script.protocol.decode_command(bytes.fromhex(step["sent"]))
        assert (command.sequence, command.reflected) == (k, k + 1)
        np.testing.assert_array_equal(command.position, fields["position"])
        np.testing.assert_array_equal(command.torque, fields["external_torque"])
        assert [(io.name, io.type, io.value) for io in command.ios] == [
            ("Group.Lamp", IOType.BOOLEAN, True),
            ("Group.Word", IOType.DIGITAL, 0xFEDCBA9876543210),
            ("Group.Level", IOType.ANALOG, -0.25),
        ]


# ---- the cycle -----------------------------------------------------------------------------------------------------


def test_states_callbacks_and_idle(every: Programs) -> None:
    """Walk through all states: callbacks and state changes come in the SDK's order, and none is answered in IDLE."""
    script = every.script()
    for state in (IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE, MONITORING_READY, IDLE):
        script.add(state, 2)
    steps = every.probe(script)[:-1]
    assert all(step["step"] for step in steps)
    changes = [step["change"] for step in steps if "change" in step]
    assert changes == [[0, 1], [1, 2], [2, 3], [3, 4], [4, 2], [2, 0]]
    names = [None, "monitor", "monitor", "waitForCommand", "command", "monitor", None]
    assert [step.get("callback") for step in steps] == [name for name in names for _ in range(2)]
    assert [bool(step["sent"]) for step in steps] == [name is not None for name in names for _ in range(2)]


def test_setters_out_of_place_are_refused_from_2_7_on(every: Programs) -> None:
    script = every.script()
    script.add(MONITORING_READY)
    step = every.probe(script)[0]
    assert step["refusals"] == (2 if every.version == "2.7" else 0)
    command = script.protocol.decode_command(bytes.fromhex(step["sent"]))
    assert (command.torque is None) == (every.version == "2.7")


def test_every_nth_message_is_answered(every: Programs) -> None:
    """Announce a receive multiplier of 3: the client answers each third message, with the right counters."""
    script = every.script()
    script.begin(3, 3)
    script.add(COMMANDING_ACTIVE, 12, receive_multiplier=3)
    steps = every.probe(script)[:-1]  # nine before commanding
    assert [bool(step["sent"]) for step in steps[9:]] == 4 * [False, False, True]
    assert all(step["callback"] == "command" for step in steps[9:])
    answers = [script.protocol.decode_command(bytes.fromhex(step["sent"])) for step in steps if step["sent"]]
    assert [answer.sequence for answer in answers] == list(range(len(answers)))
    assert [answer.reflected for answer in answers[-4:]] == [12, 15, 18, 21]


def test_command_is_cleared_each_cycle(every: Programs) -> None:
    """Command in one cycle: outputs and position do not stay in the next command."""
    script = every.script()
    script.begin(1, 1)
    script.add(COMMANDING_ACTIVE, ios=[IOValue("Group.Lamp", IOType.BOOLEAN, IODirection.OUTPUT, False)])
    script.add(MONITORING_WAIT)
    last = script.protocol.decode_command(bytes.fromhex(every.probe(script)[-2]["sent"]))
    assert last.ios == ()
    assert last.position is None or every.version != "2.7"


# ---- hostile traffic -----------------------------------------------------------------------------------------------


def _six(message: Any) -> None:
    message.monitorData.measuredJointPosition.value.pop()


def _eight(message: Any) -> None:
    message.monitorData.externalTorque.value.append(1.0)


def _six_drives(message: Any) -> None:
    message.robotInfo.driveState.pop()


def _eleven_ios(message: Any) -> None:
    for _ in range(11):
        message.monitorData.readIORequest.add(name="x", type=0, direction=0)


CHANGES: dict[str, tuple[str, Callable[[Any], object]]] = {
    "identifier": ("identifier", lambda m: setattr(m.header, "messageIdentifier", 0x34001)),
    "six values": ("joint_count", _six),
    "eight values": ("joint_count", _eight),
    "six drives": ("joint_count", _six_drives),
    "six joints": ("joint_count", lambda m: setattr(m.robotInfo, "numberOfJoints", 6)),
    "no values": ("joint_count", lambda m: m.monitorData.measuredTorque.ClearField("value")),
    "unknown state": ("range", lambda m: setattr(m.connectionInfo, "sessionState", 5)),
    "unknown quality": ("range", lambda m: setattr(m.connectionInfo, "quality", 4)),
    "unknown mode": ("range", lambda m: setattr(m.ipoData, "clientCommandMode", 9)),
    "negative state": ("range", lambda m: setattr(m.connectionInfo, "sessionState", -1)),
    "no header": ("decode", lambda m: m.ClearField("header")),
    "no identifier": ("decode", lambda m: m.header.ClearField("messageIdentifier")),
    "no state": ("decode", lambda m: m.connectionInfo.ClearField("sessionState")),
    "long name": ("decode", lambda m: m.monitorData.readIORequest.add(name="x" * 64, type=0, direction=0)),
    "eleven IOs": ("decode", _eleven_ios),
    "unknown IO type": ("range", lambda m: m.monitorData.readIORequest.add(name="x", type=3, direction=0)),
    "no connection": ("incomplete", lambda m: m.ClearField("connectionInfo")),
    "no measurement": ("incomplete", lambda m: m.ClearField("monitorData")),
    "no interpolator": ("incomplete", lambda m: m.ClearField("ipoData")),
    "nanoseconds": ("range", lambda m: setattr(m.monitorData.timestamp, "nanosec", 10**9)),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_bad_message_is_counted_skipped_and_refused_as_a_whole(name: str, programs: Programs) -> None:
    """Put a bad message between two sound ones: it is counted once, and none of its values shows up later."""
    fault, change = CHANGES[name]
    script = programs.script()
    script.add(COMMANDING_WAIT, position=np.arange(7.0))
    script.add(COMMANDING_WAIT, change=change, position=np.arange(7.0) + 100, ipo=np.zeros(7))
    script.add(COMMANDING_WAIT, position=np.arange(7.0) + 200)
    first, bad, after, statistics = programs.probe(script)
    assert bad["step"] and not bad["sent"] and "callback" not in bad
    assert statistics[fault] == 1 and sum(statistics[k] for k in statistics if k in FAULTS) == 1
    assert first["position"] == list(range(7))
    assert after["position"] == [200.0 + k for k in range(7)]  # in its own order, unmixed
    assert statistics["lost_messages"] == 1 and statistics["messages"] == 2


FAULTS = ("empty", "too_long", "frame", "checksum", "decode", "identifier", "joint_count", "range", "incomplete",
          "duplicate", "out_of_order", "sender")  # fmt: skip


def test_bad_datagrams_of_every_kind_end_no_session(programs: Programs) -> None:
    """Send one datagram of each bad kind: each is counted once, and the session continues."""
    framed = programs.version == "2.7"
    script = programs.script()
    script.begin()
    sound = script.message(COMMANDING_ACTIVE)
    garbage = bytes(range(1, 256))
    bad = {"empty": b"", "too_long": sound + 1500 * b"\x00", ("frame" if framed else "decode"): garbage}
    if framed:
        broken = bytearray(sound)
        broken[100] ^= 1
        bad["checksum"] = bytes(broken)
    script.datagrams += bad.values()
    script.datagrams += [sound, sound]
    bad["duplicate"] = sound
    old = script.message(COMMANDING_ACTIVE)
    script.add(COMMANDING_ACTIVE)
    script.datagrams.append(old)
    bad["out_of_order"] = old
    script.add(COMMANDING_ACTIVE, 2)
    *steps, statistics = programs.probe(script)
    assert all(step["step"] for step in steps)
    assert {k: statistics[k] for k in FAULTS if statistics[k]} == dict.fromkeys(bad, 1)
    assert sum(bool(step["sent"]) for step in steps) == statistics["messages"] == len(steps) - len(bad)


@pytest.mark.slow
@pytest.mark.parametrize("length", [0, 1, 7, 8, 2**31, 2**32 - 1, 2**32 - 8])
def test_length_in_front_is_not_trusted(length: int, sanitized: Programs) -> None:
    """Lie in the length field of FRI 2.7: the reader stays within the datagram (sanitizers watch)."""
    script = sanitized.script()
    sound = script.message(MONITORING_WAIT)
    script.datagrams += [struct.pack("<I", length) + sound[4:], sound[:7], sound]
    *steps, statistics = sanitized.probe(script)
    assert [bool(step["sent"]) for step in steps] == [False, False, True]
    assert statistics["frame"] == 2


@pytest.mark.slow
def test_three_thousand_fuzzed_datagrams_are_survived(sanitized: Programs, tmp_path: Path) -> None:
    """The short form of ``make campaign NAME=fri-fuzz``."""
    assert fuzz(sanitized.folder, tmp_path, "2.7", ("-runs=3000", "-seed=1")) == 0


@pytest.mark.slow
def test_every_truncation_of_a_message_is_survived(sanitized: Programs) -> None:
    """Cut a message after each byte: no cut is read beyond its end (sanitizers watch)."""
    script = sanitized.script()
    body = script.protocol.unframe(script.message(COMMANDING_ACTIVE, **random_fields(np.random.default_rng(6))))
    script.datagrams += [script.protocol.frame(body[:k]) for k in range(len(body))]
    script.add(COMMANDING_ACTIVE)
    *steps, statistics = sanitized.probe(script)
    assert all(step["step"] for step in steps) and steps[-1]["sent"]
    # Cut between two fields at the top it is a message with fields left out, which is no message of a robot.
    assert (statistics["messages"], statistics["duplicate"], statistics["incomplete"]) == (1, 0, 4)
    assert statistics["decode"] == len(body) - 4


def test_missing_fields_are_not_a_number_and_never_old(open_programs: Programs) -> None:
    """Leave fields out: getters return NaN, not the value of an earlier message."""
    script = open_programs.script()
    script.add(COMMANDING_WAIT, position=np.ones(7))
    for field in ("measuredJointPosition", "measuredTorque", "commandedTorque", "externalTorque", "timestamp"):
        script.add(COMMANDING_WAIT, change=lambda m, f=field: m.monitorData.ClearField(f))
    steps = open_programs.probe(script)
    for step, name in zip(steps[1:], ("position", "torque", "commanded_torque", "external_torque"), strict=False):
        assert step[name] == 7 * [None]
    assert (steps[5]["seconds"], steps[5]["nanoseconds"]) == (0, 0)


def test_sequence_counter_tells_lost_messages_lost_answers_and_restarts(programs: Programs) -> None:
    """Jump in the sequence counter: losses, late answers, restarts and the wrap at 2^32 are told apart."""
    script = programs.script()
    script.add(MONITORING_WAIT, 1)
    script.lose(4)
    script.add(MONITORING_WAIT, 1, reflected=0)  # answers 0 and, now, 1
    script.add(MONITORING_WAIT, 1, reflected=0)  # our answer 1 has not arrived
    script.add(MONITORING_WAIT, 1, reflected=2)  # it never did: lost
    script.datagrams.append(TIMEOUT)
    script.sequence = 0  # counts anew after silence
    script.add(MONITORING_WAIT, 1, reflected=3)
    script.datagrams.append(TIMEOUT)
    script.sequence = 2**32 - 2
    script.add(MONITORING_WAIT, 1, reflected=4)
    script.sequence = -1  # wraps round
    script.add(MONITORING_WAIT, 1, reflected=5)
    *steps, statistics = programs.probe(script)
    assert [step["step"] for step in steps] == [True] * 4 + [False, True, False, True, True]
    assert statistics["lost_messages"] == 4
    assert statistics["lost_answers"] == 1
    assert statistics["late_answers"] == 1
    assert statistics["timeouts"] == 2
    assert statistics["messages"] == sum(bool(step["sent"]) for step in steps) == 7
