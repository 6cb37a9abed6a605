# SPDX-License-Identifier: MIT
"""Springs of laws on which policies were trained, as fields and commands of the impedance controller.

A preset has the stiffness of a law at its goal. Laws whose stiffness is a gain times the inertia of each configuration
have no preset: no fixed spring is equal to them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stiffgen.core.errors import StiffgenError


class LawSpring(NamedTuple):
    """Spring with the stiffness of a law at its goal. J is the tip's Jacobian, e the error of its pose.

    Attributes:
        law: formula of the law's stiffness.
        source: repository and file of the numbers.
        translation_stiffness, rotation_stiffness: stiffness in every direction [N/m] and about every axis [N m/rad].
        posture_stiffness: stiffness of each joint, or one for all [N m/rad].
        damping_ratio: median of the law's own over the modes of a Franka arm with its rotors.
        limits: largest force [N] and moment [N m] of the spring at the tip; empty without.

    """

    law: str
    source: str
    translation_stiffness: float
    rotation_stiffness: float
    posture_stiffness: tuple[float, ...]
    damping_ratio: float
    limits: tuple[float, ...] = ()


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


def law_preset(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the spring of a law on which policies were trained: fields of the controller, and stiffnesses to command.

    ``fields, springs = law_preset("droid")``: pass the fields to ``robot.Impedance``, the springs to every ``step``. A
    goal q_d is commanded as ``q0``. The damping is the controller's own, of the preset's ratio.

    Args:
        name: "droid", "droid_400", "serl" (of a folder generated with ``--spring bounded``) or "crisp".

    Returns:
        Fields ``damping_ratio`` and, of "serl", ``spring_limit`` [N, N m]; ``translation_stiffness`` (3, 3) [N/m],
        ``rotation_stiffness`` (3, 3) [N m/rad] and ``posture_stiffness``, one number or 7 [N m/rad].

    Raises:
        StiffgenError: there is no preset of this name.

    """
    if name in WITHOUT:
        raise StiffgenError(
            f'preset "{name}": {WITHOUT[name]}; examples/laws.py of stiffgen has the spring at one goal'
        )
    if name not in PRESETS:
        raise StiffgenError(f'no preset "{name}"; there are: {", ".join(sorted(PRESETS))}')
    preset = PRESETS[name]
    fields: dict[str, Any] = {"damping_ratio": preset.damping_ratio}
    if preset.limits:
        fields["spring_limit"] = preset.limits
    posture = np.array(preset.posture_stiffness)
    return fields, {
        "translation_stiffness": preset.translation_stiffness * np.eye(3),
        "rotation_stiffness": preset.rotation_stiffness * np.eye(3),
        "posture_stiffness": posture if len(posture) > 1 else float(posture[0]),
    }
