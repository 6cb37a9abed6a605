# SPDX-License-Identifier: MIT
"""--press: a force along the tool's z axis, and nothing beyond limits whatever happens meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from campaigns.attack_fri import DONE, EARLY, FAULT, INTERRUPTED, REFUSED, Attack, measures, parse
from campaigns.frozen_fri import blames_position
from examples.bowl_wiping.pressing import plate_pose
from examples.experiments.plant import START_POSTURE
from fri.robot.messages import SessionState
from fri.robot.replay import replayed_torque
from fri.support.python_client import free_port
from fri.support.run import Run
from fri.support.session import POSTURE, Programs
from support.calibrations import calibration_text
from support.plate import PAYLOAD

FORCE, STEP = 15.0, 0.005
"""Force that is held [N], and time between samples of a trajectory [s]."""
PRESS = f"press 0 99 {FORCE} wall 0 99 0.02"


def write_motion(robot: ModuleType, file: Path, pose: Callable[[float], np.ndarray], near: np.ndarray) -> Path:
    """Write a trajectory of 6.5 s from poses by their share of a motion, which rests for 2.5 s and goes on for 3 s."""
    q = robot.find_posture(pose(0.0), near)
    follow = robot.Follow(q, sample_time=STEP)
    shares = np.clip((STEP * np.arange(1300) - 2.5) / 3.0, 0.0, 1.0)
    rows = [follow.step(pose=pose(float(np.sin(np.pi * share) ** 2)), posture=q).q0 for share in shares]
    np.savetxt(file, rows, delimiter=",", fmt="%.12f")
    return file


@pytest.fixture(scope="module")
def pressing(
    make_programs: Callable[[str], Programs], plate: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., dict[str, Any]]]:
    """Sessions of 8 s, or 14, with a wall of 1e4 N/m: the tip rests for 2.5 s, then goes 8 cm along it and back."""
    start = plate.forward_kinematics(POSTURE)

    def pose(share: float) -> np.ndarray:
        moved = start.copy()
        moved[:3, 3] += 0.08 * share * start[:3, 0]
        return np.asarray(moved)

    slide = write_motion(plate, tmp_path_factory.mktemp("press") / "slide.csv", pose, POSTURE)
    program = make_programs("2.7").folder / "attack"
    with Attack(program, slide, 8.0) as attack, Attack(program, slide, 14.0) as longer:
        yield lambda line, long=False: {**(longer if long else attack).play(parse(line)), "line": line}


def whole(told: dict[str, Any]) -> bool:
    """Return whether a session kept every bound of the attack."""
    return all(value <= 1 + 1e-6 for value in measures(parse(told["line"]), told).values())


@pytest.mark.parametrize(
    ("period", "more"),
    [
        (1, ""),
        (2, ""),
        (5, ""),
        (5, "sticky 0 99 0.02"),
        (1, "sticky 0 99 0.02 quantum 0 99 1e-6"),
        (5, "drop 1 9 0.02 patient 0 99 0"),
    ],
)
def test_the_force_is_held_along_a_wall(pressing: Callable[..., dict[str, Any]], period: int, more: str) -> None:
    """Press along a wall: in the last second rms 0.01 N, with friction of 2 % of the effort limits 0.13 N; impacts 16
    to 22 N.
    """
    told = pressing(f"{period}: 1 {PRESS} {more}")
    print(f"{period} ms {more}: mean {told['mean']:.2f} N, rms {told['rms']:.3f} N, most {told['hardest']:.1f} N")
    assert told["code"] == DONE, told["sentence"]
    assert 1.0 < told["most_commanded"] <= 2.0 * FORCE and told["commanded"] < 1.0  # handed over to the springs
    assert abs(told["mean"] - FORCE) <= 1.0 and told["rms"] <= 0.3 and told["hardest"] <= 26.0
    assert whole(told)


LOST = {
    "numb 0.5 99 0": ("reading stood still while the arm moved", 1.0),
    "numb 1.05 99 0": ("reading stood still while the arm moved", 40.0),
    "numb 3 99 0": ("reading stood still while the arm moved", 20.0),
    "weak 0 99 0.2": ("springs pressed much harder than the sensor said", 45.0),
    "weak 0 99 0.5": ("springs pressed much harder than the sensor said", 35.0),
    "weak 0 99 -1": ("springs pressed much harder than the sensor said", 25.0),
}
"""What a sensor does: what is said at the end, and the most force that the wall feels [N]."""


@pytest.mark.parametrize("fault", LOST)
def test_a_sensor_that_lies_ends_the_force(pressing: Callable[..., dict[str, Any]], fault: str) -> None:
    """Let the sensor lie: no force in the last second, the trajectory goes on without it, and the exit code is 1."""
    told = pressing(f"5: 1 {PRESS} {fault}")
    text, most = LOST[fault]
    assert told["code"] == FAULT and told["done"] and text in told["sentence"], told["sentence"]
    assert told["hardest"] <= most and told["mean"] == told["commanded"] == 0.0
    assert whole(told)


@pytest.mark.parametrize(("wall", "text"), [("0 3 0.02", "contact was lost"), ("0 99 0.3", "nothing was touched")])
def test_no_wall_ends_the_force(pressing: Callable[..., dict[str, Any]], wall: str, text: str) -> None:
    """One that falls, and one too far away: the arm is no faster than with it, and does not look for another."""
    told = pressing(f"5: 1 press 0 99 {FORCE} wall {wall} wall 6 99 0.0")
    assert told["code"] == FAULT and text in told["sentence"], told["sentence"]
    assert told["fast"] <= 0.3 and told["commanded"] == 0.0 and told["mean"] < 2.0
    assert whole(told)


def test_a_search_ends(pressing: Callable[..., dict[str, Any]]) -> None:
    """After 8.3 s without a touch the pose goes back; it was 0.1 m along the axis, half of --error-limit, at most."""
    seeking, back = (pressing(f"5: 1 press 0 99 {FORCE}", long=long) for long in (False, True))
    assert 0.08 < seeking["rest"] < 0.11 and back["rest"] < 1e-3
    assert "nothing was touched" in back["sentence"] and whole(seeking) and whole(back)


ENDS = {
    "button 3 99 0": (EARLY, 0.0),
    "button 3 0.5 0": (DONE, FORCE),
    "mute 3 0.1 0": (DONE, FORCE),
    "silence 3 0.2 0": (DONE, FORCE),
    "frozen 3 0.2 0": (DONE, FORCE),
    "stop 3 0.2 1": (DONE, FORCE),
    "burst 3 0.03 0": (DONE, FORCE),
    "mute 3 99 0": (FAULT, 0.0),
    "silence 3 1.5 0": (FAULT, 0.0),
    "state 4 99 0": (EARLY, 0.0),
    "interrupt 3 1 1": (INTERRUPTED, 0.0),
    "safety 3 99 1": (FAULT, 0.0),
    "late 3 99 1270020": (FAULT, 0.0),
    "push 3.000001 1 30": (FAULT, 0.0),
}
"""What happens in contact: the exit code, and the mean force of the last second [N]."""


@pytest.mark.parametrize("fault", ENDS)
def test_what_happens_in_contact(pressing: Callable[..., dict[str, Any]], fault: str) -> None:
    """Inject a fault while the tool presses: exit code, mean force [N] and largest force [N] stay within their
    bounds.
    """
    result = pressing(f"5: 1 {PRESS} {fault}")  # send period 5 ms
    code, mean_force = ENDS[fault]
    assert result["code"] == code, result["sentence"]
    assert abs(result["mean"] - mean_force) <= (1.0 if mean_force else 0.0)  # [N]
    assert result["hardest"] <= 22.0  # [N]
    assert whole(result)


@pytest.mark.parametrize("when", [0.8, 1.05, 1.6, 3.0, 4.2])
@pytest.mark.parametrize("joints", [127, 8, 90])
def test_positions_that_stand_still_are_let_go(
    pressing: Callable[..., dict[str, Any]], when: float, joints: int
) -> None:
    """Freeze the positions in approach, contact and motion: at most a quarter of a velocity limit, 0.1 J and 25 N."""
    told = pressing(f"2: 1 {PRESS} still {when} 99 {joints}")
    assert blames_position(told), told["sentence"]
    assert told["fast"] <= 0.25 and told["kinetic"] <= 0.1 and told["hardest"] <= 25.0 and told["beyond"] <= 0.0


@pytest.mark.parametrize(
    "line",
    [
        "5: 1 press 0 99 15 still 0.644 99 64 sticky 0 99 0.02 quantum 0 99 1e-6",
        "5: 1 press 0 99 8 still 1.071 99 76 sticky 0 99 0.02 quantum 0 99 1e-6",
        "2: 1 press 0 99 30 still 1.782 99 63 sticky 0 99 0.01",
    ],
)
def test_positions_that_stand_still_at_rest(pressing: Callable[..., dict[str, Any]], line: str) -> None:
    """Press alone changes the torque: with the guard's share of motions the arm goes on by 0.07, 0.08 and 0.12 rad."""
    told = pressing(f"{line} wall 0 99 0.02")
    assert blames_position(told), told["sentence"]
    assert told["apart"] <= 0.02 and told["fast"] <= 0.1 and told["beyond"] <= 0.0


@pytest.mark.parametrize(
    ("line", "text"),
    [("5: 1 press 0 99 46", "--press takes at most half of the heaviest wrench, 45.8 N"),
     ("10: 1 press 0 99 15", "--press takes a send period of at most 5 ms, and the robot's is 10 ms")],
)  # fmt: skip
def test_what_is_refused_at_the_start(pressing: Callable[..., dict[str, Any]], line: str, text: str) -> None:
    """Ask for a force or a send period beyond what Press takes: the client refuses before the arm moves."""
    told = pressing(line)
    assert told["code"] == REFUSED and text in told["sentence"] and not told["moved"]


# ---- with the simulated robot: its bowl and its sensor, over UDP ----------------------------------------------------


class Pressed:
    """A session, with the force on the bowl along the tool's axis in each of the robot's cycles."""

    def __init__(self, run: Run, robot: ModuleType) -> None:
        assert run.client is not None
        self.run, self.log, self.robot = run, run.client, robot
        rows = run.robot.log
        self._active = rows["state"] == SessionState.COMMANDING_ACTIVE
        self._time = rows["time"] - rows["time"][np.argmax(self._active)]
        self._force = -np.einsum("ij,ij->i", robot.forward_kinematics(rows["q"])[:, :3, 2], rows["wrench"][:, :3])

    def force(self, begin: float, end: float) -> np.ndarray:
        """Return the force [N] between two times of commanding [s]."""
        return np.asarray(self._force[self._active & (self._time >= begin) & (self._time < end)])

    def check(self) -> None:
        """Check limits of torque, rate and speed, and that the log steps again to the same torque, bit for bit."""
        self.run.check(self.robot)
        np.testing.assert_array_equal(replayed_torque(self.robot, self.log), self.log["torque"])
        assert (np.abs(self.run.robot.log["dq"]) <= 0.9 * self.robot.VELOCITY).all()
        assert self.log["wrench_command"].any()


@pytest.fixture(scope="module")
def sweep(plate: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sweep from 2 cm above the bowl, 2 cm to one side and back."""

    def pose(share: float) -> np.ndarray:
        return plate_pose(2.0 + 0.4 * share, -0.02)[0]

    return write_motion(plate, tmp_path_factory.mktemp("press") / "sweep.csv", pose, START_POSTURE)


@pytest.fixture
def wipe(
    session: Callable[..., Run], plate: ModuleType, plate_folder: Path, sweep: Path, tmp_path: Path
) -> Callable[..., Pressed]:
    """Sessions over the bowl: 0.5 s to the trajectory, then it is followed from contact on."""
    start = np.loadtxt(sweep, delimiter=",", max_rows=1)
    (tmp_path / "sensor.json").write_text(calibration_text(plate_folder, payload=PAYLOAD))

    def run(seconds: float, *robot: object, force: float = FORCE) -> Pressed:
        port = free_port()
        client = ["--approach", 0.5, "--wrench", "sensor", "--calibration", tmp_path / "sensor.json"]
        client += ["--sensor-port", port, "--press", force]
        given = ["--lockstep", "--duration", seconds, "--sensor-port", port, "--bowl", "--start", *start, *robot]
        return Pressed(session("2.7", *given, client=client, trajectory=sweep), plate)

    return run


@pytest.mark.slow
def test_the_bowl_is_pressed_with_the_force(wipe: Callable[..., Pressed]) -> None:
    """Press on the bowl at rest and in motion: the force is held; before contact q0 is the trajectory's, to the bit."""
    held = wipe(7.3)
    assert (held.run.robot.code, held.run.code) == (0, DONE), held.run.error
    for begin, end, rms in ((2.0, 2.9, 0.5), (3.2, 5.8, 2.0)):
        force = held.force(begin, end)
        error = np.sqrt(np.mean((force - FORCE) ** 2))
        print(f"{begin} to {end} s: mean {force.mean():.2f} N, rms error {error:.2f} N, most {force.max():.1f} N")
        assert abs(force.mean() - FORCE) <= 1.0 and error <= rms
    held.check()
    free = wipe(0.7, force=0.0)
    np.testing.assert_array_equal(held.log["q0"][:99], free.log["q0"][:99])
    assert not (held.log["q0"][100:140] == free.log["q0"][100:140]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "code", "text"),
    [("frozen", EARLY, "the sensor's reading stood still while the arm moved"), ("silent", FAULT, "is silent")],
)
def test_a_sensor_that_fails_in_the_bowl(wipe: Callable[..., Pressed], fault: str, code: int, text: str) -> None:
    """Let the sensor fail from 2.5 s on: the force stays below 40 N and has vanished 1.9 s later."""
    held = wipe(4.6, "--faults", f"sensor@2.5-9:{fault}")
    assert held.run.code == code and text in held.run.error
    assert held.force(0.0, 4.6).max() <= 40.0 and held.force(4.4, 4.6).max(initial=0.0) <= 1.0
    held.check()
