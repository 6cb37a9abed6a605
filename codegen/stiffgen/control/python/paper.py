"""Joint impedance of Lachner, Nah and Hogan (2025): NAME_paper.h for NumPy arrays."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter, signature
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import layout, of_shape

_CONFIG, _STATE, _INPUT, _OUTPUT = map(layout, ("paper_config", "paper_state", "paper_input", "paper_output"))
_INPUTS, _OUTPUTS = _INPUT.names or (), _OUTPUT.names or ()
_FIELDS = (_CONFIG.names or ())[1:]  # the first one is conventional: the formula
_ERRORS = {
    -2: "configuration: every number must be finite and within the bounds of NAME_paper.h (sample_time from 1e-6 on, "
    "the others from 0 on); a robot without effort limits in its file needs effort_limit and torque_rate_limit",
    -3: "a number of the sample, or the torque, is not finite or absurdly large",
    -4: "task_stiffness: must be symmetric and positive semidefinite; for a measured one take "
    "stiffgen.measured_stiffness(Km, wrench, representation)",
    -5: "the mass matrix is not positive definite; pass motor_inertia",
}


class PaperOutput(NamedTuple):
    """Result of a step: torques (n), Kq with posture_stiffness and B (n, n), and whether a limit cut the torque."""

    torque: NDArray[np.float64]
    elastic_torque: NDArray[np.float64]
    damping_torque: NDArray[np.float64]
    joint_stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]
    saturated: bool
    rate_limited: bool


class PaperLaw:
    """Law tau = Kq(q, F) (q0 - q) - B dq, with B from Kq and the mass matrix, and limits of torque and its rate.

    To reproduce the paper. The law is no spring and can push away under load; :class:`Impedance` has a spring.

    Parameters
    ----------
    formula : str
        "corrected" (symmetric Kq) or "conventional" (without the connection's correction).
    torque : (n) [N m], optional
        Torque in force at the start, within effort_limit; default: zero.
    **fields
        Fields of the configuration (NAME_paper.h): sample_time, damping_ratio, joint_damping, posture_stiffness;
        motor_inertia, effort_limit and torque_rate_limit take (n) or one number.

    Raises
    ------
    TypeError
        A field does not exist.
    ValueError
        A value is refused.

    """

    def __init__(self, formula: str = "corrected", *, torque: ArrayLike = 0.0, **fields: ArrayLike) -> None:
        """Set formula and configuration, and start with `torque` [N m] in force, which must be within effort_limit."""
        if formula not in ("corrected", "conventional"):
            raise ValueError(f"formula: no value '{formula}'; it takes corrected, conventional")
        unknown = sorted(set(fields) - set(_FIELDS))
        if unknown:
            raise TypeError(f"no configuration field '{unknown[0]}'; there are: formula, {', '.join(_FIELDS)}")
        self._config = np.zeros(1, _CONFIG)
        _c.paper_default(self._config)
        self._config["conventional"] = formula == "conventional"
        for name, value in fields.items():
            self._config[name] = of_shape(name, value, _CONFIG[name].shape)
        self._state = np.zeros(1, _STATE)
        self._state["torque"] = of_shape("torque", torque, (_c.MOTORS,))
        if _c.paper_validate(self._config):
            raise ValueError(_ERRORS[-2])
        if not np.all(np.abs(self._state["torque"]) <= self._config["effort_limit"]):
            raise ValueError("torque: must be finite and within effort_limit")

    @property
    def torque(self) -> NDArray[np.float64]:
        """Torque (n) of the last step; after a refused sample it goes to zero at its rate limit."""
        return np.array(self._state["torque"][0])

    def step(
        self,
        *,
        q: ArrayLike,
        dq: ArrayLike,
        q0: ArrayLike,
        tool_pose: ArrayLike | None = None,
        wrench: ArrayLike,
        task_stiffness: ArrayLike,
    ) -> PaperOutput:
        """Do one step.

        ``q``, ``dq`` and the zero-force positions ``q0`` have (n) entries. ``wrench`` (6) is what the environment
        applies to the robot at the tip, ``task_stiffness`` is (6, 6); both have hybrid axes. ``tool_pose`` (4, 4) is
        the tool's, of robots that take it at run time alone. ValueError for a refused sample.
        """
        given: dict[str, Any] = {
            name: value
            for name, value in locals().items()
            if name != "self" and (name != "tool_pose" or value is not None)
        }
        _check_inputs(self.step, given)
        sample, output = np.zeros(1, _INPUT), np.zeros(1, _OUTPUT)
        for name, value in given.items():
            sample[name] = of_shape(name, value, _INPUT[name].shape, one=False)
        code = _c.paper_step(self._config, self._state, sample, output)
        if code:
            raise ValueError(_ERRORS[code])
        values = {name: output[name][0] for name in _OUTPUTS}
        cut = {name: bool(values[name]) for name in ("saturated", "rate_limited")}
        return PaperOutput(**{**values, **cut})


def _tell_tool(step: Any) -> None:
    """Set a step's signature: ``tool_pose`` is required where it is among the inputs, and unknown elsewhere."""
    told = signature(step)
    parameters = dict(told.parameters)
    if "tool_pose" in _INPUTS:
        parameters["tool_pose"] = parameters["tool_pose"].replace(default=Parameter.empty, annotation="ArrayLike")
    else:
        del parameters["tool_pose"]
    step.__signature__ = told.replace(parameters=list(parameters.values()))


def _check_inputs(step: Any, values: Mapping[str, Any]) -> None:
    """Raise TypeError where a step has a ``tool_pose`` that is none of its inputs, or lacks what it needs."""
    if "tool_pose" in values and "tool_pose" not in _INPUTS:
        raise TypeError(f"{step.__qualname__}() got an unexpected keyword argument 'tool_pose'")
    missing = [name for name in _INPUTS if name not in values]
    if missing:
        raise TypeError(f"a step needs {', '.join(missing)}")


_tell_tool(PaperLaw.step)
