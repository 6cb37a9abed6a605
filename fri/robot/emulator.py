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

    def _meet(self, datagram: bytes) -> bytes | None:
        """Send the first message until somebody listens; return the answer, if one came at once.

        Raises
        ------
        LinkError
            Nobody listened in time.

        """
        deadline = wall.monotonic() + self._settings.answer_timeout
        while wall.monotonic() < deadline and not self._interrupted:
            self._sent_at.append((self._cycle, wall.perf_counter()))
            try:
                self._link.send(datagram)
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
        """Deliver a datagram and wait for its answer: without limit if an answer must come, else briefly."""
        answer = None
        if self._cycle == 0:
            answer = self._meet(delivery.datagram)
        else:
            self._sent_at.append((delivery.cycle, wall.perf_counter()))
            self._link.send(delivery.datagram)
        # A spoiled message may count for the client or not.
        self._fewest += delivery.intact
        self._most += 1
        if self._most < self._settings.multiplier:
            return
        must = self._fewest >= self._settings.multiplier
        seen = not must and self.quiet is not None
        deadline = wall.monotonic() + (self._settings.answer_timeout if must or seen else UNCERTAIN_WAIT)
        quiet = 0
        while not self._interrupted:
            if answer is None:
                patience = 0.002 if seen else 0.2  # short, so that a signal is noticed
                answer = self._link.receive(min(deadline - wall.monotonic(), patience))
            quiet = quiet + 1 if answer is None and seen and self.quiet is not None and self.quiet() else 0
            if quiet > 1:  # once it may be on its way
                answer = self._link.receive(0.0)
                deadline = 0.0
            if answer is None:
                if wall.monotonic() < deadline:
                    continue
                break
            self._take(answer)
            self._fewest = self._most = 0
            if self._reflected(answer) in (delivery.cycle, None):
                return
            answer = None  # the answer belongs to an earlier message
        if must and not self._interrupted:
            self.session.failure = self.session.failure or (
                f"the client did not answer within {self._settings.answer_timeout:g} s"
            )
            self.session.end("client silent")

    def _reflected(self, datagram: bytes) -> int | None:
        try:
            return self._protocol.decode_command(datagram).reflected
        except MessageError:
            return None

    def _run_by_the_clock(self) -> None:
        start = wall.perf_counter()
        while self.session.state is not SessionState.IDLE:
            monitoring, arriving = self._begin()
            try:
                if self._cycle == 0:
                    answer = self._meet(arriving[0].datagram)
                    start = self._sent_at[-1][1]
                    if answer is not None:
                        self._take(answer)
                else:
                    for delivery in arriving:
                        self._sent_at.append((delivery.cycle, wall.perf_counter()))
                        self._link.send(delivery.datagram)
                self._collect(start + (1 - PLANT_SHARE) * self._period)
            except ConnectionRefusedError:
                self._gone()
            self._finish(monitoring)
            start += self._period
            ahead = start - wall.perf_counter()
            if ahead > 0:
                wall.sleep(ahead)
            else:
                # The robot's clock waits for this machine: no burst of messages makes up for lost time.
                self.statistics.overruns += 1
                self.statistics.slip -= ahead
                start -= ahead

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
