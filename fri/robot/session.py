# SPDX-License-Identifier: MIT
"""Decide the states of an FRI session, as the robot does.

The client cannot ask for a state: it answers, and the robot draws its conclusions. States and their order are known;
the rules marked [POLICY] in :class:`Policy` are chosen for this emulator, since those of the real controller are not
published.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from .messages import Quality, SessionState


@dataclass(frozen=True)
class Policy:
    """[POLICY] Rules of the emulator where those of the real controller are not known.

    Attributes
    ----------
    quality_window : int
        Answers that quality looks back on; those not due yet, at the beginning, count as missing.
    excellent, good, fair : float
        Shares of answers in time from which quality is EXCELLENT, GOOD, FAIR.
    grace : float
        How late an answer may be to count as in time [s] (wall clock; in lockstep nothing is late).
    quality_timeout : float
        Time without getting (back) to COMMANDING_WAIT after which the session is given up [s].
    answer_timeout : float
        Time without any answer after which the session is given up [s].
    monitoring_cycles : int
        Cycles in MONITORING_READY before the application starts its motion, and after it before the session closes.
    complete_commands : int
        Commands with everything the mode asks for before COMMANDING_ACTIVE.
    command_timeout : float
        Time without a complete command after which the motion is aborted [s].
    axis_delta : float
        Most that a commanded position may differ from the measured one [rad].
    tracking_window : int
        Cycles that tracking performance looks back on.

    """

    quality_window: int = 100
    excellent: float = 0.99
    good: float = 0.95
    fair: float = 0.7
    grace: float = 0.01
    quality_timeout: float = 10.0
    answer_timeout: float = 2.0
    monitoring_cycles: int = 100
    complete_commands: int = 20
    command_timeout: float = 1.0
    axis_delta: float = 0.17453292519943295
    tracking_window: int = 100


class QualityMeter:
    """Quality of the connection, from answers in time.

    Every ``multiplier`` messages one answer is due; it is in time if it reflects one of them and is there at most
    ``grace_cycles`` after the last of them.
    """

    def __init__(self, policy: Policy, multiplier: int, grace_cycles: int) -> None:
        """Start with no answer in time; grace is in cycles."""
        self._policy = policy
        self._multiplier = multiplier
        self._grace = grace_cycles
        self._judged: deque[bool] = deque([False] * policy.quality_window, policy.quality_window)
        self._answered: set[int] = set()
        self.share = 0.0
        self.missing = 0
        """Answers that were due and not there in time."""

    def answered(self, sequence: int) -> None:
        """Note an answer to the monitoring message of this number."""
        self._answered.add(sequence // self._multiplier)

    def judge(self, sequence: int) -> Quality:
        """Return the quality at the end of the cycle in which the message of this number was sent."""
        last = sequence - self._grace
        if last >= 0 and (last + 1) % self._multiplier == 0:
            block = last // self._multiplier
            there = block in self._answered
            self._judged.append(there)
            self.missing += not there
            self._answered = {b for b in self._answered if b > block}
        self.share = sum(self._judged) / len(self._judged)
        for quality, least in ((Quality.EXCELLENT, self._policy.excellent), (Quality.GOOD, self._policy.good),
                               (Quality.FAIR, self._policy.fair)):  # fmt: skip
            if self.share >= least:
                return quality
        return Quality.POOR


COMMANDING = (SessionState.COMMANDING_WAIT, SessionState.COMMANDING_ACTIVE)


class Session:
    """State machine of a session, with the robot application that starts and ends its motion.

    IDLE - MONITORING_WAIT - (quality GOOD) MONITORING_READY - (motion started) COMMANDING_WAIT - (client commands)
    COMMANDING_ACTIVE - (motion over) MONITORING_READY - IDLE. Quality below GOOD leads back to MONITORING_WAIT.

    Parameters
    ----------
    period : float
        Period of the monitoring messages [s].
    policy : Policy
    duration : float
        Time to spend in COMMANDING_ACTIVE, all motions together [s].
    restarts : int
        How often the application starts its motion again after one was broken off.
    report : callable
        Called with (old state, new state, reason) at every change.

    Attributes
    ----------
    state, quality
        What the next monitoring message says.
    failure : str or None
        Why the session does not end as planned.

    """

    def __init__(
        self,
        period: float,
        policy: Policy,
        duration: float,
        restarts: int,
        report: Callable[[SessionState, SessionState, str], None],
    ) -> None:
        """Start in IDLE; period and duration are in s, counters in cycles."""
        self._period = period
        self._policy = policy
        self._duration = duration
        self._restarts = restarts
        self._report = report
        self._closing = False
        self._monitoring = 0  # cycles since the session was opened, or was commanding, or is to close
        self._cycles = 0  # in this state
        self._complete = 0  # commands in this state
        self._without_command = 0  # cycles since the last complete command
        self._silent = 0  # cycles since the last answer
        self._active_cycles = 0
        self.broken = 0
        self.state = SessionState.IDLE
        self.quality = Quality.POOR
        self.failure: str | None = None

    def open(self) -> None:
        """Open the session: from IDLE to MONITORING_WAIT."""
        self._go(SessionState.MONITORING_WAIT, "session opened")

    @property
    def active_time(self) -> float:
        """Time spent in COMMANDING_ACTIVE so far [s]."""
        return self._active_cycles * self._period

    def _go(self, state: SessionState, reason: str) -> None:
        old, self.state = self.state, state
        self._cycles = self._complete = self._without_command = 0
        self._report(old, state, reason)

    def fail(self, reason: str) -> None:
        """End the session early: the motion stops, then the session closes."""
        self.failure = self.failure or reason
        self._close()
        if self.state in COMMANDING:
            self._go(SessionState.MONITORING_READY, reason)

    def _close(self) -> None:
        if not self._closing:
            self._closing, self._monitoring = True, 0

    def end(self, reason: str) -> None:
        """Close the session at once."""
        if self.state is not SessionState.IDLE:
            self._go(SessionState.IDLE, reason)

    def force(self, state: SessionState) -> None:
        """Put the session into this state, by a fault; from there it follows its rules."""
        if state is SessionState.IDLE:
            self.failure = self.failure or "the session state dropped to IDLE"
            self.end("state drop")
            return
        if state is not self.state:
            if self.state in COMMANDING and state not in COMMANDING:
                self._break_off("the session state dropped")
            self._go(state, "state drop")

    def _break_off(self, reason: str) -> None:
        self.broken += 1
        if self.broken > self._restarts:
            self.failure = self.failure or f"motion broken off {self.broken} times, last because {reason}"
            self._close()

    def _seconds(self, cycles: int) -> float:
        return cycles * self._period

    def advance(self, quality: Quality, *, answered: bool, complete: bool) -> None:
        """End a cycle.

        Parameters
        ----------
        quality : Quality
            Quality of the connection now.
        answered, complete : bool
            Whether an answer was accepted in this cycle, and whether it commands everything that the mode asks for.

        """
        self.quality = quality
        self._cycles += 1
        self._complete += complete
        self._silent = 0 if answered else self._silent + 1
        self._without_command = 0 if complete else self._without_command + 1
        if self.state is SessionState.COMMANDING_ACTIVE:
            self._active_cycles += 1
        self._monitoring = 0 if self.state in COMMANDING else self._monitoring + 1
        if self._seconds(self._silent) > self._policy.answer_timeout:
            self.failure = self.failure or f"no answer from the client for {self._policy.answer_timeout:g} s"
            self.end("client silent")
        elif self._closing and self._monitoring >= self._policy.monitoring_cycles:
            self.end("session closed")
        elif self._seconds(self._monitoring) > self._policy.quality_timeout:
            self.failure = self.failure or (
                f"quality {quality.name} after {self._policy.quality_timeout:g} s without commanding, which needs GOOD"
            )
            self.end("quality")
        elif self.state is not SessionState.MONITORING_WAIT and quality < Quality.GOOD:
            if self.state in COMMANDING:
                self._break_off(f"the connection's quality fell to {quality.name}")
            self._go(SessionState.MONITORING_WAIT, f"quality {quality.name}")
        else:
            getattr(self, f"_in_{self.state.name.lower()}")(quality)

    def _in_monitoring_wait(self, quality: Quality) -> None:
        if quality >= Quality.GOOD:
            self._go(SessionState.MONITORING_READY, f"quality {quality.name}")

    def _in_monitoring_ready(self, _quality: Quality) -> None:
        if not self._closing and self._cycles >= self._policy.monitoring_cycles:
            self._go(SessionState.COMMANDING_WAIT, "motion started")

    def _in_commanding_wait(self, _quality: Quality) -> None:
        if self._complete >= self._policy.complete_commands:
            self._go(SessionState.COMMANDING_ACTIVE, f"{self._complete} complete commands")
        else:
            self._check_command()

    def _in_commanding_active(self, _quality: Quality) -> None:
        if self.active_time >= self._duration - 1e-9:
            self._close()
            self._go(SessionState.MONITORING_READY, "motion over")
        else:
            self._check_command()

    def _check_command(self) -> None:
        if self._seconds(self._without_command) > self._policy.command_timeout:
            self.fail(
                f"no complete command for {self._policy.command_timeout:g} s: every answer must have a position, "
                "and in torque mode a torque"
            )
