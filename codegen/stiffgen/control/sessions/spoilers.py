# SPDX-License-Identifier: MIT
"""Events that spoil the input of a hostile session: an omitted, old or broken sample, a broken command, a bump.

Each takes the session, its input, the number of a joint, and a number that no sample has.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

LEFT_OUT = (1, 2, 3, 4, 5, 12)
"""Calls that are left out at once: fewer and more than the longest delay of the torque."""


def _omit(session: Any, given: Any, joint: int, bad: float) -> None:
    given.sample_valid = 0


def _skip(session: Any, given: Any, joint: int, bad: float) -> None:
    session.ticks += int(session.random.choice(LEFT_OUT))
    session.write_clock()


def _age(session: Any, given: Any, joint: int, bad: float) -> None:
    session.ticks -= 1  # for this call
    session.write_clock()
    session.ticks += 1


def _break_number(session: Any, given: Any, joint: int, bad: float) -> None:
    _put(session.random.choice(["q", "dq"]), given, joint, bad)


def _jump(session: Any, given: Any, joint: int, bad: float) -> None:
    given.q[joint] += float(session.random.normal())


def _speed(session: Any, given: Any, joint: int, bad: float) -> None:
    given.dq[joint] += 5.0 * float(session.random.normal())


def _break_command(session: Any, given: Any, joint: int, bad: float) -> None:
    fields = ["q0", "translation_stiffness", "rotation_stiffness", "posture_stiffness"]
    fields += ["wrench_command", "acceleration", "torque_offset", "time"]
    _put(session.random.choice(fields), given, int(session.random.integers(6)), bad)
    given.translation_stiffness[int(session.random.integers(9))] *= session.random.choice([1.0, -1.0, 1e3])


def _break_flag(session: Any, given: Any, joint: int, bad: float) -> None:
    name = str(session.random.choice(["clock", "sample_valid", "shaped"]))
    setattr(given, name, int(session.random.choice([-1, 0, 2, 3])))


def _clear(session: Any, given: Any, joint: int, bad: float) -> None:
    ctypes.memset(ctypes.byref(given), 0, ctypes.sizeof(given))


def _bump(session: Any, given: Any, joint: int, bad: float) -> None:
    session.dq[joint] += 3.0 * float(session.random.normal())


def _put(name: str, given: Any, place: int, value: float) -> None:
    if name == "time":
        given.time = value
        return
    array = getattr(given, name)
    array[place % len(array)] = value


SPOILERS: tuple[tuple[float, Callable[[Any, Any, int, float], None]], ...] = (
    (0.01, _omit),
    (0.015, _skip),
    (0.02, _age),
    (0.03, _break_number),
    (0.04, _jump),
    (0.045, _speed),
    (0.06, _break_command),
    (0.061, _break_flag),
    (0.063, _clear),
    (0.07, _bump),
)
"""Ends of the events' intervals, and what happens: to the input, to one joint's numbers, or to the arm itself."""
