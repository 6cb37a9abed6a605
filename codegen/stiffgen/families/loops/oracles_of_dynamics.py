# SPDX-License-Identifier: MIT
"""Oracles in motor coordinates."""

from __future__ import annotations

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import VELOCITY, Q
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.families.dynamics.oracles import dynamics
from stiffgen.families.loops.kernels import MOTOR_VELOCITY
from stiffgen.families.loops.oracles import Projection, projected


def bias_forces(p: Projection) -> FloatArray:
    """Return G^T (M dG/dt da + h) from mass matrix and bias forces of the tree at the motors' rates."""
    rates, accelerations = p.rates(p.samples[MOTOR_VELOCITY])
    of_tree, samples = p.references, p.samples
    moving = Samples(p.chain, samples.count, samples.seed, {Q: p.q, VELOCITY: rates})
    bias = References(p.chain, samples.count, samples.seed, samples=moving).of(dynamics)["bias_forces"][..., 0]
    forces = np.einsum("sij,sj->si", of_tree.of(dynamics)["mass_matrix"], accelerations) + bias
    return np.asarray(np.einsum("sij,si->sj", p.motion, forces))


def _of_gravity(p: Projection) -> tuple[FloatArray, FloatArray]:
    of_tree = p.references.of(dynamics)
    return p.reduced(of_tree["gravity_gradient"], of_tree["gravity_joint_stiffness"])


ORACLES = {
    "motors_mass_matrix": projected(
        lambda p: np.swapaxes(p.motion, 1, 2) @ p.references.of(dynamics)["mass_matrix"] @ p.motion
    ),
    "motors_bias_forces": projected(bias_forces),
    "motors_gravity_gradient": projected(lambda p: _of_gravity(p)[0]),
    "motors_gravity_joint_stiffness": projected(lambda p: _of_gravity(p)[1]),
}
