# SPDX-License-Identifier: MIT
"""Oracles of the joint potentials."""

from __future__ import annotations

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.references import References
from stiffgen.families.joints.kernels import JOINT_POTENTIALS, JointPotential
from stiffgen.families.joints.reference import by_hand


def of_joint_potential(r: References, potential: JointPotential) -> dict[str, FloatArray]:
    """Return the results of a joint potential's kernels; entries of a floating base are zero."""
    base_joints = r.chain.base_joints
    by_joints = by_hand(potential.name, *r.samples.of((Q, *potential.parameters)))
    return {name: np.pad(each, [(0, 0), *(each.ndim - 1) * [(base_joints, 0)]]) for name, each in by_joints.items()}


def _by_hand(potential: JointPotential, result: str) -> tuple[Oracle, ...]:
    return (Oracle("derivatives by hand", lambda r: of_joint_potential(r, potential)[result], rounded=""),)


ORACLES = {
    f"{potential.name}_{result}": _by_hand(potential, result)
    for potential in JOINT_POTENTIALS
    for result in ("energy", "torque", "joint_stiffness")
}
