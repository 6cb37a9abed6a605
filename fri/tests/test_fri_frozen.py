# SPDX-License-Identifier: MIT
"""Measured positions that stand still while all else lives: the client lets go before a joint runs away."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from campaigns.attack_fri import Attack, parse
from campaigns.frozen_fri import FASTEST, MOST_ENERGY, blames_position, judge
from fri.robot.encoders import Encoders
from fri.robot.faults import FaultError, parse_faults
from fri.support.run import Run
from fri.support.session import TRAJECTORY, Programs


@pytest.fixture(scope="module")
def long_attack(make_programs: Callable[[str], Programs]) -> Iterator[Attack]:
    """Sessions of seven seconds of the bowl, without a robot stiffness."""
    with Attack(make_programs("2.7").folder / "attack", TRAJECTORY, 7.0) as attack:
        yield attack


FROZEN = {
    "A6, as the issue has it": "5: 1 still 5 99 32",
    "all seven": "5: 1 still 5 99 127",
    "A1": "5: 1 still 5 99 1",
    "A2 and A4, 2 ms": "2: 1 still 5 99 10",
    "A4, 10 ms, friction and a coarse encoder": "10: 1 still 5 99 8 sticky 0 99 0.012 quantum 0 99 1e-6",
    "A6, the lowest bit toggles": "5: 1 toggling 5 99 3200",
    "A6, bit 32 toggles": "5: 1 toggling 5 99 3232",
    "A6, and the robot's external torque believes it": "5: 1 still 5 99 32 misled 5 99 1",
    "A2 and A4, friction of 6 %": "5: 1726982099 still 3.378709 99 14 sticky 0 99 0.0609755717 hum 0 99 0.0359807906 "
    "motor 0 99 0.10012912",
    "A4 and an external torque that believes it, friction of 7 %": "5: 3 still 3 99 8 misled 3 99 1 sticky 0 99 0.07",
    "A3, a coarse encoder": "1: 484755101 still 4 99 4 quantum 0 99 1e-5 motor 0 99 0.1",
    "A5, a coarse encoder": "5: 1992815089 still 5.5 99 16 quantum 0 99 1e-5 motor 0 99 0.148260385",
    "A4, a bit toggles": "5: 1806300648 toggling 4.456081 99 840 hum 0 99 0.140785962 motor 0 99 0.169610608",
}  # fmt: skip
"""Schedules with faulty encoders. Before, A6 reached 4.8 velocity limits, all seven 6.1, and nothing let go.

Without the client's guard of positions that take two values, A6 reaches 1.6 limits and A4 7.9 where a bit toggles.
"""


@pytest.mark.parametrize("name", FROZEN)
def test_frozen_positions_are_let_go(long_attack: Attack, name: str) -> None:
    """No joint exceeds 0.8 of its velocity limit, or its range, and the arm has at most 0.5 J."""
    told = long_attack.play(parse(FROZEN[name]))
    verdict = judge(told)
    assert blames_position(told), told["sentence"]
    assert verdict.fast <= FASTEST and verdict.kinetic <= MOST_ENERGY and verdict.beyond <= 0.0


LATE = {
    "A2, 5 ms": "5: 72013749 late 2.563130 99 20057 quantum 0 99 1e-5 bias 0 99 0.00576257481 motor 0 99 0.102517382",
    "A4, 10 ms": "10: 630374985 late 2.400639 99 80034 bias 0 99 0.00912210632 motor 0 99 0.119344921",
    "A3, 2 ms": "2: 1100784434 late 2.494117 99 40030 quantum 0 99 1e-5 hum 0 99 0.130977525 bias 0 99 0.00457856354 "
    "motor 0 99 0.171046445",
}
"""Schedules with late copies of positions. Before, the arm reached 1.1, 3.9 and 2.1 velocity limits."""


@pytest.mark.parametrize("name", LATE)
def test_late_copies_of_positions_are_let_go(long_attack: Attack, name: str) -> None:
    """Positions that repeat earlier ones bit by bit are found before the arm oscillates."""
    told = long_attack.play(parse(LATE[name]))
    verdict = judge(told)
    assert "repeat those of" in told["sentence"]
    assert verdict.fast <= 1.0 and verdict.beyond <= 0.0
    assert verdict.late is None or verdict.late <= 0.06


HARMLESS = (
    "5: 1 button 2 2 0 quantum 0 99 1e-6 sticky 0 99 0.012",
    "5: 1 held 4 0.7 0",
    "5: 1 blocked 4 0.7 3 hum 0 99 0.2",
    "2: 1 push 4.000004 0.5 10 sticky 0 99 0.012 quantum 0 99 1e-5",
    "5: 1 push 4.000001 0.5 -10 gain 0 99 0",
    "2: 2108666675 quantum 0 99 1e-5 hum 0 99 0.0815786459 bias 0 99 0.00436239927 motor 0 99 0.0997190189",
)


@pytest.mark.parametrize("line", HARMLESS)
def test_rests_pushes_and_holds_are_no_frozen_positions(long_attack: Attack, line: str) -> None:
    told = long_attack.play(parse(line))
    assert not blames_position(told), told["sentence"]


def test_faulty_encoders_of_the_simulated_robot() -> None:
    """Still, stuck at a value, one bit that toggles, and late copies, of one joint, several or all."""
    path = np.cumsum(np.full((30, 7), 0.01), axis=0)  # [rad] each joint moves on by 0.01 per sample; faults from 10 on

    def told(**faults: str) -> np.ndarray:
        encoders = Encoders()
        return np.array([encoders.read(q, faults if k >= 10 else {}) for k, q in enumerate(path)])

    assert np.array_equal(told(), path)
    still = told(still="A6")
    assert (still[10:, 5] == path[9, 5]).all() and np.array_equal(still[:, :5], path[:, :5])
    assert (told(still="all")[10:] == path[9]).all()
    stuck = told(stuck="A2+A4_0.3")
    assert (stuck[10:, [1, 3]] == 0.3).all() and np.array_equal(stuck[:, 0], path[:, 0])
    toggling = told(toggling="A6_32")
    assert len(np.unique(toggling[10:, 5])) == 2
    assert np.abs(toggling[10:, 5] - path[9, 5]).max() < 1e-6
    assert np.array_equal(told(late="all_5")[15:], path[10:-5])


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["still@1-2", "still@1-2:A8", "stuck@1-2:A6", "late@1-2:A6_0", "toggling@1-2:A1_52",
                                   "still@1-2:A1_3", "client.still@1-2:A1", "still@1:A1"])  # fmt: skip
def test_encoder_faults_that_cannot_be_read(fault: str) -> None:
    with pytest.raises(FaultError, match="fault '"):
        parse_faults(fault, "2.7")


@pytest.mark.slow
def test_the_simulated_robot_freezes_a_joint(session: Callable[..., Run], tmp_path: Path) -> None:
    """The same in a session over UDP: A6 stands still, and the client's last line names it."""
    run = session("2.7", "--lockstep", "--duration", 8, "--stiffness", 0, "--faults", "still@4-20:A6")
    assert run.code == 1
    assert "the measured positions of joint A6 are not believed" in run.error
    assert np.abs(run.robot.log["dq"][:, 5]).max() < 2.35
