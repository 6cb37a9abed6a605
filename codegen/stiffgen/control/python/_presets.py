"""Springs of laws on which policies were trained, as settings of this controller (:meth:`Impedance.preset`).

A preset has the stiffness of a law at its goal. Laws whose stiffness is a gain times the inertia of each configuration
have no preset: no fixed spring is equal to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _c
from ._structs import INPUT


class LawSpring(NamedTuple):
    """Energy with the stiffness of a law at its goal. J is the tip's Jacobian, e the error of its pose.

    Attributes
    ----------
    law : str
        Formula of the law's stiffness.
    source : str
        Repository and file of the numbers.
    translation_stiffness, rotation_stiffness : float
        Stiffness in every direction [N/m] and about every axis [N m/rad].
    posture_stiffness : tuple of float
        Stiffness of each joint, or one for all [N m/rad].
    damping_ratio : float
        Median of the law's own over the modes of a Franka arm with its rotors.
    limits : tuple of float, optional
        Largest force [N] and moment [N m] of the spring at the tip.

    """

    law: str
    source: str
    translation_stiffness: float
    rotation_stiffness: float
    posture_stiffness: tuple[float, ...]
    damping_ratio: float
    limits: tuple[float, float] | None = None


_HYBRID = "(J^T Kx J + Kq) (q_d - q)"
_FRANKA = (40.0, 30.0, 50.0, 25.0, 35.0, 25.0, 10.0)
PRESETS = {
    "droid": LawSpring(
        _HYBRID,
        "facebookresearch/fairo at 0a01a7f, which DROID pins: polymetis/conf/robot_client/franka_hardware.yaml",
        750.0,
        15.0,
        _FRANKA,
        0.5,
    ),
    "droid_400": LawSpring(
        _HYBRID,
        "droid-dataset/droid: config/panda and config/fr3/franka_hardware.yaml, which its installation copies over "
        "polymetis' own",
        400.0,
        15.0,
        _FRANKA,
        0.5,
    ),
    "serl": LawSpring(
        "J^T K clip(e) + (I - J^T J^T+) Kq (q_d - q), e with the vector part of a quaternion: half an angle",
        "rail-berkeley/serl_franka_controllers: cfg/compliance_param.cfg",
        2000.0,
        75.0,
        (20.0, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2),
        0.8,
        (20.0, 7.5),
    ),
    "crisp": LawSpring(
        "J^T K e + (I - J^+ J) k (q_d - q)",
        "utiasDSL/crisp_controllers: src/cartesian_controller.yaml",
        500.0,
        30.0,
        (1.0,),
        1.3,
    ),
}
"""Presets by name."""
_WEIGHTED = "its stiffness is a gain times the inertia of each configuration, which no fixed spring has"
WITHOUT = {"robosuite": _WEIGHTED, "isaac_lab": _WEIGHTED, "newton": _WEIGHTED}
"""Laws without a preset, and why."""


def settings(name: str, given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, NDArray[np.float64]]]:
    """Return a preset's configuration with the fields that are given, and the stiffnesses to command.

    Raises ValueError for a name without a preset, or a posture of another number of joints.
    """
    if name in WITHOUT:
        raise ValueError(f'preset "{name}": {WITHOUT[name]}; examples/laws.py of stiffgen has the spring at one goal')
    if name not in PRESETS:
        raise ValueError(f'no preset "{name}"; there are: {", ".join(sorted(PRESETS))}')
    preset = PRESETS[name]
    posture = preset.posture_stiffness
    if len(posture) not in (1, _c.MOTORS) and "posture_stiffness" not in given:
        raise ValueError(
            f'preset "{name}": its posture stiffness is that of {len(posture)} joints, and {_c.NAME} has {_c.MOTORS}; '
            f"pass posture_stiffness= with {_c.MOTORS} numbers [N m/rad]"
        )
    fields: dict[str, Any] = {"damping_ratio": preset.damping_ratio}
    if "posture_stiffness" not in given:
        fields["posture_stiffness"] = np.broadcast_to(posture, _c.MOTORS)
    if preset.limits:
        fields |= {"spring": "bounded", "spring_force_limit": preset.limits[0], "spring_moment_limit": preset.limits[1]}
    springs = {
        part: np.broadcast_to(getattr(preset, part) * np.eye(3), INPUT[part].shape).copy()
        for part in ("translation_stiffness", "rotation_stiffness")
    }
    return {**fields, **given}, springs
