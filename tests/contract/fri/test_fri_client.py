# SPDX-License-Identifier: MIT
"""The FRI client and its open library: the wire held against an independent codec, hostile traffic, the controller.

The robot's messages come from examples/fri_robot/messages.py (protobuf, a schema of its own), so that the two codecs
check each other. They run against the open library, against one that stands in for KUKA's (tests/support/fri/standin),
and with an installed KUKA SDK (environment variables FRI_SDK_ROOT and, if its headers do not tell, FRI_SDK_VERSION)
against that.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.project import ROOT

sys.path.insert(0, str(ROOT))

from examples.fri_robot.messages import IODirection, IOType, IOValue, Protocol
from examples.fri_robot.replay import read_client_log, replayed_torque
from support.fri_python_client import free_port
from support.fri_served import served, unread
from support.fri_session import (
    FULL,
    POSTURE,
    TIMEOUT,
    TRAJECTORY,
    Programs,
    RobotScript,
    build,
    button,
    run_harness,
    sdk_options,
    write_short_trajectory,
)

VERSIONS = ("1.15", "2.5", "2.7")
IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE = range(5)


Make = Callable[..., Programs]


@pytest.fixture(scope="session")
def robot(plate: ModuleType) -> ModuleType:
    """The robot that the programs are built for."""
    return plate


def some(*names: str) -> list[Any]:
    """Names of programs; those beside 2.7 are for the slow tests."""
    quick = ("2.7", "sdk")
    return [pytest.param(name, marks=() if name in quick else pytest.mark.slow) for name in names]


@pytest.fixture(
    scope="session", params=some(*VERSIONS, "standin-1.15", "standin-2.7", *(["sdk"] if sdk_options() else []))
)
def programs(request: pytest.FixtureRequest, make_programs: Make) -> Programs:
    """The client against the open library in each version, the one in the place of KUKA's, and an installed SDK."""
    return make_programs(request.param)


@pytest.fixture(scope="session", params=some(*VERSIONS))
def open_programs(request: pytest.FixtureRequest, make_programs: Make) -> Programs:
    """The client against the open library in each version."""
    return make_programs(request.param)


@pytest.fixture(scope="session")
def one(make_programs: Make) -> Programs:
    """One version, for what does not depend on it."""
    return make_programs("2.7")


@pytest.fixture(scope="session")
def sanitized(make_programs: Make) -> Programs:
    """The client under the address and undefined-behaviour sanitizers, with the fuzz target."""
    return make_programs("sanitized")


def counters(line: str) -> bytes:
    """Bytes of a hexadecimal string with spaces."""
    return bytes.fromhex(line.replace(" ", ""))


def test_the_table_of_events_is_that_of_the_sources() -> None:
    source = (ROOT / "examples" / "fri_client" / "events.h").read_text()
    bits = {name: 1 << int(bit) for name, bit in re.findall(r"EVENT_(\w+) = 1 << (\d+)", source)}
    texts = re.findall(r'\{EVENT_(\w+), "([^"]*)",\s*"([^"]*)",\s*"([^"]*)"\}', source)
    assert {name for name, *_ in texts} == set(bits)
    described = (ROOT / "docs" / "fri.md").read_text()
    for name, *text in texts:
        assert f"| {bits[name]} | {' | '.join(text)} |" in described


# ---- building ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_clang_takes_the_sources_without_a_warning(open_programs: Programs, plate_folder: Path) -> None:
    folder, client = open_programs.folder, ROOT / "examples" / "fri_client"
    sources = [
        *client.glob("*.cpp"),
        *(client / "open_fri").glob("*.cpp"),
        ROOT / "tests" / "support" / "fri" / "harness.cpp",
    ]
    includes = [client, client / "open_fri", plate_folder, folder / "client"]
    number = {"1.15": 115, "2.5": 205, "2.7": 207}[open_programs.version]
    command = ["clang++", "-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow",
               "-Werror", f"-DFRI_VERSION={number}", "-DOPEN_FRI", *(f"-I{i}" for i in includes),
               f"-isystem{folder / 'client' / 'open_fri'}", *map(str, sources)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["-DFRI_SDK_ROOT=/nowhere"], "no friLBRClient.h or no libFRIClient there"),
        (["-DOPEN_FRI_VERSION=3.0"], "'3.0' is no version of the FRI"),
        (["-DROBOT_NAME=nobody"], "has no nobody_impedance.h"),
    ],
)
def test_wrong_build_option_is_refused_with_the_remedy(options: list[str], wanted: str, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=re.escape(wanted)):
        build(tmp_path, options, compiler="gcc", flags="")


# ---- the wire ------------------------------------------------------------------------------------------------------


def test_torque_command_is_byte_for_byte_what_was_seen_on_the_wire(programs: Programs) -> None:
    script = programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 200 - script.sequence - 1)
    torque = np.array([1.0, -2.0, 0.5, 1e-300, -0.0, 320.0, 1 / 3])
    script.add(COMMANDING_ACTIVE, external_torque=torque, position=POSTURE)
    steps = programs.probe(script)[:-1]
    values = [b"".join(b"\x09" + struct.pack("<d", x) for x in array) for array in (POSTURE, torque)]
    body = counters("0a0a 0881800d 10c701 18c801 128201 0a3f") + values[0] + counters("1a3f") + values[1]
    assert len(body) == 145
    framed = struct.pack("<I", 145) + body + struct.pack("<I", zlib.crc32(body))
    expected = framed if programs.version == "2.7" else body
    assert steps[-1]["sent"] == expected.hex()
    assert len(expected) == (153 if programs.version == "2.7" else 145)


def random_fields(rng: np.random.Generator) -> dict[str, Any]:
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
    """The same message with every array of numbers in the other encoding, fields reversed, and an unknown field."""
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


def test_every_getter_gives_what_an_independent_codec_sent(programs: Programs) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        script, fields = programs.script(), random_fields(rng)
        script.add(COMMANDING_WAIT, **fields)
        seen = programs.probe(script)[0]
        assert seen["callback"] == "waitForCommand"
        assert_seen(seen, fields, script, programs.version)


def test_arrays_in_either_encoding_unknown_fields_and_any_order(programs: Programs) -> None:
    script, fields = programs.script(), random_fields(np.random.default_rng(4))
    script.datagrams.append(repack(script.message(COMMANDING_WAIT, **fields), script.protocol))
    assert_seen(programs.probe(script)[0], fields, script, programs.version)


def test_commands_are_read_by_an_independent_codec(programs: Programs) -> None:
    rng = np.random.default_rng(5)
    script = programs.script()
    sent = [random_fields(rng) for _ in range(5)]
    for fields in sent:
        script.add(COMMANDING_ACTIVE, **fields)
    for k, (step, fields) in enumerate(zip(programs.probe(script), sent, strict=False)):
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


def test_states_callbacks_and_idle(programs: Programs) -> None:
    script = programs.script()
    for state in (IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE, MONITORING_READY, IDLE):
        script.add(state, 2)
    steps = programs.probe(script)[:-1]
    assert all(step["step"] for step in steps)
    changes = [step["change"] for step in steps if "change" in step]
    assert changes == [[0, 1], [1, 2], [2, 3], [3, 4], [4, 2], [2, 0]]
    names = [None, "monitor", "monitor", "waitForCommand", "command", "monitor", None]
    assert [step.get("callback") for step in steps] == [name for name in names for _ in range(2)]
    assert [bool(step["sent"]) for step in steps] == [name is not None for name in names for _ in range(2)]


def test_setters_out_of_place_are_refused_from_2_7_on(programs: Programs) -> None:
    script = programs.script()
    script.add(MONITORING_READY)
    step = programs.probe(script)[0]
    assert step["refusals"] == (2 if programs.version == "2.7" else 0)
    command = script.protocol.decode_command(bytes.fromhex(step["sent"]))
    assert (command.torque is None) == (programs.version == "2.7")


def test_every_nth_message_is_answered(programs: Programs) -> None:
    script = programs.script()
    script.begin(3, 3)
    script.add(COMMANDING_ACTIVE, 12, receive_multiplier=3)
    steps = programs.probe(script)[:-1]
    assert [bool(step["sent"]) for step in steps[9:]] == 4 * [False, False, True]
    assert all(step["callback"] == "command" for step in steps[9:])
    answers = [script.protocol.decode_command(bytes.fromhex(step["sent"])) for step in steps if step["sent"]]
    assert [answer.sequence for answer in answers] == list(range(len(answers)))
    assert [answer.reflected for answer in answers[-4:]] == [12, 15, 18, 21]


def test_command_is_cleared_each_cycle(programs: Programs) -> None:
    script = programs.script()
    script.begin(1, 1)
    script.add(COMMANDING_ACTIVE, ios=[IOValue("Group.Lamp", IOType.BOOLEAN, IODirection.OUTPUT, False)])
    script.add(MONITORING_WAIT)
    last = script.protocol.decode_command(bytes.fromhex(programs.probe(script)[-2]["sent"]))
    assert last.ios == ()
    assert last.position is None or programs.version != "2.7"


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
    script = sanitized.script()
    sound = script.message(MONITORING_WAIT)
    script.datagrams += [struct.pack("<I", length) + sound[4:], sound[:7], sound]
    *steps, statistics = sanitized.probe(script)
    assert [bool(step["sent"]) for step in steps] == [False, False, True]
    assert statistics["frame"] == 2


@pytest.mark.slow
def test_every_truncation_of_a_message_is_survived(sanitized: Programs) -> None:
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
    script = open_programs.script()
    script.add(COMMANDING_WAIT, position=np.ones(7))
    for field in ("measuredJointPosition", "measuredTorque", "commandedTorque", "externalTorque", "timestamp"):
        script.add(COMMANDING_WAIT, change=lambda m, f=field: m.monitorData.ClearField(f))
    steps = open_programs.probe(script)
    for step, name in zip(steps[1:], ("position", "torque", "commanded_torque", "external_torque"), strict=False):
        assert step[name] == 7 * [None]
    assert (steps[5]["seconds"], steps[5]["nanoseconds"]) == (0, 0)


def test_message_without_connection_info_is_not_taken_for_idle(programs: Programs) -> None:
    script = programs.script()
    script.add(MONITORING_READY)
    script.add(MONITORING_READY, change=lambda m: m.ClearField("connectionInfo"))
    *steps, statistics = programs.probe(script)
    assert "change" not in steps[1] and not steps[1]["sent"] and statistics["incomplete"] == 1


def test_sequence_counter_tells_lost_messages_lost_answers_and_restarts(programs: Programs) -> None:
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


# ---- the wiping client ---------------------------------------------------------------------------------------------


def _position_mode(message: Any) -> None:
    message.ipoData.clientCommandMode = 1


class Wiped:
    """A session of the wiping client: its steps, log and summary."""

    def __init__(self, programs: Programs, script: RobotScript, folder: Path, *options: str) -> None:
        files = (folder / "log.csv", folder / "summary.json")
        arguments = ("wiping", *files, "--trajectory", TRAJECTORY, *FULL, *options)
        self.steps = run_harness(programs.folder, script.datagrams, *arguments)
        self.summary = json.loads(files[1].read_text())
        self.faults = self.summary["faults"]
        self.log = read_client_log(*files)
        self.commands = [
            script.protocol.decode_command(bytes.fromhex(step["sent"])) if step["sent"] else None for step in self.steps
        ]


def minimum_jerk(time: float, duration: float, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    s = min(time / duration, 1.0)
    place, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    return start + place * (end - start), rate * (end - start)


def moving(robot: ModuleType, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion of the arm near the start: position, a wrench of the environment, and the joint torque it makes."""
    q = POSTURE + 0.05 * np.sin(2 * np.pi * (0.3 + 0.1 * np.arange(7)) * time)
    wrench = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0]) * np.sin(2 * np.pi * 0.7 * time)
    return q, wrench, robot.hybrid.jacobian(q).T @ wrench


def moving_script(programs: Programs, robot: ModuleType, cycles: int) -> RobotScript:
    script = programs.script()
    script.begin()
    for k in range(cycles):
        q, _, torque = moving(robot, k * 0.005)
        script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
    return script


def test_torque_is_that_of_the_controller_stepped_in_python_on_what_the_robot_said(
    programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Everything anew in Python: velocity filter, wrench, reference; not from the client's log."""
    cycles = 1500  # the move, and half a second into the trajectory
    wiped = Wiped(programs, moving_script(programs, robot, cycles), tmp_path)
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",").T
    controller = robot.Impedance(
        sample_time=0.005, posture_stiffness=10.0, motor_inertia=0.1, ramp_time=0.05, tip_velocity_limit=2.0,
        tip_rotation_limit=6.0, reference_velocity_limit=robot.VELOCITY,
    )  # fmt: skip
    velocity, last = np.zeros(7), None
    springs = {"translation_stiffness": np.diag([700.0, 700.0, 800.0]), "rotation_stiffness": 30.0 * np.eye(3)}
    weight = 1 - np.exp(-0.005 / 0.004)
    worst = 0.0
    for k in range(cycles):
        q, wrench, torque = moving(robot, k * 0.005)
        before = POSTURE if last is None else last
        velocity = velocity + weight * ((q - before) / 0.005 - velocity)
        last = q
        J = robot.hybrid.jacobian(q)
        measured = np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), J @ torque)
        assert np.linalg.norm(measured - wrench) <= 0.02 * np.linalg.norm(wrench) + 1e-12  # the damping's share
        t = k * 0.005
        if t < 5.0:
            q0, _ = minimum_jerk(t, 5.0, moving(robot, 0.0)[0], trajectory[0])
        else:
            q0 = trajectory[round((t - 5.0) / 0.005)]
        out = controller.step(q=q, dq=velocity, q0=q0, wrench=measured, **springs)
        command = wiped.commands[9 + k]
        assert command is not None
        worst = np.maximum(worst, np.abs(command.torque - out.torque).max())  # max() would lose a NaN
    assert worst <= 1e-9
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])
    assert wiped.summary["cycles"] == cycles + 9 and wiped.summary["commanding_cycles"] == cycles
    assert not {k: v for k, v in wiped.faults.items() if v and k not in ("saturated", "rate_limited", "late_answers")}
    assert wiped.summary["antisymmetric_norm"] == 0.0


def test_position_follows_the_measured_one_without_a_transient(
    programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    wiped = Wiped(programs, moving_script(programs, robot, 400), tmp_path)
    y = x = POSTURE
    for command in wiped.commands[6:9]:  # waiting: the interpolator's position, and torque
        assert command is not None and np.array_equal(command.position, POSTURE) and not command.torque.any()
    decay, mean = np.exp(-0.005 / 0.008), 0.008 / 0.005 * (1 - np.exp(-0.005 / 0.008))
    for k in range(400):
        q, _, _ = moving(robot, k * 0.005)
        y, x = decay * y + (mean - decay) * x + (1 - mean) * q, q  # exact for an input that is straight in between
        command = wiped.commands[9 + k]
        assert command is not None
        np.testing.assert_allclose(command.position, y, rtol=0, atol=1e-12)


@pytest.mark.parametrize("period", [1, 5, 10])
def test_position_lags_by_8_ms_at_every_period_and_after_a_gap(period: int, one: Programs, tmp_path: Path) -> None:
    """A7 at its full speed, and 40 messages lost on the way."""
    speed, lag = 2.356, 0.008
    script = one.script(period)
    script.begin()
    sent = []
    for k in range(1000 // period):
        if k == 600 // period:
            script.lose(40)
        time = (script.sequence + 1 - 10) * period / 1000
        sent.append(POSTURE + np.array([0, 0, 0, 0, 0, 0, -speed * time]))
        script.add(COMMANDING_ACTIVE, position=sent[-1])
    wiped = Wiped(one, script, tmp_path, "--speed-share", "1")
    off = np.array([c.position - q for c, q in zip(wiped.commands[9:], sent, strict=True) if c is not None])
    settled = 100 // period
    np.testing.assert_allclose(off[settled:, 6], speed * lag, rtol=1e-5)  # the gap's end among them
    assert np.abs(off[:, 6]).max() + speed * period / 1000 < np.radians(3)


def test_conventional_stiffness_is_asymmetric(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    wiped = Wiped(open_programs, moving_script(open_programs, robot, 100), tmp_path, "--law", "conventional")
    assert wiped.summary["antisymmetric_norm"] > 1.0
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


def assert_safe(wiped: Wiped, robot: ModuleType) -> None:
    """Every torque sent is finite, within the limits, and no further from the last than the rate limit allows."""
    last = np.zeros(7)
    for command in wiped.commands:
        if command is None or command.torque is None:
            continue
        assert np.isfinite(command.torque).all() and np.isfinite(command.position).all()
        assert (np.abs(command.torque) <= robot.EFFORT).all()
        if not command.torque.any():  # waiting: a new start
            last = np.zeros(7)
        assert (np.abs(command.torque - last) <= 10 * robot.EFFORT * 0.005 * (1 + 1e-8)).all()
        last = command.torque


def test_lost_messages_are_missed_samples(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(programs, robot, 100)
    del script.datagrams[40:42]
    wiped = Wiped(programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == 2 and wiped.faults["controller_faults"] == 0
    assert list(np.flatnonzero(wiped.log["sample_valid"] == 0)) == [31, 32]
    dq, weight = wiped.log["dq"], 1 - np.exp(-0.015 / 0.004)
    mean = (moving(robot, 33 * 0.005)[0] - moving(robot, 30 * 0.005)[0]) / 0.015
    np.testing.assert_allclose(dq[33], dq[30] + weight * (mean - dq[30]), atol=1e-12)
    np.testing.assert_allclose(np.diff(wiped.log["time"]), 0.005, atol=1e-9)
    assert_safe(wiped, robot)


def test_silence_leads_to_the_fallback_and_back(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(programs, robot, 400)
    del script.datagrams[109:149]  # 200 ms in the middle
    wiped = Wiped(programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == wiped.faults["lost_cycles_commanding"] == 40
    assert wiped.faults["controller_faults"] == 1
    status = wiped.log["status"].astype(int)
    missed = np.flatnonzero(wiped.log["sample_valid"] == 0)
    assert list(missed) == [100, 101, 102]  # the watchdog's limit; the rest changes nothing
    assert status[102] & robot.Status.FAULT and not status[-1] & robot.Status.FAULT
    assert wiped.log["reset"].sum() == 1
    reset = np.flatnonzero(wiped.log["reset"])[0]
    np.testing.assert_array_equal(wiped.log["q0"][reset], wiped.log["q"][reset])  # from where it is
    assert_safe(wiped, robot)
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


def test_a_fault_is_reset_after_good_samples_and_not_after_gaps(
    one: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """0.2 s of samples that came: what was lost in between does not count."""
    script = moving_script(one, robot, 600)
    kept = [k < 100 or (k >= 140 and (k % 20 == 0 or k >= 400)) for k in range(600)]  # silence, then one in twenty
    script.datagrams[9:] = [d for d, keep in zip(script.datagrams[9:], kept, strict=True) if keep]
    wiped = Wiped(one, script, tmp_path)
    reset = np.flatnonzero(wiped.log["reset"])
    valid = np.cumsum(wiped.log["sample_valid"])
    assert len(reset) == 1
    assert valid[reset[0]] == 100 + 14 + 40
    assert wiped.faults["controller_faults"] == 1


def test_hostile_session_never_makes_an_unsafe_torque(
    open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Losses, duplicates, garbage, missing fields, wild values, state drops; each fault of a kind is counted."""
    rng = np.random.default_rng(8)
    script = open_programs.script()
    script.begin()
    wild = [np.nan, np.inf, -np.inf, 1e308, -1e6, 5e-324]
    missing = ("measuredJointPosition", "externalTorque", "timestamp")
    put = dict.fromkeys(("lose", "garbage", "duplicate", "missing", "wild", "mode"), 0)
    for k in range(3000):
        q, _, torque = moving(robot, k * 0.005)
        if k % 1000 == 999:  # the motion is broken off and started again
            script.begin(3, 10)
        kind = rng.choice([*put, "sound"], p=[0.02] * len(put) + [1 - 0.02 * len(put)])
        if kind == "lose":
            script.lose(int(rng.integers(1, 50)))
        elif kind == "garbage":
            script.datagrams.append(rng.bytes(int(rng.integers(1, 1500))))
        elif kind == "duplicate":
            script.datagrams.append(script.datagrams[-1])
        elif kind == "missing":
            field = missing[int(rng.integers(3))]
            script.add(COMMANDING_ACTIVE, change=lambda m, f=field: m.monitorData.ClearField(f), position=q,
                       external_torque=torque)  # fmt: skip
        elif kind == "wild":
            q, torque = q.copy(), torque.copy()
            # A position within the limits that jumps is not believed for good: no part of this session.
            array, values = (q, wild[:-1]) if rng.integers(2) else (torque, wild)
            array[int(rng.integers(7))] = values[int(rng.integers(len(values)))]
            script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
        elif kind == "mode":
            script.add(COMMANDING_ACTIVE, change=_position_mode, position=q, external_torque=torque)
        else:
            script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
        put[str(kind)] = put.get(str(kind), 0) + 1
    wiped = Wiped(open_programs, script, tmp_path)
    assert all(step["step"] for step in wiped.steps)
    assert_safe(wiped, robot)
    assert wiped.faults["bad_datagrams"] == put["garbage"] + put["duplicate"]
    assert wiped.faults["no_torque_mode"] == put["mode"]
    assert wiped.faults["state_drops"] == 3
    assert not (wiped.log["events"].astype(int) & 1 << 17).any()  # never let go: hostile to the end
    assert wiped.faults["controller_faults"] > 10
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


@pytest.mark.parametrize("field", ["measuredJointPosition", "externalTorque", "timestamp"])
def test_missing_field_is_counted_and_holds_the_torque(
    field: str, open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    script = open_programs.script()
    script.begin()
    for k in range(100):
        q, _, torque = moving(robot, k * 0.005)
        change = (lambda m: m.monitorData.ClearField(field)) if k == 60 else None
        script.add(COMMANDING_ACTIVE, change=change, position=q, external_torque=torque)
    wiped = Wiped(open_programs, script, tmp_path)
    before, at = wiped.commands[68], wiped.commands[69]
    assert before is not None and at is not None
    if field == "timestamp":
        assert wiped.faults["bad_timestamps"] == 1 and wiped.log["sample_valid"].all()
    else:
        assert wiped.faults["missing_fields"] == 1
        assert np.array_equal(before.torque, at.torque)
        assert list(np.flatnonzero(wiped.log["sample_valid"] == 0)) == [60]
    assert wiped.faults["lost_cycles"] == wiped.faults["controller_faults"] == 0


@pytest.mark.parametrize("value", [1e308, -4.0])
def test_wild_position_does_not_stay_in_the_filters(
    value: float, open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    script = open_programs.script()
    script.begin()
    for k in range(100):
        q, _, torque = moving(robot, k * 0.005)
        if k == 60:
            q = q + value * np.eye(7)[2]
        script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["implausible_positions"] == 1 and wiped.faults["controller_faults"] == 0
    for k in range(60, 100):
        command = wiped.commands[9 + k]
        assert command is not None
        np.testing.assert_allclose(command.position, moving(robot, k * 0.005)[0], atol=0.02)
    assert np.abs(wiped.log["dq"][61:]).max() < 1.0
    assert_safe(wiped, robot)


def test_button_holds_the_trajectory_and_need_not_exist(programs: Programs, tmp_path: Path) -> None:
    script = programs.script()
    for state, count in ((MONITORING_READY, 3), (COMMANDING_WAIT, 3), (COMMANDING_ACTIVE, 200)):
        script.add(state, count, ios=[button(False)])
    script.add(COMMANDING_ACTIVE, 200, ios=[button(True)])
    script.add(COMMANDING_ACTIVE, 200, ios=[button(False)])
    wiped = Wiped(programs, script, tmp_path)
    q0, dq0 = wiped.log["q0"], wiped.log["dq0"]
    assert np.ptp(q0[260:400], axis=0).max() == 0.0 and not dq0[260:400].any()
    assert np.abs(np.diff(dq0, axis=0)).max() < 0.01  # comes to a stand and goes on smoothly
    assert np.abs(q0[599] - q0[400]).max() > 0.01
    assert (wiped.log["events"][200:400].astype(int) & 1 << 8).all()
    assert wiped.faults["missing_fields"] == wiped.faults["exceptions"] == 0


def test_external_torque_of_the_other_sign(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(open_programs, robot, 60)
    plain = Wiped(open_programs, script, tmp_path)
    turned = Wiped(open_programs, script, tmp_path, "--external-torque-sign", "-1")
    assert np.abs(plain.log["wrench"]).max() > 1.0
    np.testing.assert_array_equal(plain.log["wrench"], -turned.log["wrench"])


def test_dry_run_sends_zero(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    wiped = Wiped(open_programs, moving_script(open_programs, robot, 60), tmp_path, "--dry-run")
    assert np.abs(wiped.log["torque"]).max() > 0.5
    assert all(not command.torque.any() for command in wiped.commands[9:] if command is not None)


def test_quality_drop_is_counted(open_programs: Programs, tmp_path: Path) -> None:
    script = open_programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 5)
    script.add(COMMANDING_ACTIVE, 5, quality=1)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["quality_drops"] == 1
    assert wiped.log["events"].astype(int).tolist() == 5 * [0] + [1 << 3] + 4 * [0]


def test_clock_that_was_set_costs_no_cycles(open_programs: Programs, tmp_path: Path) -> None:
    script = open_programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 5)
    script.clock += 3600 * 10**9
    script.add(COMMANDING_ACTIVE, 5)
    script.clock -= 7200 * 10**9
    script.add(COMMANDING_ACTIVE, 5)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == 0 and wiped.faults["bad_timestamps"] == 2
    assert wiped.log["sample_valid"].all()
    np.testing.assert_allclose(np.diff(wiped.log["time"]), 0.005, atol=1e-9)


# ---- the program ---------------------------------------------------------------------------------------------------


def fri_wiping(programs: Programs, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [programs.client, *arguments]
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=60)


def over_udp(
    programs: Programs, script: RobotScript, *arguments: str | Path, environment: dict[str, str] | None = None
) -> tuple[int, str, str]:
    """fri_wiping, served with a script's datagrams one after the other; IDLE gets no answer."""
    with served(programs.client, "--simulated-time", *arguments, environment=environment) as session:
        for datagram in script.datagrams:
            assert datagram is not None
            session.send(datagram)
            state = script.protocol.decode_monitoring(datagram).connectionInfo.sessionState
            while state != IDLE and session.client.poll() is None:
                with contextlib.suppress(TimeoutError):
                    session.answer(0.2)
                    break
        return session.end()


def test_session_over_udp_ends_with_idle(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(programs, robot, 200)
    script.add(MONITORING_READY, 3)
    script.add(IDLE)
    summary, log = tmp_path / "summary.json", tmp_path / "log.csv"
    code, out, errors = over_udp(programs, script, "--summary", summary, "--log", log)
    assert code == 3 and errors.startswith("fri_wiping: the robot ended the session before the trajectory's end")
    for line in ("IDLE -> MONITORING_WAIT", "COMMANDING_WAIT -> COMMANDING_ACTIVE", "MONITORING_READY -> IDLE"):
        assert line in out
    told = json.loads(summary.read_text())
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
    "position mode": (lambda s: s.add(COMMANDING_WAIT, 12, change=_position_mode), (), "not in torque mode"),
    "send period": (lambda s: s.add(COMMANDING_WAIT, 12), ("--sample-time", "0.001"), "send period is 5 ms, 1 ms"),
    "no send period": (
        lambda s: s.add(COMMANDING_WAIT, 12, change=lambda m: m.connectionInfo.ClearField("sendPeriod")),
        (),
        "send period is 0 ms",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_robot_that_cannot_be_used_is_refused_in_one_line(name: str, programs: Programs) -> None:
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
    text, wanted = TRAJECTORIES[name]
    file = tmp_path / "trajectory.csv"
    file.write_text(text())
    done = fri_wiping(one, "--trajectory", file)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and wanted in done.stderr and str(file) in done.stderr


def test_trajectory_with_a_column_a_joint_is_the_same(one: Programs, robot: ModuleType, tmp_path: Path) -> None:
    turned = tmp_path / "columns.csv"
    turned.write_text(_file(lambda v: v.T)())
    script = moving_script(one, robot, 50)
    rows = Wiped(one, script, tmp_path)
    columns = Wiped(one, script, tmp_path, "--trajectory", str(turned))
    np.testing.assert_array_equal(rows.log["torque"], columns.log["torque"])


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
        (["--effort=0.5"], "--effort: no such option"),
        (["extra"], "extra: not an option"),
        (["--trajectory", TRAJECTORY, "--log", "/nowhere/log.csv"], "log /nowhere/log.csv"),
        (["--trajectory", TRAJECTORY, "--host", "robot.example"], "host robot.example"),
    ],
)
def test_bad_option_is_refused_in_one_line(arguments: list[str | Path], wanted: str, one: Programs) -> None:
    done = fri_wiping(one, *arguments)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and wanted in done.stderr


def test_port_in_use_is_refused(one: Programs) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        port = taken.getsockname()[1]
        done = fri_wiping(one, "--trajectory", TRAJECTORY, "--port", str(port))
    assert done.returncode == 2 and f"port {port}: cannot be opened" in done.stderr


def test_wrench_from_a_sensor(one: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """Six doubles in tip axes over UDP, base axes in the log; a sensor that falls silent is a missed sample."""
    sensor_port = free_port()
    log, summary = tmp_path / "log.csv", tmp_path / "summary.json"
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 100)
    told = np.array([1.0, -2.0, 3.0, 0.4, -0.5, 0.6])
    options = ("--wrench", "sensor", "--sensor-port", sensor_port, "--log", log, "--summary", summary)
    with served(one.client, *options) as session:
        for k, datagram in enumerate(script.datagrams):
            for sample in [struct.pack("<6d", *told)] * (k < 60) + [b"short"]:
                session.robot.sendto(sample, ("127.0.0.1", sensor_port))
            while unread(sensor_port):  # the sensor's thread is not in lockstep
                time.sleep(0.001)
            session.ask(datagram or b"")
        session.send(script.message(IDLE))
        assert session.end()[0] == 3
    steps = read_client_log(log, summary)
    valid = steps["sample_valid"].astype(bool)
    rotation_matrix = robot.forward_kinematics(POSTURE)[:3, :3]
    expected = np.concatenate([rotation_matrix @ told[:3], rotation_matrix @ told[3:]])
    np.testing.assert_allclose(steps["wrench"][10:50], np.tile(expected, (40, 1)), atol=1e-12)
    assert valid[10:50].all() and not valid[70:].any()
    assert steps.summary["faults"]["sensor_silent"] > 20


def watched_session(
    programs: Programs, robot: ModuleType, folder: Path, *arguments: str, registered: bool
) -> tuple[int, int, int]:
    """Allocations in all threads from the opening of the port to its closing; page faults, minor and major, of the FRI
    thread from the first datagram on. A session with everything in it, its faults too."""
    script = programs.script()
    ios = [button(False)] if registered else []
    for state, count in ((MONITORING_WAIT, 3), (MONITORING_READY, 3), (COMMANDING_WAIT, 3)):
        script.add(state, count, ios=ios)
    if not registered:
        script.add(COMMANDING_WAIT, 2, change=lambda m: m.ipoData.ClearField("jointPosition"))
        script.add(COMMANDING_WAIT, 2, change=_position_mode)
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
    assert told["faults"]["controller_faults"] == 1 and told["log_rows"] > 300
    allocations, datagrams, minor, major = map(int, result.read_text().split())
    assert datagrams == len(script.datagrams)
    return allocations, minor, major


@pytest.mark.parametrize("registered", [True, False])
def test_nothing_is_allocated_from_the_opening_of_the_port_to_its_closing(
    registered: bool, programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """In no thread, the log's among them; with an interposed allocator.

    Nor when the button is not registered, and what is needed is left out: the library throws no exception then.
    """
    assert watched_session(programs, robot, tmp_path, registered=registered)[0] == 0


@pytest.mark.parametrize("registered", [True, False])
def test_with_locked_memory_the_fri_thread_meets_no_page_fault(
    registered: bool, programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
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
    script.add(COMMANDING_ACTIVE, 60)
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
    """A counter that grows faster than messages come, by no more than the controller bears, and no time stamps."""
    short = write_short_trajectory(tmp_path / "short.csv")
    script = programs.script()
    script.begin()
    for k in range(250):
        script.lose(k % 2)
        script.add(COMMANDING_ACTIVE, change=lambda m: m.monitorData.ClearField("timestamp"))
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
    """A pipe whose reader is gone ends no session under torque."""
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 60)
    script.add(MONITORING_READY)
    with served(one.client, "--simulated-time", "--approach", "0.1") as session:
        assert session.client.stdout is not None
        for k, datagram in enumerate(script.datagrams):
            if k == 20:
                session.client.stdout.close()
            session.ask(datagram or b"")
        session.send(script.message(IDLE))
        assert session.client.wait(30) == 3


def test_after_the_trajectory_a_long_way_back_is_not_gone(one: Programs, tmp_path: Path) -> None:
    """The robot's application has moved the arm in between, and commands again."""
    short = write_short_trajectory(tmp_path / "short.csv")
    end = np.loadtxt(short, delimiter=",")[-1]
    script = one.script()
    script.begin()
    for k in range(300):
        s = min(max(k - 20, 0) / 200, 1.0)
        place = 10 * s**3 - 15 * s**4 + 6 * s**5
        script.add(COMMANDING_ACTIVE, position=POSTURE + place * (end - POSTURE))
    away = end + 1.0 * np.eye(7)[0]
    script.add(MONITORING_READY, 50, position=away)
    script.add(COMMANDING_WAIT, 10, position=away, ipo=away)
    wiped = Wiped(one, script, tmp_path, "--trajectory", str(short), "--approach", "0.1", "--speed-share", "1")
    assert wiped.summary["trajectory_done"]
    assert len(wiped.steps) == 9 + 300 + 50 + 1  # refused at once


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
    """The client's process stands still while 80 messages come. The torque then moves by two periods' share at most."""
    script = programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 150)
    summary = tmp_path / "summary.json"
    with served(programs.client, "--approach", "0.1", "--summary", summary) as session:
        answers = [session.ask(datagram or b"") for datagram in script.datagrams[:60]]
        with session.stopped():
            for datagram in script.datagrams[60:140]:
                session.send(datagram or b"")
        answers.append(session.answer())
        answers += [session.ask(datagram or b"") for datagram in script.datagrams[140:]]
        session.send(script.message(IDLE))
        session.end()
    answers = [script.protocol.decode_command(answer) for answer in answers]
    reflected = [answer.reflected for answer in answers]
    assert reflected == [*range(1, 61), *range(140, 160)]
    told = json.loads(summary.read_text())
    assert (told["faults"]["overtaken"], told["faults"]["lost_messages"], told["faults"]["lost_cycles"]) == (79, 0, 79)
    limit = np.array(told["controller"]["torque_rate_limit"]) * 2 * 0.005
    before, after = answers[59].torque, answers[60].torque
    assert before is not None and after is not None
    assert np.abs(before).max() > 0 and (np.abs(after - before) <= limit).all()


def test_lockstep_sessions_are_bit_identical(one: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(one, robot, 300)
    first, second = (Wiped(one, script, tmp_path) for _ in range(2))
    assert [step["sent"] for step in first.steps] == [step["sent"] for step in second.steps]


@pytest.mark.slow
def test_sanitizers_find_nothing_in_a_hostile_session(sanitized: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(sanitized, robot, 200)
    script.datagrams += [b"", b"\xff" * 1600, *[os.urandom(200) for _ in range(20)]]
    script.add(COMMANDING_ACTIVE, 5, change=lambda m: m.ClearField("monitorData"))
    script.add(MONITORING_WAIT, 5)
    script.begin()
    script.add(COMMANDING_ACTIVE, 50)
    script.add(IDLE)
    wiped = Wiped(sanitized, script, tmp_path)
    assert_safe(wiped, robot)
