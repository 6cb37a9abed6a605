"""Follow: joint positions from poses of the tip. NAME_follow.h for NumPy arrays."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import WORDS, enumeration, layout, of_shape

_CONFIG, _INPUT, _OUTPUT = map(layout, ("follow_config", "follow_input", "follow_output"))
_FIELDS, _INPUTS = _CONFIG.names or (), _INPUT.names or ()
FollowStatus = enumeration(IntFlag, "FollowStatus", WORDS["follow"])
"""Bits of a step's status: MOVING, SMOOTHED, BY_JOINTS, UNREACHABLE, REFUSED."""


class FollowOutput(NamedTuple):
    """Result of a step: command q0 (n) and what became of the pose; of ``run``, arrays with an entry per step."""

    q0: NDArray[np.float64]
    status: Any


class Follow:
    """Maker of joint positions from poses: the tip goes straight to its pose, within the limits of tip and joints.

    It measures nothing and commands nothing: q0 is for :class:`Impedance`, or for an arm that takes positions. Poses
    that follow one another within 30 ms are a motion, and are followed without lag; poses at longer intervals are
    smoothed. Out of reach, q0 is as near as it comes, and the status says UNREACHABLE.

    Parameters
    ----------
    q : (n) [rad or m]
        Joint positions at which it begins: those of the arm.
    sample_time : float [s]
        Time from one step to the next.
    **fields
        Fields of the configuration (NAME_follow.h): lower_limit, upper_limit, limit_distance and velocity_limit take
        (n) or one number; tip_velocity_limit [m/s], tip_rotation_limit [rad/s], ramp_time [s], smoothing.

    Raises
    ------
    TypeError
        A field does not exist.
    ValueError
        A value is refused.

    """

    def __init__(self, q: ArrayLike, *, sample_time: float, **fields: ArrayLike) -> None:
        """Set the configuration, refuse unknown fields, and start at q [rad or m]."""
        unknown = sorted(set(fields) - set(_FIELDS))
        if unknown:
            raise TypeError(f"no configuration field '{unknown[0]}'; there are: {', '.join(_FIELDS)}")
        self._config = np.zeros(1, _CONFIG)
        _c.follow_default(self._config)
        for name, value in {"sample_time": sample_time, **fields}.items():
            self._config[name] = of_shape(name, value, _CONFIG[name].shape)
        self._state = np.zeros((_c.SIZES["follow_state"] + 7) // 8)
        self.restart(q)

    def restart(self, q: ArrayLike) -> None:
        """Begin anew at joint positions ``q`` (n), at rest; ValueError for positions that are not finite."""
        start = of_shape("q", q, (_c.MOTORS,), one=False)
        code = _c.follow_init(self._config, self._state, start)
        if code:
            raise ValueError(_c.follow_error_text(code))
        self._posture, self._last = start, np.zeros(1, _OUTPUT)
        self._last["q0"] = start

    @property
    def config(self) -> dict[str, Any]:
        """Configuration in force, by field."""
        return {name: np.array(self._config[name][0])[()] for name in _FIELDS}

    @property
    def q0(self) -> NDArray[np.float64]:
        """Command (n) [rad or m] of the last step, also of one whose pose was refused."""
        return np.array(self._last["q0"][0])

    @property
    def dq0(self) -> NDArray[np.float64]:
        """Velocity (n) [rad/s or m/s] of the last step's q0."""
        return np.array(self._last["dq0"][0])

    @property
    def error(self) -> NDArray[np.float64]:
        """Distance [m] and angle [rad] of the tip from its pose before the last step: (2), or (tips, 2)."""
        return np.array(self._last["error"][0])

    def step(
        self,
        *,
        pose: ArrayLike | None = None,
        posture: ArrayLike | None = None,
        tool_pose: ArrayLike | None = None,
        object_pose: ArrayLike | None = None,
        grasp: ArrayLike | None = None,
    ) -> FollowOutput:
        """Do one step.

        ``pose`` (4, 4) is the tip's in the base, of several tips (tips, 4, 4). ``posture`` (n) is where joints go that
        the pose leaves free, and what q0 goes to where the straight line is blocked and the posture has the pose; it
        stays until another one is given, and is ``q`` at first. ``tool_pose`` (4, 4) is the tool's, of robots that take
        it at run time alone. Several tips that hold one object take its ``object_pose`` (4, 4) in the base in place of
        ``pose``, and their poses in it, ``grasp`` (tips, 4, 4): on the object's straight way they keep their places in
        it. Returns q0 (n) and the status (:class:`FollowStatus`).

        ValueError for a pose that is no pose, or numbers that are not finite; the step was done with the last good
        ones, and ``q0`` has its result.
        """
        given = {"pose": pose, "posture": posture, "tool_pose": tool_pose, "object_pose": object_pose, "grasp": grasp}
        output, code = self._do(1, given)
        if code:
            raise ValueError(_c.follow_error_text(code))
        return FollowOutput(np.array(output["q0"][0]), FollowStatus(int(output["status"][0])))

    def run(
        self,
        *,
        pose: ArrayLike | None = None,
        posture: ArrayLike | None = None,
        tool_pose: ArrayLike | None = None,
        object_pose: ArrayLike | None = None,
        grasp: ArrayLike | None = None,
    ) -> FollowOutput:
        """Do a step for each of the poses, (steps, 4, 4) or (steps, tips, 4, 4): a path is converted in one call.

        The other arguments are as for ``step``, or have a row per step. Returns q0 (steps, n) and the status (steps) as
        integers. ValueError if any step was refused.
        """
        steps = len(np.asarray(object_pose if pose is None else pose))
        given = {"pose": pose, "posture": posture, "tool_pose": tool_pose, "object_pose": object_pose, "grasp": grasp}
        output, code = self._do(steps, given)
        if code:
            raise ValueError(_c.follow_error_text(code))
        return FollowOutput(np.array(output["q0"]), np.array(output["status"]))

    def _do(self, steps: int, arguments: dict[str, ArrayLike | None]) -> tuple[NDArray[Any], int]:
        """Run `steps` samples in C and return their outputs (steps) and the code; arguments may be constant over
        steps.
        """
        given = {"posture": self._posture, **_given(arguments)}
        inputs, outputs = np.zeros(steps, _INPUT), np.zeros(steps, _OUTPUT)
        for name, value in given.items():
            array, shape = np.asarray(value, float), _INPUT[name].shape
            if array.shape != shape and array.shape != (steps, *shape):
                raise ValueError(f"{name}: shape {array.shape}, not {shape}")
            inputs[name] = array
        if not steps:
            return outputs, 0
        code = _c.follow_step(steps, self._state, inputs, outputs)
        if np.isfinite(inputs["posture"][-1]).all():
            self._posture = np.array(inputs["posture"][-1])
        self._last = outputs[-1:]
        return outputs, code


def _given(arguments: dict[str, ArrayLike | None]) -> dict[str, ArrayLike]:
    """Return the arguments that are given; TypeError if they are not those that the robot takes together."""
    given = {name: value for name, value in arguments.items() if value is not None}
    if ("pose" in given) == ("object_pose" in given) or ("object_pose" in given) != ("grasp" in given):
        raise TypeError("give pose, or object_pose and grasp")
    unknown = [name for name in given if name not in _INPUTS]
    if unknown or ("tool_pose" in _INPUTS and "tool_pose" not in given):
        wrong = f"this robot has no {unknown[0]}" if unknown else "tool_pose must be given"
        raise TypeError(f"{wrong}: see NAME_follow_input in NAME_follow.h")
    return given
