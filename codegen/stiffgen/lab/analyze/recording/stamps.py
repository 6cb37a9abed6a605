# SPDX-License-Identifier: MIT
"""Time stamps of two topics in a log: match the messages, whatever the clocks did.

A message has two times: when the recorder logged it, and the stamp that its publisher gave it. The logged time bounds
which messages can belong together; among these the stamps decide. So a stamp that jumps concerns its message alone.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LATENESS = 1_000_000_000
"""Largest delay of a message in the log behind its stamp, compared with the other topic [ns]."""
_MOST = 50_000
"""Messages in the log between joint positions and their wrench, where logged times are wrong (of a conversion)."""


class Message(NamedTuple):
    """A message of the log.

    Attributes:
        is_wrench: whether it is a wrench; else joint positions.
        logged: when it was logged, never before the message before it [ns].
        stamp: when it was measured [ns].
        numbers: wrench [N, N m] or joint positions [rad or m].

    """

    is_wrench: bool
    logged: int
    stamp: int
    numbers: tuple[float, ...]


class Match(NamedTuple):
    """Joint positions and their wrench.

    Attributes:
        joints: the message with joint positions.
        wrench: the wrench, None if no stamp is near enough.
        away: from the joint positions' stamp to that of their wrench, or of the wrench that was logged next to them
            [ns]; None without such a wrench.

    """

    joints: Message
    wrench: tuple[float, ...] | None
    away: int | None


def jumps(logged: NDArray[np.int64], stamps: NDArray[np.int64], tolerance: int) -> tuple[NDArray[np.int64], float]:
    """Return which messages of a topic have a stamp that jumps, and by how much the first one does [s].

    A stamp jumps if it departs from the logged times by more than ``LATENESS`` from one message to the next, or goes
    back by more than the tolerance [ns].
    """
    step = np.diff(stamps)
    departure = step - np.diff(logged)
    found = np.flatnonzero((np.abs(departure) > LATENESS) | (step < -tolerance)) + 1
    return found, float(departure[found[0] - 1]) * 1e-9 if len(found) else 0.0


class Unwrapped:
    """Logged times of a topic in the order of the file, without steps back beyond the tolerance [ns]."""

    def __init__(self, tolerance: int) -> None:
        self._tolerance = tolerance
        self._last, self._added = 0, 0

    def __call__(self, logged: int) -> int:
        """Return a time that continues the ones before [ns]."""
        time = logged + self._added
        if time < self._last - self._tolerance:
            self._added += self._last - time
        self._last = max(self._last, logged + self._added)
        return self._last


class _Runs:
    """Runs of a topic's stamps: a stamp that jumps begins another run; one that jumps back continues its own."""

    def __init__(self, tolerance: int) -> None:
        self._tolerance = tolerance
        self._newest: deque[tuple[int, Message]] = deque(maxlen=4)
        self._count = 0

    def __call__(self, message: Message) -> int:
        """Return the number of the message's run."""
        for index in reversed(range(len(self._newest))):
            run, last = self._newest[index]
            step = message.stamp - last.stamp
            if step >= -self._tolerance and abs(step - (message.logged - last.logged)) <= LATENESS:
                del self._newest[index]
                break
        else:
            run, self._count = self._count, self._count + 1
        self._newest.append((run, message))
        return run


class _Window:
    """Wrenches that were logged lately, in the order of their stamps; ``count`` has the number of all that came."""

    def __init__(self, tolerance: int) -> None:
        self._tolerance = tolerance
        self.count = 0
        self._runs = _Runs(tolerance)
        self._logged: deque[tuple[int, int, int]] = deque()
        self._stamps: list[tuple[int, int, int]] = []  # stamp, number, run
        self._messages: dict[int, Message] = {}

    def add(self, message: Message) -> None:
        """Add a wrench, which is logged after those before."""
        entry = (message.stamp, self.count, self._runs(message))
        self._messages[self.count] = message
        self.count += 1
        self._logged.append(entry)
        insort(self._stamps, entry)
        if len(self._logged) > 2 * _MOST:
            self._drop()

    def forget(self, logged: int) -> None:
        """Drop wrenches that were logged before a time [ns]."""
        while self._logged and self._messages[self._logged[0][1]].logged < logged:
            self._drop()

    def _drop(self) -> None:
        entry = self._logged.popleft()
        del self._stamps[bisect_left(self._stamps, entry)]
        del self._messages[entry[1]]

    def _away(self, joints: Message) -> int | None:
        """Return how much later the wrench is stamped that was logged next to joint positions [ns]."""
        place = bisect_left(self._logged, joints.logged, key=lambda entry: self._messages[entry[1]].logged)
        beside = list(islice(self._logged, max(place - 1, 0), place + 1))
        nearest = min(beside, key=lambda entry: abs(self._messages[entry[1]].logged - joints.logged), default=None)
        return None if nearest is None else nearest[0] - joints.stamp

    def match(self, joints: Message) -> Match:
        """Find the wrench with the nearest stamp.

        Where a clock was set back, wrenches of two runs may be near; those count that were logged beside the joint
        positions.
        """
        first = bisect_left(self._stamps, (joints.stamp - self._tolerance, -1, -1))
        last = bisect_left(self._stamps, (joints.stamp + self._tolerance + 1, -1, -1))
        apart = {entry: abs(self._messages[entry[1]].logged - joints.logged) for entry in self._stamps[first:last]}
        near = [entry for entry, distance in apart.items() if distance <= self._tolerance + LATENESS]
        if not near:
            return Match(joints, None, self._away(joints))
        run = min(near, key=apart.__getitem__)[2]
        stamp, number, _ = min(
            (entry for entry in near if entry[2] == run), key=lambda entry: abs(entry[0] - joints.stamp)
        )
        return Match(joints, self._messages[number].numbers, stamp - joints.stamp)


def matched(messages: Iterable[Message], tolerance: int) -> Iterator[Match]:
    """Yield joint positions in the order of the log, with the wrench nearest in time (stamps, within a tolerance [ns]).

    ``LATENESS`` bounds how far apart in the log the two may be, and so the messages in memory.
    """
    waiting: deque[tuple[Message, int]] = deque()  # joint positions, each with how many wrenches had come before it
    window, reach = _Window(tolerance), tolerance + LATENESS
    for message in messages:
        if message.is_wrench:
            window.add(message)
        else:
            waiting.append((message, window.count))
        while waiting and (
            message.logged - waiting[0][0].logged > reach or max(len(waiting), window.count - waiting[0][1]) > _MOST
        ):
            yield window.match(waiting.popleft()[0])
        window.forget((waiting[0][0].logged if waiting else message.logged) - reach)
    for joints, _ in waiting:
        yield window.match(joints)
