# SPDX-License-Identifier: MIT
"""Compare a chain's expressions with Pinocchio at one configuration, without printing or compiling anything."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.program import evaluate
from stiffgen.core.verify.kernels.poses import gamma_F
from support.pinocchio_oracle import PinocchioChain

BOUND = 1e-9


def value(chain: Chain, kernel: Kernel, **arguments: np.ndarray) -> np.ndarray:
    """Evaluate the kernel's expressions on constants: CasADi folds them while they are built."""
    constants = {a.name: ca.SX(ca.DM(arguments[a.name])) for a in kernel.arguments}
    entries = evaluate(kernel.scope(chain), kernel.steps(chain), constants)[kernel.result.name]
    return np.array([float(entry) for entry in entries]).reshape(kernel.result.array(chain).shape)


def disagreements(
    chain: Chain, oracle: PinocchioChain, random: np.random.Generator, most: int = 99
) -> dict[str, float]:
    """Return the relative errors beyond ``BOUND`` by kernel, at one random q, wrench and task stiffness.

    Beyond ``most`` coordinates kernels over all pairs of joints are omitted (their time grows with the square).
    """
    assert [c.name for c in chain.coordinates] == oracle.coordinates
    q = random.uniform(-3, 3, chain.dof)
    wrench, stiffness = random.normal(size=6) * 20, random.normal(size=(6, 6)) * 100
    stiffness = stiffness + stiffness.T
    velocity, gravity = random.normal(size=chain.dof), random.normal(size=3) * 6
    state = oracle.at(q)
    wanted = {"forward_kinematics": state.pose, "mass_matrix": state.mass_matrix}
    wanted |= oracle.forces(q, velocity, gravity)
    for rep in REPRESENTATIONS:
        wanted[f"{rep}_jacobian"] = state.jacobian[rep]
        if chain.dof <= most:
            corrected = stiffness + gamma_F(rep, wrench)
            wanted[f"{rep}_jacobian_transpose_derivative"] = state.derivative[rep].transpose(0, 2, 1)
            wanted[f"{rep}_joint_stiffness"] = state.joint_stiffness(rep, wrench, corrected)
    errors = {}
    for kernel in chain_kernels(chain):
        if kernel.qualified_name in wanted:
            reference = wanted[kernel.qualified_name]
            given = {"q": q, "wrench": wrench, "task_stiffness": stiffness, "velocity": velocity, "gravity": gravity}
            got = value(chain, kernel, **given)
            error = float(np.abs(got - reference).max() / max(1.0, np.abs(reference).max()))
            if not error <= BOUND:
                errors[kernel.qualified_name] = error
    return errors
