# SPDX-License-Identifier: MIT
"""Compliance of loaded trees with 60 digits: the load is the Hessian of an energy, a difference, in all cases.

The springs' stiffness is scaled to the load, so that the smallest eigenvalue of H is near zero as often as one likes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.samples import Samples
from support.exact_kernels import ExactRobot, cross, loaded, matrix, symmetric
from support.exact_tree import as_array, mp

FAMILY = KernelOptions(kernels=("compliance",))
Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class ExactLoad:
    """Stiffness of a load at some tips, their Jacobian, and the change of their wrenches."""

    stiffness: mpmath.matrix
    J: mpmath.matrix
    change: mpmath.matrix

    @staticmethod
    def of(robot: ExactRobot, rep: str, links: list[str], wrenches: Array, increments: Array) -> ExactLoad:
        """Return the load of a robot whose ``links`` carry wrenches, from the Hessian of its energy.

        The load is that of the tip, f . p + m . vee(N - N^T)/2 with N = R R0^T, whatever representation states it.
        """
        none, J, seen = mp.zeros(6), mp.zeros(6 * len(links), robot.size), "hybrid" if rep == "spatial" else rep
        energies = []
        for link, wrench in zip(links, wrenches, strict=True):
            pose, F = robot.pose(link), matrix(wrench)
            if rep == "spatial":
                F[3:, 0] = F[3:, 0] - cross(pose[1]) * F[:3, 0]
            energies.append(loaded(seen, pose, F, none))

        def energy(at: ExactRobot) -> mpmath.mpf:
            return sum((each(at.pose(link)) for link, each in zip(links, energies, strict=True)), mp.mpf(0))

        for k, link in enumerate(links):
            J[6 * k : 6 * k + 6, :] = robot.jacobian(rep, link)
        _, hessian = robot.derivatives(energy)
        return ExactLoad(mp.matrix(hessian.tolist()), J, matrix(np.ravel(increments)))

    def hessian(self, springs: Array) -> mpmath.matrix:
        """Return H under springs in the joints."""
        return symmetric(springs) - self.stiffness

    def eigenvalues(self, springs: Array) -> Array:
        """Return the eigenvalues of H, the smallest first."""
        return np.array([float(x) for x in mp.eigsy(self.hessian(springs), eigvals_only=True)])

    def results(self, springs: Array) -> dict[str, Array]:
        """Return the results of all kernels; a stiffness that is not finite is left out."""
        H = self.hessian(springs)
        turned = H**-1 * self.J.T
        compliance = self.J * turned
        found = {
            "loaded_hessian": H,
            "tip_compliance": compliance,
            "deflection": turned * self.change,
            "stability": mp.matrix([min(mp.eigsy(H, eigvals_only=True))]),
        }
        spread = mp.eigsy(compliance, eigvals_only=True)
        if min(abs(x) for x in spread) > mp.mpf(10) ** -10 * max(abs(x) for x in spread):
            found["tip_stiffness"] = compliance**-1
        return {name: as_array(value) for name, value in found.items()}


def critical_scale(springs: Array, load: Array) -> float:
    """Return the factor of the springs at which the smallest eigenvalue of H is zero; none if the load stiffens."""
    roots = np.linalg.cholesky(np.linalg.inv(springs))
    return float(np.linalg.eigvalsh(roots.T @ load @ roots)[-1])


class Case:
    """A tree under loads in one representation: its arguments, exact load, and kernels."""

    def __init__(self, text: str, chain: Chain, rep: str, *, total: bool, seed: int) -> None:
        """Draw the case: loads at all tips (``total``) or at the first one."""
        kernels = [each for each in chain_kernels(chain, FAMILY) if each.on_request and each.group == rep]
        tip = None if total or len(chain.tips) == 1 else chain.tips[0]
        self.kernels = [each for each in kernels if each.tip == tip]
        self.functions = {each.name: function_of_stacks(chain, each) for each in self.kernels}
        self.chain, self.samples = chain, Samples(chain, 1, seed)
        given = {each.name: self.samples[each][0] for kernel in self.kernels for each in kernel.arguments}
        robot = ExactRobot.of(text, chain, {"base_pose": np.eye(4), **given})
        links = [each.link for each in (chain.tips if total else chain.tips[:1])]
        names = ("wrenches", "increments") if total else ("wrench", "increment")
        none = np.zeros((len(links), 6))  # spatial has no deflection, and so no increments
        wrenches, increments = (np.reshape(given.get(name, none), (len(links), 6)) for name in names)
        self.load = ExactLoad.of(robot, rep, links, wrenches, increments)
        self.springs = given["joint_stiffness"]

    def near_the_limit(self, distance: float) -> Array:
        """Return springs ``1 + distance`` times as stiff as those that lose stability, or unchanged without such."""
        scale = critical_scale(self.springs, as_array(self.load.stiffness))
        return np.asarray(self.springs * (scale * (1 + distance) if scale > 0 else 1.0))

    def found(self, springs: Array) -> dict[str, Array]:
        """Return the kernels' results, without the suffix of sums in their names."""
        results = {}
        for kernel in self.kernels:
            given = (
                springs[None] if each.name == "joint_stiffness" else self.samples[each] for each in kernel.arguments
            )
            results[kernel.name.removesuffix("_total")] = self.functions[kernel.name](*given)[0]
        return results

    def errors(self, springs: Array) -> dict[str, float]:
        """Return the largest error of each result relative to its largest entry; infinite for a wrong refusal."""
        expected, eigenvalues = self.load.results(springs), self.load.eigenvalues(springs)
        errors = {}
        for name, value in self.found(springs).items():
            if eigenvalues[0] < 0 and name not in ("loaded_hessian", "stability"):
                errors[name] = 0.0 if np.isnan(value).all() else np.inf
            elif name in expected:
                reference = np.reshape(expected[name], np.shape(value))
                scale = np.abs(eigenvalues if name == "stability" else reference).max()
                error = float(np.abs(value - reference).max() / scale)
                errors[name] = np.inf if np.isnan(error) else error
        return errors
