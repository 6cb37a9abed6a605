# SPDX-License-Identifier: MIT
"""Oracles in motor coordinates."""

from __future__ import annotations

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.families.joints.kernels import JOINT_POTENTIALS, JointPotential
from stiffgen.families.joints.oracles import of_joint_potential
from stiffgen.families.loops.oracles import Projection, projected


def _of_joints(potential: JointPotential) -> dict[str, tuple[Oracle, ...]]:
    """Return the oracles of a joint potential's functions in motor coordinates."""

    def reduced(p: Projection) -> tuple[FloatArray, FloatArray]:
        of_tree = of_joint_potential(p.references, potential)
        return p.reduced(-of_tree["torque"], of_tree["joint_stiffness"])

    return {
        f"motors_{potential.name}_torque": projected(lambda p: -reduced(p)[0]),
        f"motors_{potential.name}_joint_stiffness": projected(lambda p: reduced(p)[1]),
    }


ORACLES = {name: oracle for potential in JOINT_POTENTIALS for name, oracle in _of_joints(potential).items()}
