"""Impedance controller: NAME_impedance.h for NumPy arrays.

The header documents every field with its unit. A wrench is what the environment applies to the robot.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c, _presets
from ._structs import (
    INPUT,
    INPUT_FIELDS,
    OUTPUT,
    PARTS,
    POLICY,
    PROPOSAL,
    REFUSAL,
    STATUS_MEANING,
    WORDS,
    Config,
    Fault,
    Mode,
    Reason,
    Record,
    Refusal,
    Refused,
    Stage,
    Status,
    allowed_stiffness,
    check_inputs,
    refusal_text,
    tell_tool,
)

__all__ = [
    "STATUS_MEANING",
    "CommandWarning",
    "Config",
    "Fault",
    "Gains",
    "Impedance",
    "Mode",
    "Policy",
    "Reason",
    "Record",
    "Refusal",
    "Refused",
    "Stage",
    "Status",
    "joint_gains",
    "late_work",
]


class CommandWarning(UserWarning):
    """A command is refused: the equilibrium stays where it is."""


class Impedance:
    """Controller with its configuration, its state and, on request, a record of inputs and outputs.

    With closed loops, positions, velocities and torques are those of the motors ``ACTUATED``, and n is their number.

    Parameters
    ----------
    config : mapping, optional
        Values of configuration fields by name: words ("bounded") where the header has choices, one number for all
        entries of an array. Other fields have their defaults.
    torque : (n) [N m], optional
        Torque in force, from which the controller's torque moves on at its rate limit; default: zero. Give the
        ``torque_offset`` that it contains with the first sample: it then counts once.
    errors : str, optional
        Reaction to a refused command, beside the output's ``refusal``: "warn" with a :class:`CommandWarning`, once per
        reason and argument; "raise" ValueError, for scripts; or "ignore".
    record : int, optional
        Number of steps whose inputs and outputs are recorded, the newest ones (:attr:`trace`).
    **fields
        Configuration fields, as in ``config``.

    Raises
    ------
    TypeError
        A field does not exist.
    ValueError
        A value is refused; the message names the field and its condition.

    """

    def __init__(
        self,
        config: Mapping[str, ArrayLike] | None = None,
        *,
        torque: ArrayLike = 0.0,
        record: int = 0,
        errors: str = "warn",
        **fields: ArrayLike,
    ) -> None:
        if errors not in ("warn", "raise", "ignore"):
            raise ValueError(f"errors: no value {errors!r}; it takes warn, raise or ignore")
        self._errors, self._warned = errors, set[tuple[int, int]]()
        self._config = Config()
        self._config.update({**(config or {}), **fields})
        self._state = np.zeros((_c.SIZES["state"] + 7) // 8)  # doubles, so that it is aligned
        self._recorded = 0
        self._record = (np.zeros(record, INPUT), np.zeros(record, OUTPUT))
        self.restart(torque)

    @classmethod
    def preset(cls, name: str, **arguments: Any) -> tuple[Impedance, dict[str, NDArray[np.float64]]]:
        """Return a controller with the spring of a law on which policies were trained, and the stiffnesses to command.

        Pass the stiffnesses to every :meth:`step`, or to every :meth:`Policy.propose`. A goal q_d is both: its pose is
        the equilibrium, and q_d the posture. The damping is the controller's own, of the preset's ratio.

        ``name`` is "droid", "droid_400", "serl" (in a folder generated with ``--spring bounded``) or "crisp". Other
        arguments are those of the class, and replace the preset's. The dict has ``translation_stiffness`` [N/m] and
        ``rotation_stiffness`` [N m/rad], each (3, 3), with several tips (tips, 3, 3). Raises ValueError for another
        name, or where the preset's posture stiffness has another number of joints.
        """
        given = {**(arguments.pop("config", None) or {}), **arguments}
        fields, springs = _presets.settings(name, given)
        return cls(**fields), springs

    def __getstate__(self) -> dict[str, Any]:
        return copy.deepcopy(self.__dict__)  # a copy shares no state with the controller

    def __setstate__(self, content: dict[str, Any]) -> None:
        if content["_state"].nbytes // 8 != (_c.SIZES["state"] + 7) // 8:
            raise ValueError(f"{_c.NAME}: this controller was pickled by another version of the folder; make a new one")
        self.__dict__.update(content)

    @property
    def config(self) -> Config:
        """Configuration; its fields can be set while the controller runs."""
        return self._config

    def describe(self) -> str:
        """Return the configuration as text: basic fields, then expert ones, with what follows from them in force.

        A star marks what differs from the default. Nothing of the controller changes.
        """
        ahead, content = object.__new__(type(self)), dict(self.__dict__)
        content["_record"] = (np.zeros(0, INPUT), np.zeros(0, OUTPUT))  # before the copy: a record may be long
        ahead.__dict__.update(copy.deepcopy(content))
        return self._config.describe(ahead.missed())

    def restart(self, torque: ArrayLike = 0.0) -> None:
        """Restart without any sample seen; configuration and record stay."""
        initial = np.ascontiguousarray(np.broadcast_to(np.asarray(torque, float), _c.MOTORS))
        code = _c.initialise(self._config._values, self._state, initial)
        if code:
            raise ValueError(_c.error_text(code) + allowed_stiffness(self._config._values))
        self._counter = 0
        self._clock: tuple[float, float, int] | None = None

    def reset(self) -> None:
        """Reset a latched fault; the governor then brings the equilibrium back from the arm's position."""
        code = _c.reset(self._state)
        if code:
            raise ValueError(_c.error_text(code))

    def step(
        self,
        *,
        q: ArrayLike,
        dq: ArrayLike,
        q0: ArrayLike | None = None,
        equilibrium: ArrayLike | None = None,
        posture: ArrayLike | None = None,
        tool_pose: ArrayLike | None = None,
        translation_stiffness: ArrayLike | None = None,
        rotation_stiffness: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        torque_offset: ArrayLike | None = None,
        external_torque: ArrayLike | None = None,
        wrench_command: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        counter: int | None = None,
        time: float | None = None,
    ) -> Record:
        """Do one step.

        Pass either ``q0`` (n), or ``equilibrium`` (4, 4) with ``posture`` (n), and both stiffnesses, each (3, 3). A
        measured ``wrench`` (6) is checked and reported. ``tool_pose`` (4, 4) is the tool's, of robots that take it at
        run time alone.

        ``torque_offset`` (n) is added to the torque, inside its limits. ``external_torque`` (n) is the environment's,
        known from elsewhere than ``q``: it explains why a joint stands still. ``wrench_command`` (6) is a wrench that
        the tip is to exert on the environment. ``velocity`` and ``acceleration`` (n) are those of a planned ``q0``,
        or of the joints that follow a planned ``equilibrium``.

        ``counter`` numbers the samples, or ``time`` [s] of a clock counts them: a loop that is late tells so that
        samples are missing. Without both, each call counts as the next sample, and the energy account knows nothing
        of calls that are left out. With several tips, arrays per tip have the tips as their first axis. Fields of the
        result are attributes (``.torque``, ``.status``).
        """
        values = {name: value for name, value in locals().items() if name != "self" and value is not None}
        if time is not None:
            if counter is not None:
                raise TypeError("give either counter or time")
            values["counter"] = self._count(float(values.pop("time")))
        return Record(self._run(values, 1), single=True)

    def _count(self, time: float) -> int:
        """Return the counter at a time: of the sample times that have passed, and at least one more than before."""
        if not np.isfinite(time):
            raise ValueError(f"time: {time} is not finite")
        before, lead, last = self._clock or (time, 1.0, self._counter)  # lead: of the clock over the counter
        counted = (self._counter - last + 2**31) % 2**32 - 2**31  # by calls without a time
        lead += (time - before) / float(self._config.sample_time) - counted
        ahead = max(1, round(lead))
        self._clock = time, max(lead - ahead, -1.0), (self._counter + ahead) % 2**32
        return (self._counter + ahead) % 2**32

    def missed(self) -> Record:
        """Do one step without a sample."""
        return Record(self._run({"sample_valid": 0}, 1), single=True)

    def run(self, **inputs: ArrayLike) -> Record:
        """Do steps over time: every input of :meth:`step`, constant or with a leading time axis.

        ``sample_valid`` (0 or 1 per step) marks missed samples. Return a record whose fields have a leading time axis.
        """
        values = {name: value for name, value in inputs.items() if value is not None}
        unknown = set(values) - {*INPUT_FIELDS, "posture"} | (
            set(values) & {"command", "wrench_valid", "external_valid"}
        )
        if unknown:
            raise TypeError(f"no input '{sorted(unknown)[0]}'; there are: {', '.join(_names())}")
        lengths = {np.shape(value)[0] for name, value in values.items() if np.ndim(value) > _rank(name)}
        if len(lengths) > 1:
            raise ValueError(f"inputs of different lengths: {sorted(lengths)}")
        return Record(self._run(values, lengths.pop() if lengths else 1))

    def _run(self, values: dict[str, Any], count: int) -> NDArray[Any]:
        inputs, outputs = np.zeros(count, INPUT), np.zeros(count, OUTPUT)
        valid = values.setdefault("sample_valid", 1)
        if np.any(valid):
            self._require(values)
        inputs["command"] = WORDS["command"]["equilibrium" if "equilibrium" in values else "position"]
        inputs["wrench_valid"] = "wrench" in values
        inputs["external_valid"] = "external_torque" in values
        inputs["counter"] = (self._counter + 1 + np.arange(count)) % 2**32
        for argument, value in values.items():
            name = "q0" if argument == "posture" else argument
            shape = (count, *INPUT[name].shape)
            if np.shape(value) not in (shape, shape[1:]):
                raise ValueError(f"{argument}: shape {np.shape(value)}, not {shape[1:]} or {shape}")
            inputs[name] = value
        self._counter = int(inputs["counter"][-1])
        code = _c.run(self._config._values, self._state, inputs, outputs, count)
        if code:
            raise ValueError(_c.error_text(code))
        self._store(inputs, outputs)
        self._tell(outputs)
        return outputs

    def _tell(self, outputs: NDArray[Any]) -> None:
        """Warn of commands that are refused, or raise."""
        if self._errors == "ignore" or not outputs["refusal"].any():
            return
        rows = outputs[outputs["refusal"] != 0]
        _, firsts = np.unique(rows[["refusal", "refusal_argument"]], return_index=True)
        for row in rows[np.sort(firsts)]:
            if self._errors == "raise":
                raise ValueError(f"command refused: {refusal_text(row)}")
            reason = (int(row["refusal"]), int(row["refusal_argument"]))
            if reason not in self._warned:
                self._warned.add(reason)
                warnings.warn(f"command refused: {refusal_text(row)}", CommandWarning, stacklevel=4)

    def _require(self, values: Mapping[str, Any]) -> None:
        poses = "equilibrium" in values or "posture" in values
        if poses == ("q0" in values):
            raise TypeError("give either q0, or equilibrium and posture")
        needed = ["q", "dq", *(("equilibrium", "posture") if poses else ("q0",))]
        needed += ["tool_pose"] if "tool_pose" in INPUT_FIELDS else []
        check_inputs(self.step, values, INPUT_FIELDS, [*needed, "translation_stiffness", "rotation_stiffness"])

    def _store(self, inputs: NDArray[Any], outputs: NDArray[Any]) -> None:
        capacity = len(self._record[0])
        if capacity:
            slots = np.arange(self._recorded, self._recorded + len(inputs))[-capacity:] % capacity
            for record, new in zip(self._record, (inputs, outputs), strict=True):
                record[slots] = new[-capacity:]
        self._recorded += len(inputs)

    @property
    def trace(self) -> tuple[Record, Record]:
        """Inputs and outputs of the recorded steps, oldest first; fields have a leading time axis."""
        capacity = len(self._record[0])
        count = min(self._recorded, capacity)
        slots = np.arange(self._recorded - count, self._recorded) % max(capacity, 1)
        inputs, outputs = (Record(record[slots]) for record in self._record)
        return inputs, outputs


tell_tool(Impedance.step, INPUT_FIELDS)


class Policy:
    """Port for a slow commander, 10 to 60 Hz, such as a learned policy: interpolates, holds, fades and refuses.

    Parameters
    ----------
    controller : Impedance
        Controller whose limits hold for proposals.
    pose : (4, 4)
        Pose of the tip at the start (with several tips, the tips are the first axis); the stiffness starts at 0.
    now : float [s]
        Time at the start.
    **settings : float
        ``hold_time``, ``fade_time``, ``stale_share``, ``longest_interval``, ``clock_tolerance``, ``smoothing``: see
        the header.

    """

    SETTINGS = ("hold_time", "fade_time", "stale_share", "longest_interval", "clock_tolerance", "smoothing")

    def __init__(self, controller: Impedance, *, pose: ArrayLike, now: float, **settings: float) -> None:
        self._config = controller.config
        self._policy = np.zeros(1, POLICY)
        poses = np.ascontiguousarray(pose, float)
        if poses.shape != POLICY["equilibrium"].shape:
            raise ValueError(f"pose: shape {poses.shape}, not {POLICY['equilibrium'].shape}")
        code = _c.policy_start(self._policy, poses, now)
        if code:
            raise ValueError(_c.error_text(code))
        for name, value in settings.items():
            most = {"stale_share": 1.0, "longest_interval": 1.0, "smoothing": 0.9}.get(name, 10.0)
            if name not in self.SETTINGS:
                raise TypeError(f"no setting '{name}'; there are: {', '.join(self.SETTINGS)}")
            if not 0.0 <= value <= most:
                raise ValueError(f"{name}: {value!r} does not lie between 0 and {most:g}")
            self._policy[name] = value

    def propose(
        self,
        *,
        now: float,
        time: ArrayLike,
        equilibrium: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        translation_stiffness: ArrayLike | None = None,
        rotation_stiffness: ArrayLike | None = None,
        wrench_command: ArrayLike | None = None,
        gripper: float | None = None,
    ) -> dict[str, IntEnum]:
        """Hand over a proposal when it arrives; return the parts that are refused, and why.

        ``time`` [s] is the stamp of all parts, or one of each (pose, stiffness, wrench, gripper). What is None is not
        proposed. Pass ``stiffness`` (6, 6), or ``translation_stiffness`` with ``rotation_stiffness``, each (3, 3).
        """
        blocks = (translation_stiffness, rotation_stiffness)
        if (blocks[0] is None) != (blocks[1] is None) or (stiffness is not None and blocks[0] is not None):
            raise TypeError("give either stiffness, or translation_stiffness and rotation_stiffness")
        row = np.zeros(1, PROPOSAL)
        if blocks[0] is not None:
            stiffness = np.zeros(PROPOSAL["stiffness"].shape)
            for part, block in zip((slice(0, 3), slice(3, 6)), blocks, strict=True):
                _same_shape("stiffness", block, stiffness[..., part, part].shape)
                stiffness[..., part, part] = block
        parts = {
            "equilibrium": equilibrium,
            "stiffness": stiffness,
            "wrench_command": wrench_command,
            "gripper": gripper,
        }
        for k, (name, value) in enumerate(parts.items()):
            if value is not None:
                _same_shape(name, value, PROPOSAL[name].shape)
                row[name], row["valid"][0, k] = value, 1
        row["time"] = time
        _c.policy_propose(self._config._values, self._policy, row, now)
        return {part: Refused(k) for part, k in zip(PARTS, self._policy["refused"][0].tolist(), strict=True) if k}

    def command(self, now: float) -> dict[str, NDArray[np.float64]]:
        """Return the arguments of :meth:`Impedance.step` that the port commands at a time [s].

        Pass them as keywords, beside q, dq and the posture.
        """
        row = np.zeros(1, INPUT)
        _c.policy_command(self._policy, now, row)
        names = ("equilibrium", "translation_stiffness", "rotation_stiffness", "wrench_command")
        return {name: row[name][0] for name in names}

    @property
    def refusals(self) -> dict[str, str]:
        """Refused parts of the newest proposal in words, with the number that was seen and its limit."""
        row = self._policy[0]
        found = {part: {name: row[name][k] for name in ("refused", *REFUSAL)} for k, part in enumerate(PARTS)}
        return {
            part: refusal_text(each) if each["refusal"] else Refused(each["refused"]).name.lower()
            for part, each in found.items()
            if each["refused"]
        }

    @property
    def gripper(self) -> float:
        """Value of the newest accepted gripper part; 0 before the first."""
        return float(self._policy["gripper"][0])

    @property
    def stage(self) -> dict[str, IntEnum]:
        """Stage of each part at the time of the last call."""
        return {part: Stage(k) for part, k in zip(PARTS, self._policy["stage"][0].tolist(), strict=True)}


def _same_shape(name: str, value: Any, shape: tuple[int, ...]) -> None:
    if np.shape(value) != shape:
        raise ValueError(f"{name}: shape {np.shape(value)}, not {shape}")


class Gains(NamedTuple):
    """Command for motors that apply tau_ff + kp (q_des - q) + kd (dq_des - dq), each (n)."""

    tau_ff: NDArray[np.float64]
    kp: NDArray[np.float64]
    kd: NDArray[np.float64]


def _packed(*parts: tuple[ArrayLike, tuple[int, ...]]) -> NDArray[np.float64]:
    return np.concatenate([np.broadcast_to(np.asarray(value, float), shape).ravel() for value, shape in parts])


def joint_gains(
    *,
    q: ArrayLike,
    dq: ArrayLike,
    torque: ArrayLike,
    joint_stiffness: ArrayLike,
    damping: ArrayLike,
    kp_limit: ArrayLike,
    kd_limit: ArrayLike,
    q_des: ArrayLike | None = None,
    dq_des: ArrayLike = 0.0,
) -> Gains:
    """Split a torque at (q, dq) for motors with a controller inside.

    kp and kd are the diagonals of ``joint_stiffness`` and ``damping`` (n, n), at least 0 and at most their limits; what
    is not diagonal stays in tau_ff. ``q_des`` is q without one. Raises ValueError for numbers that are not finite.
    """
    n, matrix = (_c.MOTORS,), (_c.MOTORS, _c.MOTORS)
    wanted = q if q_des is None else q_des
    vectors = [(value, n) for value in (q, dq, wanted, dq_des, torque)]
    limits = ((kp_limit, n), (kd_limit, n))
    results = np.empty((3, _c.MOTORS))
    code = _c.joint_gains(_packed(*vectors, (joint_stiffness, matrix), (damping, matrix), *limits), results)
    if code:
        raise ValueError(_c.error_text(code))
    return Gains(*results)


def late_work(
    *,
    q: ArrayLike,
    q_des: ArrayLike,
    tau_ff: ArrayLike,
    kp: ArrayLike,
    kd: ArrayLike,
    velocity_limit: ArrayLike,
    hold: float,
    dq_des: ArrayLike = 0.0,
) -> float:
    """Return the most work [J] that motors put out from q on if their next command comes after at most ``hold`` [s].

    No joint is faster than ``velocity_limit`` (n). NaN for numbers that are not finite, or below 0.
    """
    vectors = [(value, (_c.MOTORS,)) for value in (q, q_des, dq_des, tau_ff, kp, kd, velocity_limit)]
    return float(_c.late_work(_packed(*vectors), hold))


def _names() -> list[str]:
    return [
        *(name for name in INPUT_FIELDS if name not in ("command", "wrench_valid", "external_valid")),
        "posture",
    ]


def _rank(name: str) -> int:
    return len(INPUT["q0" if name == "posture" else name].shape)
