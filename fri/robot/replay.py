# SPDX-License-Identifier: MIT
"""Compare the torques on the wire with the same controller, stepped in Python on the inputs in the client's log."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .messages import JOINTS, SessionState

GUARD = 1 << 6
"""Bit of the client's column `events`: the torque sent is not the controller's."""


PLAUSIBLE = (500.0, 100.0)
"""[N, N m] Largest wrench that the client takes for one."""


@dataclass(frozen=True)
class ClientLog:
    """Controller steps of a client's session: arrays of shape (steps,) or (steps, width) by name, and its summary."""

    columns: Mapping[str, NDArray[Any]]
    summary: Mapping[str, Any]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["time"])


def read_client_log(log: Path, summary: Path) -> ClientLog:
    """Read the CSV and JSON that fri_wiping writes; columns name_0, name_1, ... become one array."""
    with log.open() as stream:
        assert stream.readline().startswith("# robot: ")
        names = stream.readline().strip().split(",")
        lines = stream.readlines()
    values = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.zeros((0, len(names)))
    places: dict[str, list[int]] = {}  # columns of each array
    for k, name in enumerate(names):
        places.setdefault(_array_name(name), []).append(k)
    columns: dict[str, NDArray[Any]] = {}
    for name, wanted in places.items():
        is_single = names[wanted[0]] == name
        columns[name] = values[:, wanted[0]] if is_single else values[:, wanted]
    return ClientLog(columns, json.loads(summary.read_text()))


def _array_name(column: str) -> str:
    """Return the name of the array that a column belongs to: q of q_0."""
    return column.rsplit("_", 1)[0] if column[-1].isdigit() else column


def controller(robot: Any, summary: Mapping[str, Any]) -> Any:
    """Return the controller of a generated robot, configured as a client's summary says."""
    told = summary["controller"]
    names = ("sample_time", "delay_samples", "motor_inertia", "heaviest_wrench", "position_quantum", "velocity_noise",
             "tip_velocity_limit", "damping_ratio", "effort_limit", "torque_rate_limit")  # fmt: skip
    friction = told.get("coulomb_friction", 0.0)  # summaries of older clients have none
    return robot.Impedance(**{name: told[name] for name in names}, coulomb_friction=friction)


def paper_law(robot: Any, summary: Mapping[str, Any]) -> Any:
    """Return the paper's law, configured as a client's summary says."""
    told = summary["controller"]
    names = ("sample_time", "damping_ratio", "posture_stiffness", "motor_inertia", "effort_limit", "torque_rate_limit")
    return robot.PaperLaw(told["stiffness_formula"], joint_damping=0.0, **{name: told[name] for name in names})


def replayed_torque(robot: Any, log: ClientLog) -> NDArray[np.float64]:
    """Torque (steps, 7) [N m] of the controller, stepped in Python on the inputs in the log.

    It begins anew, and is reset, where the client's did and was, and misses the samples that the client's missed.
    """
    torque = np.full((len(log), JOINTS), np.nan)
    is_paper = log.summary["controller"]["law"] == "paper"
    springs = _springs(log.summary["controller"])
    begins = np.flatnonzero((log["start"] != 0) | (log["reset"] != 0))
    for begin, end in pairwise([*begins, len(log)]):
        if log["start"][begin]:
            impedance = controller(robot, log.summary)
            law = _PaperTorque(robot, log.summary) if is_paper else None
        else:
            impedance.reset()
        part = slice(begin, end)
        inputs = {name: log[name][part] for name in ("q", "dq", "q0", "wrench_command") if name in log.columns}
        inputs |= {name: log[name][part].astype(int) for name in ("counter", "sample_valid")}
        if law is None:
            torque[part] = impedance.run(**springs, **inputs).torque
            continue
        for k, wrench in enumerate(log["wrench"][part]):
            sample = {name: each[k] for name, each in inputs.items()}
            torque[begin + k] = law.step(impedance, springs, sample, wrench)
    return torque


def _springs(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return the springs that a client commands; under the paper's law they are off, and the law's torque an offset."""
    stiffness = np.diag(told["task_stiffness"])
    share = 0.0 if told["law"] == "paper" else 1.0
    return {
        "translation_stiffness": share * stiffness[:3, :3],
        "rotation_stiffness": share * stiffness[3:, 3:],
        "shaped": True,
        "posture_stiffness": 0.0 if told["law"] == "paper" else told["posture_stiffness"],
    }


class _PaperTorque:
    """The client's paper mode: the law's torque is the torque_offset of a controller without springs."""

    def __init__(self, robot: Any, summary: Mapping[str, Any]) -> None:
        self._law, self._bit = paper_law(robot, summary), int(robot.Status.FAULT)
        self._stiffness = np.diag(summary["controller"]["task_stiffness"])
        self._offset: NDArray[np.float64] = np.zeros(JOINTS)
        self._last: Any = None

    def step(
        self, impedance: Any, springs: Mapping[str, Any], sample: Mapping[str, Any], wrench: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the controller's torque of one step."""
        if sample["sample_valid"]:
            self._offset = self._torque(sample, wrench)
        self._last = impedance.run(**springs, **sample, torque_offset=self._offset)
        return np.asarray(self._last.torque[0])

    def _torque(self, sample: Mapping[str, Any], wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the law's torque (7) [N m] for a logged sample, treated as the client treats it."""
        given = {name: np.array(sample[name]) for name in ("q", "dq", "q0")} | {"wrench": np.array(wrench)}
        if self._last is not None and int(self._last.status[0]) & self._bit:
            given |= {"q0": given["q"], "wrench": np.zeros(6)}
        if not np.all(np.linalg.norm(given["wrench"].reshape(2, 3), axis=1) <= PLAUSIBLE):
            given["wrench"][0] = np.nan
        try:
            return np.asarray(self._law.step(**given, task_stiffness=self._stiffness).torque)
        except ValueError:
            return np.asarray(self._law.torque)


@dataclass(frozen=True)
class Comparison:
    """Torques received by the robot against the replay.

    ``compared`` commands were in both; ``worst`` is their largest difference [N m], ``worst_step`` that of the client's
    own steps, received or not. ``guarded`` commands were cut by the client on purpose after lost cycles; their worst
    difference to what its log says was sent is ``worst_guarded``.
    """

    compared: int
    worst: float
    worst_step: float
    guarded: int
    worst_guarded: float


def compare(robot: Any, log: ClientLog, received: Mapping[str, NDArray[Any]]) -> Comparison:
    """Compare what the robot received (its log) with the controller stepped in Python on the client's log."""
    torque = replayed_torque(robot, log)
    worst_step = float(np.max(np.abs(torque - log["torque"]), initial=0.0))
    sequence = np.rint(log["time"] / log.summary["sample_time"]).astype(int)  # of the message that each step answers
    step_of = {s: k for k, (s, valid) in enumerate(zip(sequence, log["sample_valid"], strict=True)) if valid}
    is_active = received["state"] == SessionState.COMMANDING_ACTIVE
    is_guarded = log["events"].astype(int) & GUARD
    worst, worst_guarded, compared, guarded = 0.0, 0.0, 0, 0
    for row in np.flatnonzero(is_active & received["has_torque"]):
        step = step_of.get(int(received["command_reflects"][row]))
        if step is None:
            continue
        command = received["command_torque"][row]
        if is_guarded[step]:
            guarded += 1
            worst_guarded = np.maximum(worst_guarded, np.max(np.abs(log["sent_torque"][step] - command)))
        else:
            compared += 1
            worst = np.maximum(worst, np.max(np.abs(torque[step] - command)))  # max() would lose a NaN
    return Comparison(
        compared=compared,
        worst=float(worst),
        worst_step=worst_step,
        guarded=guarded,
        worst_guarded=float(worst_guarded),
    )


@dataclass(frozen=True)
class Commands:
    """Torques that the robot received in COMMANDING_ACTIVE.

    ``commands`` of them, ``not_finite`` with NaN or infinity, ``beyond_limit`` greater than the effort limit;
    ``worst_rate`` is the largest change from one to the next as a share of what the rate limit allows.
    """

    commands: int
    not_finite: int
    beyond_limit: int
    worst_rate: float


def check_commands(received: Mapping[str, NDArray[Any]], summary: Mapping[str, Any]) -> Commands:
    """Check the torques in the robot's log against the client's own limits.

    The client may move its torque by one step of the rate limit from one command that it sends to the next; between two
    that arrived it may have moved as often as its counter did. Each motion starts from zero torque, in the cycle in
    which the robot begins to command.
    """
    told = summary["controller"]
    is_active = received["state"] == SessionState.COMMANDING_ACTIVE
    rows = np.flatnonzero(is_active & received["has_torque"])
    torque = received["command_torque"][rows]
    is_finite = np.isfinite(torque).all(axis=1)
    is_beyond = (np.abs(torque) > np.array(told["effort_limit"])).any(axis=1)
    change = np.abs(np.diff(torque, axis=0, prepend=np.zeros((1, JOINTS))))
    steps = np.diff(received["command_sequence"][rows], prepend=0)  # of the client between two commands that arrived
    motion = np.cumsum(np.diff(is_active, prepend=False))  # odd numbers count the motions, even ones the pauses
    first = np.flatnonzero(np.diff(motion[rows], prepend=-1))  # command of each motion
    begin = np.array([np.flatnonzero(motion == motion[row])[0] for row in rows[first]], dtype=int)  # row of each motion
    change[first] = np.abs(torque[first])
    steps[first] = received["command_reflects"][rows[first]] - received["sequence"][begin].astype(int) + 1
    per_step = np.array(told["torque_rate_limit"]) * told["sample_time"]  # [N m] that the client allows itself
    rate = (change / per_step).max(axis=1, initial=0.0) / np.maximum(steps, 1)
    return Commands(
        commands=len(rows),
        not_finite=int((~is_finite).sum()),
        beyond_limit=int(is_beyond.sum()),
        worst_rate=float(np.max(rate, initial=0.0)),
    )
