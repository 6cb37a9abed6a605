"""Settle: no error at rest, by an integral that moves the commanded pose. NAME_settle.h for NumPy arrays."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import WORDS, enumeration, layout, of_shape

_CONFIG, _INPUT, _OUTPUT = map(layout, ("settle_config", "settle_input", "settle_output"))
_FIELDS = _CONFIG.names or ()
SettleStatus = enumeration(IntFlag, "SettleStatus", WORDS["settle"])
"""Bits of a step's status: MOVING, SETTLED, HELD, LIMITED."""


class SettleOutput(NamedTuple):
    """Result of a step: moved pose (4, 4) [m] for Follow, and what the integral does."""

    pose: NDArray[np.float64]
    status: Any


class Settle:
    """Integral of the pose error that moves the commanded pose, for no error at rest.

    It adds no torque: the controller's energy bound holds as it is. It integrates while the command and the tip are at
    rest, and is held else. q cannot tell a payload from a contact: pass a sensor's ``wrench``, or ``hold=True`` where
    contact is meant; a blocked tip feels ``settle_force`` more::

        settle = robot.Settle(controller, settle_force=(35, 3))
        pose = settle.step(pose=goal, last=out, **springs).pose
        out = controller.step(q0=follow.step(pose=pose).q0, shaped=True, **sample, **springs)

    Parameters
    ----------
    controller : Impedance or its config
        Controller whose damping tunes the integral.
    settle_force : (2) [N, N m]
        Largest force and moment that the offset lets the springs exert.
    **fields
        Other fields of the configuration (NAME_settle.h): settle_band (2) [m, rad], contact_wrench (2) [N, N m].

    Raises
    ------
    TypeError
        A field does not exist.
    ValueError
        A value is refused.

    """

    def __init__(self, controller: Any, *, settle_force: ArrayLike, **fields: ArrayLike) -> None:
        """Set the configuration, and take the controller's, whose springs are moved."""
        unknown = sorted(set(fields) - set(_FIELDS))
        if unknown:
            raise TypeError(f"no configuration field '{unknown[0]}'; there are: {', '.join(_FIELDS)}")
        self._config = np.zeros(1, _CONFIG)
        _c.settle_default(self._config)
        for name, value in {"settle_force": settle_force, **fields}.items():
            self._config[name] = of_shape(name, value, _CONFIG[name].shape, one=False)
        self._controller = np.array(getattr(controller, "config", controller)._values)
        self._state = np.zeros((_c.SIZES["settle_state"] + 7) // 8)
        self.restart()

    def restart(self) -> None:
        """Begin anew without an offset."""
        code = _c.settle_init(self._config, self._controller, self._state)
        if code:
            raise ValueError(_c.settle_error_text(code))
        self._last = np.zeros(1, _OUTPUT)

    @property
    def offset(self) -> NDArray[np.float64]:
        """Translation and rotation vector (6) [m, rad] of the last step's move, in base axes."""
        return np.array(self._last["offset"][0])

    @property
    def error(self) -> NDArray[np.float64]:
        """Distance and angle (2) [m, rad] of the measured tip from the wanted pose in the last step."""
        return np.array(self._last["error"][0])

    def step(
        self,
        *,
        pose: ArrayLike,
        last: Any,
        translation_stiffness: ArrayLike,
        rotation_stiffness: ArrayLike,
        wrench: ArrayLike | None = None,
        hold: bool = False,
    ) -> SettleOutput:
        """Do one step.

        ``pose`` (4, 4) is wanted of the tip, ``last`` the controller's last result, or None before the first. The
        stiffnesses (3, 3) are those of the controller's step. ``wrench`` (6) is measured: that of the environment on
        the robot, without the payload's weight; with ``hold`` the offset stays.

        ValueError for numbers that are not finite; the step was done with the last good pose.
        """
        row, output = np.zeros(1, _INPUT), np.zeros(1, _OUTPUT)
        given = {"pose": pose, "translation_stiffness": translation_stiffness, "rotation_stiffness": rotation_stiffness}
        for name, value in (given if wrench is None else {**given, "wrench": wrench}).items():
            row[name] = of_shape(name, value, _INPUT[name].shape, one=False)
        row["hold"] = hold
        before = None if last is None else np.ascontiguousarray(last._rows[-1:])
        code = _c.settle_step(self._state, row, before, output)
        self._last = output
        if code:
            raise ValueError(_c.settle_error_text(code))
        return SettleOutput(np.array(output["pose"][0]), SettleStatus(int(output["status"][0])))
