"""Policy: a port for slow commanders, such as learned policies. NAME_policy.h for NumPy arrays."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c
from ._structs import WORDS, enumeration, layout, of_shape

_CONFIG, _PROPOSAL, _OUTPUT, _STATE = (layout(f"policy_{name}") for name in ("config", "proposal", "output", "state"))
_SETTINGS = _CONFIG.names or ()
_PARTS = tuple(WORDS["policy_part"])

PolicyRefused = enumeration(IntEnum, "PolicyRefused", WORDS["policy_refused"])
"""Why a part of a proposal is refused."""
PolicyStage = enumeration(IntEnum, "PolicyStage", WORDS["policy_stage"])
"""Stage of a part: WAITING, MOVING, HOLDING, FADING, FADED."""


class PolicyCommand(NamedTuple):
    """Command of a time: the pose is for Follow, stiffness and wrench are for the step of Impedance.

    ``pose`` (4, 4) [m], ``translation_stiffness`` (3, 3) [N/m], ``rotation_stiffness`` (3, 3) [N m/rad],
    ``wrench_command`` (6) [N, N m] that the tip is to exert, ``gripper``; with several tips these are the first axis.
    """

    pose: NDArray[np.float64]
    translation_stiffness: NDArray[np.float64]
    rotation_stiffness: NDArray[np.float64]
    wrench_command: NDArray[np.float64]
    gripper: float


class Policy:
    """Port for a slow commander, 10 to 60 Hz, such as a learned policy: checks, interpolates, holds and fades.

    It measures nothing and commands nothing::

        port = robot.Policy(pose=pose, now=0.0)
        port.propose(now=now, time=stamp, pose=wanted, translation_stiffness=Kt, rotation_stiffness=Ko)
        command = port.command(now)  # at every step
        q0 = follow.step(pose=command.pose).q0

    Parameters
    ----------
    pose : (4, 4) [m]
        Pose of the tip at the start (with several tips, the tips are the first axis); the stiffness starts at 0.
    now : float [s]
        Time at the start.
    **settings
        Fields of the configuration (NAME_policy.h): hold_time, fade_time, longest_interval and clock_tolerance [s],
        stale_share, reach [m], translation_stiffness_limit [N/m], rotation_stiffness_limit [N m/rad], heaviest_wrench
        (2) [N, N m].

    Raises
    ------
    TypeError
        A setting does not exist.
    ValueError
        A value or the pose is refused.

    """

    def __init__(self, *, pose: ArrayLike, now: float, **settings: ArrayLike) -> None:
        """Set the settings and start at the pose (4, 4) at the time `now` [s]."""
        unknown = sorted(set(settings) - set(_SETTINGS))
        if unknown:
            raise TypeError(f"no setting '{unknown[0]}'; there are: {', '.join(_SETTINGS)}")
        self._state, config = np.zeros(1, _STATE), np.zeros(1, _CONFIG)
        _c.policy_default(config)
        for name, value in settings.items():
            config[name] = of_shape(name, value, _CONFIG[name].shape)
        code = _c.policy_start(self._state, config, of_shape("pose", pose, _OUTPUT["pose"].shape, one=False), now)
        if code:
            raise ValueError(_c.policy_error_text(code))

    def propose(
        self,
        *,
        now: float,
        time: ArrayLike,
        pose: ArrayLike | None = None,
        translation_stiffness: ArrayLike | None = None,
        rotation_stiffness: ArrayLike | None = None,
        wrench_command: ArrayLike | None = None,
        gripper: float | None = None,
    ) -> dict[str, Any]:
        """Hand over a proposal when it arrives; return the parts that are refused, and why (:data:`PolicyRefused`).

        ``time`` [s] is the stamp of all parts, or one of each (pose, stiffness, wrench, gripper), on the clock of
        ``now``. What is None is not proposed; the stiffnesses are one part. Shapes are those of a command.
        """
        if (translation_stiffness is None) != (rotation_stiffness is None):
            raise TypeError("translation_stiffness and rotation_stiffness are one part: give both")
        row = np.zeros(1, _PROPOSAL)
        parts: tuple[dict[str, Any], ...] = (
            {"pose": pose},
            {"translation_stiffness": translation_stiffness, "rotation_stiffness": rotation_stiffness},
            {"wrench_command": wrench_command},
            {"gripper": gripper},
        )
        for k, fields in enumerate(parts):
            for name, value in fields.items():
                if value is not None:
                    row[name], row["valid"][0, k] = of_shape(name, value, _PROPOSAL[name].shape, one=False), 1
        row["time"] = time
        _c.policy_propose(self._state, row, now)
        refused = zip(_PARTS, self._state["refused"][0].tolist(), strict=True)
        return {part: PolicyRefused(code) for part, code in refused if code}

    def command(self, now: float) -> PolicyCommand:
        """Return the command of a time [s]; a time that is not finite, or goes back, counts as the last one."""
        row = np.zeros(1, _OUTPUT)
        _c.policy_command(self._state, now, row)
        return PolicyCommand(*(row[name][0] for name in PolicyCommand._fields))

    @property
    def refusals(self) -> dict[str, str]:
        """Refused parts of the newest proposal in words, with the number that was seen and its limit."""
        row, found = self._state[0], {}
        for k, part in enumerate(_PARTS):
            if row["refused"][k]:
                seen, limit, entry = (row[f"refused_{name}"][k] for name in ("seen", "limit", "entry"))
                numbers = f" ({seen:.6g}, limit {limit:.6g})" if seen or limit else ""
                place = f", entry {entry}" if entry >= 0 else ""
                found[part] = _c.policy_refused_text(int(row["refused"][k])) + place + numbers
        return found

    @property
    def gripper(self) -> float:
        """Number of the newest accepted gripper part; 0 before the first."""
        return float(self.command(-np.inf).gripper)

    @property
    def stage(self) -> dict[str, Any]:
        """Stage of each part (:data:`PolicyStage`) at the time of the last call."""
        row = np.zeros(1, _OUTPUT)
        _c.policy_command(self._state, -np.inf, row)
        return {part: PolicyStage(k) for part, k in zip(_PARTS, row["stage"][0].tolist(), strict=True)}
