# SPDX-License-Identifier: MIT
"""Oracles in motor coordinates."""

from __future__ import annotations

from functools import partial

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.kernels.references import load_stiffness
from stiffgen.core.verify.kernels.samples import symmetric
from stiffgen.families.compliance import reference as compliance
from stiffgen.families.compliance.kernels import increment, joint_stiffness
from stiffgen.families.loops.oracles import Projection, of_wrench, projected

_KTH = joint_stiffness("a")


def _of_compliance(p: Projection, name: str) -> FloatArray:
    _, load = p.reduced(of_wrench(p), load_stiffness(p.references, "hybrid"))
    H = symmetric(p.samples[_KTH]) - load
    J = p.references.jacobian["hybrid"].astype(float) @ p.motion
    return compliance.results(H, J, p.samples[increment("hybrid")])[name]()


ORACLES = {f"motors_{name}": projected(partial(_of_compliance, name=name)) for name in compliance.NAMES}
