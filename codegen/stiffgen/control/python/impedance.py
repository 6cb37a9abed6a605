"""Impedance controller: NAME_impedance.h for NumPy arrays.

The header documents every field with its unit.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import (
    CONFIG_FIELDS,
    INPUT,
    INPUT_FIELDS,
    OUTPUT,
    STATUS_MEANING,
    WORDS,
    Config,
    Fault,
    Mode,
    Reason,
    Record,
    Refusal,
    Refused,
    Status,
    configuration,
    refusal_of,
    refused_configuration,
)

__all__ = [
    "STATUS_MEANING",
    "CommandWarning",
    "Config",
    "Fault",
    "Impedance",
    "Mode",
    "Reason",
    "Record",
    "Refusal",
    "Refused",
    "Status",
]

_MOVED = {
    "equilibrium": "a step takes no pose: q0 = follow.step(pose=equilibrium).q0, with follow = {name}.Follow(...)",
    "posture": "a step has one command, q0; with a pose: follow.step(pose=pose, posture=posture), of {name}.Follow",
    "tool_pose": "a tool belongs to the configuration: {name}.Impedance(..., tool_pose=tool_pose)",
    "velocity": "the reference finds its own velocity; pass shaped=True with a planned q0",
    "wrench": "a step reads no measured wrench; the energy account needs none",
    "external_torque": "a step reads no torque sensors",
}
"""Arguments of a step that older versions took, and what to write now."""


class CommandWarning(UserWarning):
    """A command is refused: the reference stays where it is."""


class Impedance:
    """Controller with its configuration, its state and, on request, a record of inputs and outputs.

    With closed loops, positions, velocities and torques are those of the motors ``ACTUATED``, and n is their number.

    Parameters
    ----------
    sample_time : float [s]
        Time from one step to the next.
    delay_samples : int
        Delay from a sample to the sample at which its torque acts; 0 if it acts at once.
    motor_inertia : (n) or float [kg m^2 or kg]
        Inertia of the motors' rotors at the joints; the header has what is known of this robot.
    heaviest_wrench : (2) [N, N m]
        Heaviest force and moment that the springs are to exert at a tip.
    torque : (n) [N m or N], optional
        Torque in force, from which the controller's torque moves on at its rate limit; default: zero.
    errors : str, optional
        Reaction to a refused command, beside the output's ``refusal``: "warn" with a :class:`CommandWarning`, once per
        reason and argument; "raise" ValueError, for scripts; or "ignore".
    record : int, optional
        Number of steps whose inputs and outputs are recorded, the newest ones (:attr:`trace`).
    **fields
        Other configuration fields: words ("hold") where the header has choices, one number for all entries of an array.

    Raises
    ------
    TypeError
        A field does not exist, or one that must be stated is missing.
    ValueError
        A value is refused; the message names the field and its condition.

    """

    def __init__(
        self,
        *,
        sample_time: float,
        delay_samples: int,
        motor_inertia: ArrayLike,
        heaviest_wrench: ArrayLike,
        torque: ArrayLike = 0.0,
        record: int = 0,
        errors: str = "warn",
        **fields: ArrayLike,
    ) -> None:
        """Check the words, make room for `record` samples, and start with `torque` [N m] in force."""
        if errors not in ("warn", "raise", "ignore"):
            raise ValueError(f"errors: no value {errors!r}; it takes warn, raise or ignore")
        self._errors, self._warned = errors, set[tuple[int, int]]()
        self._values: NDArray[Any] | None = None
        self._recorded = 0
        self._record = (np.zeros(record, INPUT), np.zeros(record, OUTPUT))
        stated: dict[str, ArrayLike] = {
            "sample_time": sample_time,
            "delay_samples": delay_samples,
            "motor_inertia": motor_inertia,
            "heaviest_wrench": heaviest_wrench,
        }
        self.restart(torque, **stated, **fields)

    def __getstate__(self) -> dict[str, Any]:
        return copy.deepcopy(self.__dict__)  # a copy shares no state with the controller

    def __setstate__(self, content: dict[str, Any]) -> None:
        if content["_state"].nbytes // 8 != (_c.SIZES["state"] + 7) // 8:
            raise ValueError(f"{_c.NAME}: this controller was pickled by another version of the folder; make a new one")
        self.__dict__.update(content)

    @property
    def config(self) -> Config:
        """Configuration; :meth:`restart` takes another one."""
        assert self._values is not None
        return Config(self._values)

    def restart(self, torque: ArrayLike = 0.0, **fields: ArrayLike) -> None:
        """Restart without any sample seen, from a torque in force (n), with some fields of the configuration changed.

        Pass the last output's ``torque`` if the arm is under control: the torque then has no jump.
        """
        config = configuration(self._values, fields)
        state = np.zeros((_c.SIZES["state"] + 7) // 8)  # doubles, so that it is aligned
        initial = np.ascontiguousarray(np.broadcast_to(np.asarray(torque, float), _c.MOTORS))
        code = _c.initialise(config, state, initial)
        if code:
            raise ValueError(refused_configuration(code, config, fields))
        self._values, self._state = config, state

    def reset(self) -> None:
        """Reset a latched fault; the reference then moves on from the arm's position."""
        code = _c.reset(self._state)
        if code:
            raise ValueError(_c.error_text(code))

    def step(
        self,
        *,
        q: ArrayLike,
        dq: ArrayLike,
        q0: ArrayLike,
        translation_stiffness: ArrayLike,
        rotation_stiffness: ArrayLike,
        counter: int | None = None,
        time: float | None = None,
        posture_stiffness: ArrayLike = 1.0,
        shaped: bool = False,
        wrench_command: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        torque_offset: ArrayLike | None = None,
        **moved: Any,
    ) -> Record:
        """Do one step.

        Pass the sample ``q``, ``dq`` (n), the wanted ``q0`` (n), and both stiffnesses, each (3, 3); with several tips,
        arrays per tip have the tips as their first axis. ``counter`` numbers the sample times, or ``time`` [s] of a
        clock counts them; one of them at every call: without, no one knows how long a torque has acted.

        ``posture_stiffness`` (n) or a number holds the self-motion. ``shaped``: q0 is a point of a motion that has
        ramps already. ``wrench_command`` (6) is a wrench that the tip is to exert on the environment, ``acceleration``
        (n) that of a planned q0. ``torque_offset`` (n) is added to the torque, inside its limits.

        Fields of the result are attributes: ``torque``, ``status``, ``fault``, ``reason``, ``refusal`` (None, or
        command, entry, seen and limit), ``energy_supplied``, ``tank``, ``stored``, ``reference``.
        """
        given = {name: value for name, value in locals().items() if name not in ("self", "moved") and value is not None}
        _refuse_moved(moved)
        given["clock"] = _clock(counter, time)
        given["posture_stiffness"] = np.broadcast_to(np.asarray(posture_stiffness, float), _c.MOTORS)
        return Record(self._run({**given, "sample_valid": 1}, 1), single=True)

    def missed(self, *, counter: int | None = None, time: float | None = None) -> Record:
        """Do one step without a sample; pass ``counter`` or ``time`` as for :meth:`step`."""
        given = {"counter": counter} if counter is not None else {"time": time}
        return Record(self._run({"sample_valid": 0, "clock": _clock(counter, time), **given}, 1), single=True)

    def run(self, **inputs: ArrayLike) -> Record:
        """Do steps over time: every input of :meth:`step`, constant or with a leading time axis.

        ``sample_valid`` (0 or 1 per step) marks missed samples. Return a record whose fields have a leading time axis.
        """
        _refuse_moved({name: value for name, value in inputs.items() if name not in INPUT_FIELDS or name == "clock"})
        values = {name: value for name, value in inputs.items() if value is not None}
        values["clock"] = _clock(values.get("counter"), values.get("time"))
        values.setdefault("sample_valid", 1)
        needed = (
            ("q", "dq", "q0", "translation_stiffness", "rotation_stiffness") if np.any(values["sample_valid"]) else ()
        )
        missing = [name for name in needed if name not in values]
        if missing:
            raise TypeError(f"a step needs {', '.join(missing)}")
        posture = np.asarray(values.get("posture_stiffness", 1.0), float)
        values["posture_stiffness"] = posture if posture.ndim else np.full(_c.MOTORS, posture)
        lengths = {np.shape(value)[0] for name, value in values.items() if np.ndim(value) > len(INPUT[name].shape)}
        if len(lengths) > 1:
            raise ValueError(f"inputs of different lengths: {sorted(lengths)}")
        return Record(self._run(values, lengths.pop() if lengths else 1))

    def _run(self, values: Mapping[str, Any], count: int) -> NDArray[Any]:
        """Run `count` samples in C and return their outputs; each value has one row per sample, or one for all."""
        inputs, outputs = np.zeros(count, INPUT), np.zeros(count, OUTPUT)
        for name, value in values.items():
            shape = (count, *INPUT[name].shape)
            if np.shape(value) not in (shape, shape[1:]):
                raise ValueError(f"{name}: shape {np.shape(value)}, not {shape[1:]} or {shape}")
            # C's counter is an uint32_t, which wraps round.
            inputs[name] = np.asarray(value) % 2**32 if name == "counter" else value
        code = _c.run(self._state, inputs, outputs, count)
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
        _, firsts = np.unique(rows[["refusal", "refusal_command"]], return_index=True)
        for first in np.sort(firsts):
            refusal = refusal_of(rows[first : first + 1])
            assert refusal is not None
            if self._errors == "raise":
                raise ValueError(f"command refused: {refusal.text}")
            reason = (int(refusal.reason), WORDS["command"][refusal.command])
            if reason not in self._warned:
                self._warned.add(reason)
                warnings.warn(f"command refused: {refusal.text}", CommandWarning, stacklevel=4)

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


def _clock(counter: Any, time: Any) -> int:
    """Return which clock a call has. Raise TypeError for none or both."""
    if (counter is None) == (time is None):
        raise TypeError(
            "give counter= (number of the sample time) or time= (of a clock, in seconds) at every step, and not both: "
            "without a clock, no one knows how long a torque has acted"
        )
    return WORDS["clock"]["counter" if time is None else "time"]


def _refuse_moved(arguments: Mapping[str, Any]) -> None:
    """Raise TypeError for arguments that a step does not have; those of older versions are told what to write."""
    for name in arguments:
        if name in CONFIG_FIELDS and name != "tool_pose":
            raise TypeError(f"{name}: a field of the configuration; controller.restart(torque, {name}=...) changes it")
        told = _MOVED.get(name, f"no such argument; there are: {', '.join(INPUT_FIELDS)}").format(name=_c.NAME)
        raise TypeError(f"{name}: {told}")
