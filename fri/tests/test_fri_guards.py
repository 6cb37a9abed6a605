# SPDX-License-Identifier: MIT
"""Guards of the client that read values which something else may drop: they count a dropped value as a bad one."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fri.robot.replay import read_client_log
from fri.support.python_client import free_port
from fri.support.served import served, unread
from fri.support.session import POSTURE, Programs, button
from fri.support.wiping import COMMANDING_ACTIVE, IDLE, MONITORING_READY, MONITORING_WAIT, Wiped, over_udp
from support.calibrations import calibration_text

SLOWED, LET_GO = 1 << 13, 1 << 17
HELD = ("--force-limit", "150", "--hold-time", "0.3")


def assert_stands(log: Any) -> None:
    """The trajectory came to a stand, and the client let go."""
    events = log["events"].astype(int)
    assert log["pace"][75:].max() == 0.0
    assert (events & SLOWED).any() and (events & LET_GO).any()
    assert not log["sent_torque"][-1].any()


@pytest.mark.parametrize("torque", [40.0, 120.0, 1e6, 1e200])
def test_a_contact_force_at_its_limit_stops_the_trajectory(torque: float, one: Programs, tmp_path: Path) -> None:
    """External torque at A2 and A4; 120 N m make 533 N, more than any contact of an LBR."""
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 20)
    script.add(COMMANDING_ACTIVE, 200, external_torque=np.array([0, torque, 0, torque, 0, 0, 0]))
    wiped = Wiped(one, script, tmp_path, *HELD)
    assert_stands(wiped.log)


@pytest.mark.parametrize("wrench", [(500.0, 0.0), (1000.0, 0.0), (0.0, 120.0)], ids=str)
def test_a_sensor_beyond_what_an_arm_can_meet_stops_the_trajectory(
    wrench: tuple[float, float], one: Programs, plate_folder: Path, tmp_path: Path
) -> None:
    """Let the sensor say a force [N] or moment [N m] that no LBR can meet: the trajectory stands."""
    sensor_port = free_port()
    log, summary = tmp_path / "log.csv", tmp_path / "summary.json"
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 220)
    calibration = tmp_path / "sensor.json"
    calibration.write_text(calibration_text(plate_folder))
    options = ("--simulated-time", "--wrench", "sensor", "--sensor-port", sensor_port, "--calibration", calibration,
               "--log", log, "--summary", summary, *HELD)  # fmt: skip
    with served(one.client, *options) as session:
        for k, datagram in enumerate(script.datagrams):
            sample = struct.pack("<6d", 0, 0, wrench[0] * (k > 20), wrench[1] * (k > 20), 0, 0)
            session.robot.sendto(sample, ("127.0.0.1", sensor_port))
            while unread(sensor_port):  # the sensor's thread is not in lockstep
                time.sleep(0.0005)
            if session.client.poll() is not None:
                break
            session.send(datagram or b"")
            try:
                session.answer(0.5)
            except (TimeoutError, ConnectionRefusedError):
                break
        session.send(script.message(IDLE))
        code, _, errors = session.end()
    assert code == 1 and "the contact force stayed at its limit of 150 N" in errors
    assert_stands(read_client_log(log, summary))


FIELDS: dict[str, Callable[[Any], object]] = {
    "all": lambda m: m.ClearField("robotInfo"),
    "safety": lambda m: m.robotInfo.ClearField("safetyState"),
    "drives": lambda m: m.robotInfo.ClearField("driveState"),
    "operation": lambda m: m.robotInfo.ClearField("operationMode"),
}


@pytest.mark.parametrize("name", FIELDS)
def test_messages_without_the_robots_states_are_heeded(name: str, one: Programs) -> None:
    """Leave the robot's states out: the client lets go, as it could not see a safety stop; nine such messages are
    borne.
    """
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 20)
    script.add(COMMANDING_ACTIVE, 9, change=FIELDS[name])
    script.add(COMMANDING_ACTIVE, 20)
    script.add(COMMANDING_ACTIVE, 10, change=FIELDS[name])
    script.add(COMMANDING_ACTIVE, 60)
    script.add(IDLE)
    code, _, errors = over_udp(one, script)
    assert code == 1 and "no longer say safety state, drives and operation mode" in errors


def test_a_button_that_is_not_told_any_more_is_pressed(one: Programs, tmp_path: Path) -> None:
    """Leave the button out of the messages from sample 100 on: the trajectory stops as if it were pressed."""
    script = one.script()
    script.add(MONITORING_READY, 3, ios=[button(False)])
    script.begin(3, 3)
    script.add(COMMANDING_ACTIVE, 100, ios=[button(False)])
    script.add(COMMANDING_ACTIVE, 100)
    log = Wiped(one, script, tmp_path).log
    assert log["pace"][99] == 1.0 and not log["pace"][160:].any()  # 1: full speed; 60 samples of 5 ms suffice to stop


# ---- samples that are bad for long ----------------------------------------------------------------------------------


def test_a_clock_of_half_the_speed_is_let_go_and_named(one: Programs) -> None:
    """Let the time stamps advance 2.5 ms per 5 ms: the client lets go and names the clock."""
    script = one.script()
    script.begin(10, 10)
    for _ in range(1500):
        script.clock -= 2_500_000  # [ns] half a period
        script.add_resting(1)
    script.add(IDLE)
    code, _, errors = over_udp(one, script)
    assert code == 1 and "the robot's clock runs at about 50 % of what its messages' counter says" in errors


def test_a_clock_that_is_set_again_and_again_is_let_go_and_named(one: Programs) -> None:
    """Set the clock again and again: the client lets go, since no velocity can be computed to guard the speed."""
    script = one.script()
    script.begin()
    for _ in range(600):
        script.clock += 3600_000_000_000
        script.add_resting(1)
    script.add(IDLE)
    code, _, errors = over_udp(one, script)
    assert code == 1 and "the robot's clock is set again and again" in errors


def test_positions_beyond_a_limit_are_let_go_and_named(one: Programs, robot: Any) -> None:
    """Say in each message that A4 is more than 0.1 rad beyond its limit: the client lets go and names A4."""
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 800, position=np.where(np.arange(7) == 3, robot.LOWER - 0.11, POSTURE))
    script.add(IDLE)
    code, _, errors = over_udp(one, script)
    assert code == 1 and f"joint A4 is measured at {robot.LOWER[3] - 0.11:.3f} rad, 0.110 rad beyond" in errors


def test_a_silent_sensor_is_let_go_and_named(one: Programs, plate_folder: Path, tmp_path: Path) -> None:
    """Let the wrench sensor send 40 readings, then none: the client lets go and names the sensor's port."""
    readings = 40
    sensor_port, calibration = free_port(), tmp_path / "sensor.json"
    calibration.write_text(calibration_text(plate_folder))
    options = ("--wrench", "sensor", "--sensor-port", sensor_port, "--calibration", calibration)
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 800)  # 4 s of 5 ms each
    with served(one.client, "--simulated-time", *options) as session:
        for k, datagram in enumerate(script.datagrams):
            if k < readings:
                # One wrench [N, N m] as six doubles, any values.
                session.robot.sendto(struct.pack("<6d", *range(6)), ("127.0.0.1", sensor_port))
                while unread(sensor_port):  # so that reading k belongs to message k
                    time.sleep(0.0005)
            session.send(datagram or b"")
            try:
                session.answer(0.5)
            except (TimeoutError, ConnectionRefusedError):
                break
        session.send(script.message(IDLE))
        code, _, errors = session.end()
    assert code == 1 and f"the wrench sensor on port {sensor_port} is silent" in errors


def test_a_robot_that_comes_back_on_another_port_is_named(one: Programs) -> None:
    """Send from another port after 20 samples: the client ignores the messages and names the other sender."""
    script = one.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 20)
    with served(one.client, "--timeout", 300) as session, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reborn:
        for datagram in script.datagrams:
            session.ask(datagram or b"")
        while session.client.poll() is None:
            with contextlib.suppress(ConnectionRefusedError):
                session.send(script.message(MONITORING_WAIT), reborn)
            time.sleep(0.005)
        code, _, errors = session.end()
    assert code == 1 and "come from another address or port than this session's: datagram_sender" in errors


def test_a_joint_array_that_is_never_seven_is_named(one: Programs) -> None:
    """Send six torques in each message: the client names the count instead of waiting without a word."""
    script = one.script()
    script.add(MONITORING_WAIT, 100, change=lambda m: m.monitorData.measuredTorque.value.pop())
    with served(one.client, "--wait", 0.5, "--timeout", 300) as session:
        for datagram in script.datagrams:
            with contextlib.suppress(ConnectionRefusedError):
                session.send(datagram or b"")
            time.sleep(0.01)
        code, _, errors = session.end()
    assert code == 1 and "messages do not have seven joints: datagram_joint_count" in errors
