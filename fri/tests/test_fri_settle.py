# SPDX-License-Identifier: MIT
"""--settle: no error at rest, and nothing beyond limits whatever happens meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from campaigns.attack_fri import DONE, Attack, measures, parse
from campaigns.frozen_fri import blames_position, judge
from examples.experiments.plant import START_POSTURE
from fri.robot.messages import SessionState
from fri.robot.replay import replayed_torque
from fri.support.run import Run
from fri.support.session import Programs, RobotScript, button, write_short_trajectory
from fri.support.wiping import Wiped, assert_safe, minimum_jerk

ACTIVE = SessionState.COMMANDING_ACTIVE
SETTLE = "settle 0 99 35"


@pytest.fixture(scope="module")
def resting(
    make_programs: Callable[[str], Programs], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[str], dict[str, Any]]]:
    """Sessions of 7 s: the short trajectory, at its end after 1.35 s, then rest; without a robot stiffness."""
    short = write_short_trajectory(tmp_path_factory.mktemp("settle") / "short.csv")
    with Attack(make_programs("2.7").folder / "attack", short, 7.0) as attack:
        yield lambda line: {**attack.play(parse(line)), "line": line}


def whole(told: dict[str, Any]) -> bool:
    """Return whether a session kept every bound of the attack."""
    return all(value <= 1 + 1e-6 for value in measures(parse(told["line"]), told).values())


@pytest.mark.parametrize("period", [pytest.param(1, marks=pytest.mark.slow), 5])
@pytest.mark.parametrize("friction", [0.01, 0.02])
def test_rests_within_a_millimetre_under_friction(
    resting: Callable[[str], dict[str, Any]], period: int, friction: float
) -> None:
    """Friction as a share of the client's effort limits, half as much again at rest: 2.6 to 4.6 mm without."""
    without, settled = (
        resting(f"{period}: 1 sticky 0 99 {friction} quantum 0 99 1e-6 {more}") for more in ("", SETTLE)
    )
    assert without["code"] == settled["code"] == DONE
    assert without["rest"] > 2.5e-3 and settled["rest"] <= 1.0e-3
    assert whole(settled)


def test_a_blocked_tip_gets_settle_force_more_at_most(resting: Callable[[str], dict[str, Any]]) -> None:
    """All joints blocked on the way, with 6.8 N of springs, and the robot does not see what blocks them."""
    force = {n: resting(f"5: 1 held 1.2 99 0 gain 0 99 0 settle 0 99 {n}")["force"] for n in (0, 5, 10, 20)}
    more = {n: force[n] - force[0] for n in force}
    assert more[5] == 0.0  # error and offset together pull by 1.25 times settle_force at most
    assert 5.0 < more[10] <= 10.0 and 12.0 < more[20] <= 20.0


def test_what_touches_the_tip_holds_it(resting: Callable[[str], dict[str, Any]]) -> None:
    """The same with an external torque that shows it: not a bit more."""
    without, settled = (resting(f"5: 1 held 1.2 99 0 settle 0 99 {n}") for n in (0, 20))
    assert settled["force"] == without["force"]


FAULTS = (
    "drop 1.5 4 0.05", "drop 2 0.1 1", "deaf 1.5 4 0.04", "silence 2 0.2 0", "frozen 2 0.2 0", "burst 2 0.03 0",
    "delay 1.5 4 0.02", "button 1.6 1 0", "without 2 0.03 1", "without 2 0.03 2", "jitter 1.5 4 0.3", "state 2 0.3 2",
    "safety 2 9 1", "interrupt 1.6 1 1", "period 2 9 2", "held 2 1 0", "push 2.000001 1 20", "stop 2 0.1 1",
)  # fmt: skip

QUICK = ("drop 1.5 4 0.05", "silence 2 0.2 0", "button 1.6 1 0", "held 2 1 0")


@pytest.mark.parametrize(
    "fault", [pytest.param(each, marks=() if each in QUICK else pytest.mark.slow) for each in FAULTS]
)
def test_faults_while_it_settles(resting: Callable[[str], dict[str, Any]], fault: str) -> None:
    assert whole(resting(f"5: 1 sticky 0 99 0.02 {SETTLE} {fault}"))


FROZEN = {
    "all but A3, no friction": "1: 445302360 still 1.748736 99 123 bias 0 99 0.00120140272 motor 0 99 0.124410119",
    "A1 to A4": "1: 1411036418 still 3.020814 99 15 sticky 0 99 0.0265808987 motor 0 99 0.184929506",
    "A6": "2: 763191540 still 1.873257 99 32 sticky 0 99 0.00923203699 quantum 0 99 1e-6 motor 0 99 0.179607985",
}
"""Positions that stand still while Settle moves the command. With the client's other guard alone the last
two creep on, or are let go late.
"""


@pytest.mark.parametrize("name", FROZEN)
def test_frozen_positions_at_rest_are_let_go(resting: Callable[[str], dict[str, Any]], name: str) -> None:
    told = resting(f"{FROZEN[name]} {SETTLE}")
    assert blames_position(told), told["sentence"]
    assert judge(told).apart <= 0.02 and told["fast"] <= 0.8 and told["beyond"] <= 0.0


def test_the_last_line_names_the_joint_also_when_the_robot_stops(resting: Callable[[str], dict[str, Any]]) -> None:
    """The robot leaves COMMANDING_ACTIVE while the torque comes down. Before, the client crashed on its last line."""
    told = resting("5: 1 late 0.6 99 80020 state 0.80 9 2")
    assert "measured positions of joint A4 repeat those of 20 messages before" in told["sentence"], told


# ---- what is commanded ----------------------------------------------------------------------------------------------


def at_rest(programs: Programs, trajectory: Path, error: float, pressed: range = range(0)) -> RobotScript:
    """Return messages of an arm that goes along the short trajectory, and rests with an error [rad] and encoder
    noise.
    """
    end = np.loadtxt(trajectory, delimiter=",")[-1]
    script = programs.script()
    for state in (SessionState.MONITORING_READY, SessionState.COMMANDING_WAIT):
        script.add(state, 3, ios=[button(False)])
    start = np.loadtxt(trajectory, delimiter=",")[0]
    for k in range(700):
        place = minimum_jerk(0.005 * max(k - 20, 0), 1.0, start, end - error)[0]
        script.add(ACTIVE, position=place + 2e-6 * np.cos(k * np.arange(1, 8)), ios=[button(k in pressed)])
    return script


@pytest.fixture
def short(tmp_path: Path) -> Path:
    return write_short_trajectory(tmp_path / "short.csv")


def wipe(programs: Programs, script: RobotScript, folder: Path, trajectory: Path, *options: str) -> Wiped:
    given = ("--trajectory", str(trajectory), "--approach", "0.1", *options)
    return Wiped(programs, script, folder, *given)


def test_the_command_is_the_trajectory_until_the_arm_rests(
    one: Programs, robot: ModuleType, short: Path, tmp_path: Path
) -> None:
    """Replay the log with its moved positions: the same torque; in motion the command is as without Settle, to the
    bit.
    """
    script = at_rest(one, short, 0.004)
    limit = ("--error-limit", "0.03")  # of the arm's distance from the trajectory, not from the moved command
    plain, moved = (wipe(one, script, tmp_path, short, *limit, *more).log for more in ((), ("--settle", "20,2")))
    assert moved.summary["controller"]["settle_force"] == [20.0, 2.0]
    parted = np.flatnonzero((plain["q0"] != moved["q0"]).any(axis=1))
    assert 220 + 10 <= parted[0] < 300  # at rest for 50 ms, and the equilibrium there
    np.testing.assert_array_equal(moved["q0"][0], moved["q"][0])
    np.testing.assert_array_equal(replayed_torque(robot, moved), moved["torque"])
    pose, wanted = (robot.forward_kinematics(log["q0"])[:, :3, 3] for log in (moved, plain))
    far = np.linalg.norm(pose - wanted, axis=1)
    assert 0.027 < far[-1] <= 20.0 / 700.0 + 1e-4  # settle_force over the stiffness
    assert np.abs(np.diff(moved["q0"], axis=0)).max() <= 0.005 * 0.6


def test_a_button_and_a_fault_end_it(one: Programs, robot: ModuleType, short: Path, tmp_path: Path) -> None:
    """Press the button (samples 320 to 399) and then lose 200 ms: Settle stops, and starts again from where the arm
    is.
    """
    script = at_rest(one, short, 0.004, pressed=range(320, 400))
    del script.datagrams[6 + 500 : 6 + 540]  # 200 ms of silence
    wiped = wipe(one, script, tmp_path, short, "--settle", "20,2")
    q0 = wiped.log["q0"]
    assert np.abs(q0[319] - q0[300]).max() > 1e-4
    assert np.ptp(q0[340:400], axis=0).max() < 1e-5  # it stands while the button is pressed
    assert np.abs(q0[480] - q0[399]).max() > 1e-4
    (reset,) = np.flatnonzero(wiped.log["reset"])
    np.testing.assert_array_equal(q0[reset], wiped.log["q"][reset])  # from where the arm is
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])
    assert_safe(wiped, robot)


# ---- with the simulated robot ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("weight", "settles"), [(0.3, True), (1.0, False)])
def test_a_small_load_is_carried_and_a_contact_left(
    session: Callable[..., Run], plate: ModuleType, tmp_path: Path, weight: float, settles: bool
) -> None:
    """3 N are below contact_wrench, 10 N are not. Over UDP, with the torque on the wire compared."""
    short = write_short_trajectory(tmp_path / "near.csv", tuple(START_POSTURE))
    end = plate.forward_kinematics(np.loadtxt(short, delimiter=",")[-1])[:3, 3]
    rest = []
    for settle in ("0,0", "35,3"):
        client = ("--approach", 0.1, "--settle", settle)
        run = session("2.7", "--lockstep", "--duration", 3.5, "--weight", weight, client=client, trajectory=short)
        assert (run.robot.code, run.code) == (0, DONE)
        run.check(plate)
        rest.append(float(np.linalg.norm(plate.forward_kinematics(run.robot.log["q"][-1])[:3, 3] - end)))
    assert rest[0] > 3e-3
    assert rest[1] <= 1.1e-3 if settles else rest[1] == rest[0]
