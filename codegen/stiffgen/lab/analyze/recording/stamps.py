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
        index = self._continued(message)
        if index is None:
            run, self._count = self._count, self._count + 1
        else:
            run, _ = self._newest[index]
            del self._newest[index]
        self._newest.append((run, message))
        return run

    def _continued(self, message: Message) -> int | None:
        """Return the place in ``_newest`` of the run that a message continues, the one seen last first; None: none.

        Its stamp does not go back beyond the tolerance, and departs from the logged times by at most ``LATENESS``.
        """
        for index in reversed(range(len(self._newest))):
            _, last = self._newest[index]
            step = message.stamp - last.stamp
            departure = abs(step - (message.logged - last.logged))
            if step >= -self._tolerance and departure <= LATENESS:
                return index
        return None


class _WindowEntry(NamedTuple):
    """Wrench in a window, ordered by its stamp [ns]: its number in the topic, and the run of its stamp."""

    stamp: int
    number: int
    run: int


class _Window:
    """Wrenches that were logged lately, in the order of their stamps; ``count`` has the number of all that came."""

    def __init__(self, tolerance: int) -> None:
        self._tolerance = tolerance
        self.count = 0
        self._runs = _Runs(tolerance)
        self._by_log: deque[_WindowEntry] = deque()
        self._by_stamp: list[_WindowEntry] = []
        self._messages: dict[int, Message] = {}  # by number

    def add(self, message: Message) -> None:
        """Add a wrench, which is logged after those before."""
        entry = _WindowEntry(message.stamp, self.count, self._runs(message))
        self._messages[self.count] = message
        self.count += 1
        self._by_log.append(entry)
        insort(self._by_stamp, entry)
        if len(self._by_log) > 2 * _MOST:
            self._drop()

    def forget(self, logged: int) -> None:
        """Drop wrenches that were logged before a time [ns]."""
        while self._by_log and self._logged(self._by_log[0]) < logged:
            self._drop()

    def _drop(self) -> None:
        """Drop the wrench that was logged first."""
        entry = self._by_log.popleft()
        del self._by_stamp[bisect_left(self._by_stamp, entry)]
        del self._messages[entry.number]

    def _logged(self, entry: _WindowEntry) -> int:
        """Return when a wrench was logged [ns]."""
        return self._messages[entry.number].logged

    def _away(self, joints: Message) -> int | None:
        """Return how much later the wrench is stamped that was logged next to joint positions [ns]."""
        place = bisect_left(self._by_log, joints.logged, key=self._logged)
        beside = list(islice(self._by_log, max(place - 1, 0), place + 1))
        nearest = min(beside, key=lambda entry: abs(self._logged(entry) - joints.logged), default=None)
        return None if nearest is None else nearest.stamp - joints.stamp

    def match(self, joints: Message) -> Match:
        """Find the wrench with the nearest stamp.

        Where a clock was set back, wrenches of two runs may be near; those count that were logged beside the joint
        positions.
        """
        first = bisect_left(self._by_stamp, (joints.stamp - self._tolerance, -1, -1))
        last = bisect_left(self._by_stamp, (joints.stamp + self._tolerance + 1, -1, -1))
        # in the log [ns], of the wrenches whose stamps are within the tolerance
        distance = {entry: abs(self._logged(entry) - joints.logged) for entry in self._by_stamp[first:last]}
        near = [entry for entry in distance if distance[entry] <= self._tolerance + LATENESS]
        if not near:
            return Match(joints, None, self._away(joints))
        beside = min(near, key=distance.__getitem__)
        of_run = [entry for entry in near if entry.run == beside.run]
        found = min(of_run, key=lambda entry: abs(entry.stamp - joints.stamp))
        return Match(joints, self._messages[found.number].numbers, found.stamp - joints.stamp)


def matched(messages: Iterable[Message], tolerance: int) -> Iterator[Match]:
    """Yield joint positions in the order of the log, with the wrench nearest in time (stamps, within a tolerance [ns]).

    ``LATENESS`` bounds how far apart in the log the two may be, and so the messages in memory.
    """
    waiting: deque[tuple[Message, int]] = deque()  # joint positions, each with how many wrenches had come before it
    window, reach = _Window(tolerance), tolerance + LATENESS

    def is_complete(now: int) -> bool:
        """Return whether all wrenches that may belong to the first joint positions have come at a logged time [ns]."""
        joints, wrenches_before = waiting[0]
        has_too_many = max(len(waiting), window.count - wrenches_before) > _MOST
        return now - joints.logged > reach or has_too_many

    for message in messages:
        if message.is_wrench:
            window.add(message)
        else:
            waiting.append((message, window.count))
        while waiting and is_complete(message.logged):
            yield window.match(waiting.popleft()[0])
        window.forget((waiting[0][0].logged if waiting else message.logged) - reach)
    for joints, _ in waiting:
        yield window.match(joints)
