"""Press: a force along an axis, held with a sensor's wrench. NAME_press.h for NumPy arrays."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import WORDS, enumeration, layout, of_shape

_CONFIG, _INPUT, _OUTPUT = map(layout, ("press_config", "press_input", "press_output"))
_FIELDS = _CONFIG.names or ()
PressStage = enumeration(IntEnum, "PressStage", WORDS["press_stage"])
"""Stage of pressing: OFF, APPROACH, CONTACT, LOST."""


class PressOutput(NamedTuple):
    """Result of a step: moved pose (4, 4) [m] for Follow, wrench_command (6) [N, N m], and the stage."""

    pose: NDArray[np.float64]
    wrench_command: NDArray[np.float64]
    stage: Any


class Press:
    """Force along an axis, with a sensor's wrench; the other directions follow the commanded pose.

    It makes commands alone: the controller's energy bound holds whatever the sensor says. All springs stay on::

        press = robot.Press(controller)
        made = press.step(pose=pose, last=out, wrench=wrench, axis=(0, 0, -1), force=15, **springs)
        q0 = follow.step(pose=made.pose).q0
        out = controller.step(q0=q0, shaped=True, wrench_command=made.wrench_command, **sample, **springs)

    Parameters
    ----------
    controller : Impedance or its config
        Controller whose damping tunes the integral, and whose heaviest_wrench bounds it.
    **fields
        Fields of the configuration (NAME_press.h): approach_speed [m/s], offset_limit [m],
        disagreement_limit [N].

    Raises
    ------
    TypeError
        A field does not exist.
    ValueError
        A value is refused.

    """

    def __init__(self, controller: Any, **fields: ArrayLike) -> None:
        """Set the configuration, and take the controller's, whose springs the force is put through."""
        unknown = sorted(set(fields) - set(_FIELDS))
        if unknown:
            raise TypeError(f"no configuration field '{unknown[0]}'; there are: {', '.join(_FIELDS)}")
        self._config = np.zeros(1, _CONFIG)
        _c.press_default(self._config)
        for name, value in fields.items():
            self._config[name] = of_shape(name, value, ())
        self._controller = np.array(getattr(controller, "config", controller)._values)
        self._state = np.zeros((_c.SIZES["press_state"] + 7) // 8)
        self.restart()

    def restart(self) -> None:
        """Begin anew without a force, at the commanded pose."""
        code = _c.press_init(self._config, self._controller, self._state)
        if code:
            raise ValueError(_c.press_error_text(code))
        self._last = np.zeros(1, _OUTPUT)

    @property
    def error(self) -> float:
        """Force less the measured one along the axis in the last step [N]."""
        return float(self._last["error"][0])

    @property
    def gain(self) -> float:
        """Gain of the integral in the last step [1/s]."""
        return float(self._last["gain"][0])

    def step(
        self,
        *,
        pose: ArrayLike,
        last: Any,
        wrench: ArrayLike,
        axis: ArrayLike,
        force: float,
        translation_stiffness: ArrayLike,
        rotation_stiffness: ArrayLike,
        search: bool = False,
    ) -> PressOutput:
        """Do one step.

        ``pose`` (4, 4) is wanted of the tip, ``last`` the controller's last result, or None before the first.
        ``wrench`` (6) is that of the environment on the robot at the tip, in base axes (``sensor.tip_wrench``). The tip
        presses along ``axis`` (3), a unit vector in base axes, with ``force`` [N]; 0 ends it. With ``search`` it looks
        for contact again after a loss. The stiffnesses (3, 3) are those of the controller's step.

        ValueError for an input that is refused; the step was done without a wrench, at the last pose.
        """
        row, output = np.zeros(1, _INPUT), np.zeros(1, _OUTPUT)
        given = {
            "pose": pose,
            "wrench": wrench,
            "axis": axis,
            "force": force,
            "translation_stiffness": translation_stiffness,
            "rotation_stiffness": rotation_stiffness,
        }
        for name, value in given.items():
            row[name] = of_shape(name, value, _INPUT[name].shape, one=False)
        row["search"] = search
        before = None if last is None else np.ascontiguousarray(last._rows[-1:])
        code = _c.press_step(self._state, row, before, output)
        self._last = output
        if code:
            raise ValueError(_c.press_error_text(code))
        pose, wrench = (np.array(output[name][0]) for name in ("pose", "wrench_command"))
        return PressOutput(pose, wrench, PressStage(int(output["stage"][0])))
