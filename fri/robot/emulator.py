# SPDX-License-Identifier: MIT
"""Run the robot's side of a session: messages out, commands in, one plant step per cycle.

In lockstep a cycle ends with the client's answer, whenever that is; the client cannot tell, and equal sessions are
equal to the last bit. By the wall clock a cycle ends when its period is over.
"""

from __future__ import annotations

import gc
import time as wall
from collections.abc import Iterator
from contextlib import contextmanager

from .cycles import Cycles
from .faults import Delivery
from .link import LinkError
from .messages import MessageError, SessionState

UNCERTAIN_WAIT = 0.1
"""Wall time [s] that lockstep waits for an answer that need not come, to a datagram that a fault spoiled."""
PATIENCE, OBSERVED_PATIENCE = 0.2, 0.002
"""Wall time [s] of one look for an answer, short, so that a signal is noticed: as a rule, and where the client is
observed (``quiet``)."""
PLANT_SHARE = 0.35
"""Share of the period that the wall-clock mode keeps for the plant when no answer comes."""
GOODBYES = 20
"""Most messages with IDLE at the end; sending stops as soon as the client is gone."""


class Emulator(Cycles):
    """Robot's side of one session with a client: its cycles, in lockstep or by the wall clock."""

    def run(self) -> None:
        """Run the session. Its outcome is in ``session.failure`` and ``statistics``.

        Raises
        ------
        LinkError
            No client listened.

        """
        session = self.session
        session.open()
        with _no_garbage_collection():
            if self._settings.lockstep:
                self._run_lockstep()
            else:
                self._run_by_the_clock()
        session.end("session closed")
        self._say_goodbye()

    def _meet(self, delivery: Delivery) -> bytes | None:
        """Send the first message until somebody listens; return the answer, if one came at once.

        Raises
        ------
        LinkError
            Nobody listened in time.

        """
        deadline = wall.monotonic() + self._settings.answer_timeout
        while wall.monotonic() < deadline and not self._interrupted:
            try:
                self._send(delivery)
                answer = self._link.receive(0.05)
                if answer is not None or not self._link.deaf:
                    return answer
            except ConnectionRefusedError:
                wall.sleep(0.02)
        if self._interrupted:
            return None
        raise LinkError(
            f"no client listens on {self._link.address}; start it before the robot, or at most "
            f"{self._settings.answer_timeout:g} s after it"
        )

    def _send(self, delivery: Delivery) -> None:
        """Send a datagram, and note when."""
        self._sent_at.append((delivery.cycle, wall.perf_counter()))
        self._link.send(delivery.datagram)

    def _gone(self) -> None:
        """End the session because the client has closed its port."""
        self.session.failure = self.session.failure or "the client closed its port"
        self.session.end("client gone")

    def _run_lockstep(self) -> None:
        while self.session.state is not SessionState.IDLE:
            monitoring, arriving = self._begin()
            try:
                for delivery in arriving:
                    self._exchange(delivery)
            except ConnectionRefusedError:
                self._gone()
            self._finish(monitoring)

    def _exchange(self, delivery: Delivery) -> None:
        """Deliver a datagram and wait for its answer: without limit if an answer must come, else briefly.

        The client answers every ``multiplier`` messages. A spoiled one may count for it or not: the client has counted
        at least ``_fewest`` and at most ``_most`` since its last answer.
        """
        first = None
        if self._cycle == 0:
            first = self._meet(delivery)
        else:
            self._send(delivery)
        self._fewest += delivery.intact
        self._most += 1
        if self._most < self._settings.multiplier:
            return
        must_answer = self._fewest >= self._settings.multiplier
        for answer in self._answers(first, must_answer=must_answer):
            self._take(answer)
            self._fewest = self._most = 0
            if self._reflected(answer) in (delivery.cycle, None):  # else the answer belongs to an earlier message
                return
        if must_answer and not self._interrupted:
            self.session.failure = self.session.failure or (
                f"the client did not answer within {self._settings.answer_timeout:g} s"
            )
            self.session.end("client silent")

    def _answers(self, first: bytes | None, *, must_answer: bool) -> Iterator[bytes]:
        """Yield the answers that come, beginning with one that came already, as long as one is waited for.

        An answer that must come is waited for up to ``answer_timeout``. One that need not come is waited for briefly,
        or, where the client is observed, until it has sent all its answers.
        """
        is_quiet = None if must_answer else self.quiet
        patience = PATIENCE if is_quiet is None else OBSERVED_PATIENCE
        has_limit = must_answer or is_quiet is not None
        deadline = wall.monotonic() + (self._settings.answer_timeout if has_limit else UNCERTAIN_WAIT)
        if first is not None and not self._interrupted:
            yield first
        quiet_looks = 0  # in a row
        while not self._interrupted:
            answer = self._link.receive(min(deadline - wall.monotonic(), patience))
            quiet_looks = quiet_looks + 1 if answer is None and is_quiet is not None and is_quiet() else 0
            if quiet_looks > 1:  # at the first look its last answer may have been on its way
                answer = self._link.receive(0.0)
                deadline = 0.0
            if answer is not None:
                yield answer
            elif wall.monotonic() >= deadline:
                return

    def _reflected(self, datagram: bytes) -> int | None:
        try:
            return self._protocol.decode_command(datagram).reflected
        except MessageError:
            return None

    def _run_by_the_clock(self) -> None:
        start = wall.perf_counter()  # of the cycle
        while self.session.state is not SessionState.IDLE:
            monitoring, arriving = self._begin()
            try:
                if self._cycle == 0:
                    answer = self._meet(arriving[0])
                    start = self._sent_at[-1][1]  # when somebody listened
                    if answer is not None:
                        self._take(answer)
                else:
                    for delivery in arriving:
                        self._send(delivery)
                self._collect(start + (1 - PLANT_SHARE) * self._period)
            except ConnectionRefusedError:
                self._gone()
            self._finish(monitoring)
            start = self._wait_until(start + self._period)

    def _wait_until(self, due: float) -> float:
        """Wait until the next cycle is due; return when it begins.

        After a late cycle that is now: the robot's clock waits for this machine, and no burst of messages makes up for
        lost time.
        """
        ahead = due - wall.perf_counter()
        if ahead > 0:
            wall.sleep(ahead)
            return due
        self.statistics.overruns += 1
        self.statistics.slip -= ahead
        return due - ahead

    def _collect(self, until: float) -> None:
        """Take answers until one is accepted or time is up; then take all others that have arrived."""
        while True:
            left = 0.0 if self._arrived else until - wall.perf_counter()
            datagram = self._link.receive(left)
            if datagram is None:
                return
            self._take(datagram)

    def _say_goodbye(self) -> None:
        """Send messages with IDLE, without faults, until the client is gone: a session's clean end."""
        monitoring = self._monitoring()
        for _ in range(GOODBYES):
            try:
                self._link.send(self._protocol.encode_monitoring(monitoring))
                self._link.receive(0.01)
            except ConnectionRefusedError:
                return
            monitoring.sequence += 1


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Switch the garbage collector off in the block, because its pauses would delay the robot."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
