# SPDX-License-Identifier: MIT
"""Trees under loads whose springs are scaled to the limit of stability, as near as one likes, by verify's oracles."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_kernels
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.kernels.samples import Samples, symmetric
from stiffgen.core.verify.result import Check
from stiffgen.families.compliance.reference import KTH, load

FAMILY = KernelOptions(kernels=("compliance",))
Array = np.ndarray[Any, Any]
REFUSING = "tip_compliance", "tip_stiffness", "deflection"


class Case:
    """A tree under loads in one representation: kernels, the springs that were drawn, and the loads' stiffness."""

    def __init__(self, chain: Chain, rep: str, *, total: bool, seed: int) -> None:
        """Draw the case: loads at all tips (``total``) or at the first one."""
        kernels = [each for each in chain_kernels(chain, FAMILY) if each.on_request and each.group == rep]
        tip = None if total or len(chain.tips) == 1 else chain.tips[0]
        self.kernels = [each for each in kernels if each.tip == tip]
        self.functions = {each.qualified_name: function_of_stacks(chain, each) for each in self.kernels}
        self.chain, self.seed = chain, seed
        self.drawn = References(chain, 1, seed, FAMILY)
        loads = [load(each, rep)[0].astype(float) for each in self.drawn.tips[: None if total else 1]]  # type: ignore[arg-type]
        self.load, self.springs = sum(loads), symmetric(self.drawn.samples[KTH])[0]

    def near_the_limit(self, distance: float) -> Array:
        """Return springs ``1 + distance`` times as stiff as those that lose stability, or unchanged without such."""
        roots = np.linalg.cholesky(np.linalg.inv(self.springs))
        scale = float(np.linalg.eigvalsh(roots.T @ self.load @ roots)[-1])
        return np.asarray(self.springs * (scale * (1 + distance) if scale > 0 else 1.0))

    def eigenvalues(self, springs: Array) -> Array:
        """Return the eigenvalues of the loaded Hessian, the smallest first."""
        return np.asarray(np.linalg.eigvalsh(springs - self.load))

    def references(self, springs: Array) -> References:
        """Return the references under other springs, with the Jacobians that were differentiated for the first ones."""
        samples = Samples(self.chain, 1, self.seed, {KTH: springs[None]})
        references = References(self.chain, 1, self.seed, FAMILY, samples)
        for own, drawn in zip(references.tips, self.drawn.tips, strict=True):
            own.pose, own.jacobian, own.derivative = drawn.pose, drawn.jacobian, drawn.derivative
        return references

    def checks(self, springs: Array) -> list[Check]:
        """Compare all kernels with their oracles; of an unstable posture, those that do not refuse it."""
        stable = self.eigenvalues(springs)[0] > 0
        kernels = [each for each in self.kernels if stable or each.name.removesuffix("_total") not in REFUSING]
        return check_kernels(self.functions, self.references(springs), kernels)

    def refusals(self, springs: Array) -> dict[str, bool]:
        """Return whether each kernel that can refuse a posture does: all of its results are NaN, or none is."""
        samples = self.references(springs).samples
        found = {}
        for kernel in self.kernels:
            name = kernel.name.removesuffix("_total")
            if name in REFUSING:
                missing = np.isnan(self.functions[kernel.qualified_name](*samples.of(kernel.arguments)))
                assert missing.all() == missing.any(), name
                found[name] = bool(missing.all())
        return found
