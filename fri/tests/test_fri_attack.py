# SPDX-License-Identifier: MIT
"""The FRI client under the attack of tests/campaigns/attack_fri.py: a short climb, and what longer ones have found."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from campaigns.attack_fri import DONE, EARLY, FAULT, INTERRUPTED, Attack, climb, measures, parse, untrue
from fri.support.run import newest, versions
from fri.support.session import POSTURE, Programs, write_short_trajectory


@pytest.fixture
def attack(version: str, make_programs: Callable[[str], Programs], tmp_path: Path) -> Iterator[Attack]:
    programs = make_programs(version)
    with Attack(programs.folder / "attack", write_short_trajectory(tmp_path / "short.csv")) as attack:
        yield attack


@pytest.mark.slow
@newest
def test_a_short_climb_finds_nothing(attack: Attack) -> None:
    """Search 150 schedules for a broken bound; the largest torque steps must come close to their bounds, or the
    search is idle.
    """
    most, breaks = climb(attack, np.random.default_rng(5), 150)
    assert not breaks
    assert attack.sessions >= 150
    # It does meet its bounds: what is cut is cut there.
    assert most["torque's step from answer to answer"] > 0.99 and most["torque's rate in real time"] > 0.5


END = "the robot ended the session"
FOUND = {
    "where the robot's clock stands the commanded position follows all the same": (
        "10: 929298480 frozen 0.819469 2.342887 0", "the robot's clock stands still"
    ),
    "after a gap the arm starts from where it is": (
        "10: 2046896561 frozen 2.425386 0.246638 0 deaf 0.334411 0.130041 1 button 0.990866 1.010153 0", END
    ),
    "after a gap it is not brought back at once": ("10: 1 frozen 1.0 0.3 0", END),
    "back in the middle of the trajectory it sets out slowly": ("5: 481652331 drop 0.944510 0.211088 0.5", END),
    "old messages are not a robot that counts anew": (
        "5: 440259048 multiplier 2.234380 0.174768 3 replay 2.653331 0.444852 150", END
    ),
    "while the fault of a lost clock waits damping brakes the arm": (
        "5: 732407263 frozen 0.813011 0.037403 0", END
    ),
}  # fmt: skip
"""Former faults: the schedule that showed each, and the sentence that the session ends with now."""


@versions
@pytest.mark.parametrize("name", FOUND)
def test_what_climbs_have_found(attack: Attack, name: str) -> None:
    line, text = FOUND[name]
    told = attack.play(parse(line))
    assert text in told["sentence"]
    assert {name: value for name, value in measures(parse(line), told).items() if not value <= 1 + 1e-6} == {}


SAID = {
    "a counter that stands": (
        "5: 1 stuck 0.03 9 0", FAULT, "the robot's messages all have the sequence counter 6: datagram_duplicate"
    ),
    "a clock that stands": ("5: 1 frozen 0.03 9 0", FAULT, "the robot's clock stands still: clock_standing "),
    "the robot's end": ("5: 1", DONE, "the trajectory was followed to its end, and the robot ended the session"),
    "too early": ("5: 1 state 0.8 9 0", EARLY, "before the trajectory's end, at 0.4"),
    "a fault after the trajectory's end is a fault": (
        "5: 1 safety 3.0 9 1 state 3.01 9 0",
        FAULT,
        "the robot reports a safety stop while commanding; see its messages; the robot ended the session before the "
        "torque was down",
    ),
    "an interrupted session that the robot ends is interrupted": (
        "5: 1 held 0.5 9 0 interrupt 1.0 1 1 state 1.02 9 0",
        INTERRUPTED,
        "interrupted; the robot ended the session before the torque was down",
    ),
    "an arm that is moved away while nothing is heard of it": (
        "5: 1 frozen 1.0 0.9 0 push 1.000006 0.4 12 held 1.6 9 0",
        FAULT,
        "the arm was moved by more than --approach-limit while messages were lost",
    ),
    "a release that the robot cuts short": (
        "5: 1 held 0.5 9 0 interrupt 1.0 1 1 state 1.02 9 2",
        INTERRUPTED,
        "interrupted; the robot stopped commanding before the torque was down, the client leaves",
    ),
}  # fmt: skip


@versions
@pytest.mark.parametrize("name", SAID)
def test_code_and_last_line_say_what_happened(attack: Attack, name: str) -> None:
    line, code, text = SAID[name]
    told = attack.play(parse(line))
    assert told["code"] == code and text in told["sentence"]
    assert untrue(parse(line), told) == []


def limit_starts(lower: np.ndarray, upper: np.ndarray, full: bool) -> dict[str, np.ndarray]:
    """Return configurations 1e-3 rad inside the limits of one or two joints; few pairs unless ``full``."""
    starts = {}
    sides = [(joint, name) for joint in range(7) for name in ("lower", "upper")]
    pairs = [pair for pair in itertools.combinations(sides, 2) if pair[0][0] != pair[1][0]]
    few = [((1, "upper"), (2, "upper")), ((2, "lower"), (3, "upper")), ((3, "upper"), (5, "upper"))]
    for chosen in [*[(side,) for side in sides], *(pairs if full else few)]:
        q = POSTURE.copy()
        for joint, name in chosen:
            q[joint] = upper[joint] - 1e-3 if name == "upper" else lower[joint] + 1e-3
        starts[" ".join(f"A{joint + 1} {name}" for joint, name in chosen)] = q
    return starts


@pytest.mark.parametrize(
    ("period", "full"),
    [
        (5, False),
        *(pytest.param(p, True, marks=pytest.mark.wide) for p in (1, 2, 5, 10)),
    ],
)
def test_starts_at_joint_limits_with_the_default_torque_rise(
    period: int, full: bool, make_programs: Callable[[str], Programs], plate: ModuleType, tmp_path: Path
) -> None:
    """The session runs to its end, and no joint exceeds the default --speed-share (0.9) of its velocity limit.

    Before: let go with A2 and A3 both at their upper limits (2, 5 and 10 ms), and with two other pairs.
    """
    s = np.linspace(0.0, 1.0, 201)
    way = 10 * s**3 - 15 * s**4 + 6 * s**5
    middle = (plate.LOWER + plate.UPPER) / 2
    program = make_programs("2.7").folder / "attack"
    found = {}
    for name, start in limit_starts(plate.LOWER, plate.UPPER, full).items():
        inward = np.where(np.abs(start - POSTURE) > 0, 0.2 * np.sign(middle - start), 0.0)
        q = start - 0.02 * np.eye(7)[0] * (not name.startswith("A1 lower"))  # the arm starts 0.02 rad along A1
        np.savetxt(tmp_path / "inward.csv", q + np.outer(way, inward), delimiter=",", fmt="%.10f")
        with Attack(program, tmp_path / "inward.csv") as attack:
            told = attack.play(parse(f"{period}: 1"))
        if told["code"] != DONE or told["fast"] > 0.9:
            found[name] = (told["code"], told["fast"], told["sentence"])
    assert not found
