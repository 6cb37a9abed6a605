# SPDX-License-Identifier: MIT
"""Oracles in motor coordinates."""

from __future__ import annotations

from typing import Any

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.families.loops.oracles import Projection, projected
from stiffgen.families.springs.oracles import springs
from stiffgen.families.springs.springs import Spring

ORACLES: dict[str, Any] = {}


def loop_oracles(spring: Spring) -> dict[str, tuple[Oracle, ...]]:
    """Return the oracles of a spring's functions in motor coordinates."""

    def reduced(p: Projection) -> tuple[FloatArray, FloatArray]:
        of_tree = p.references.of(springs)[spring.name]
        return p.reduced(-of_tree["torque"], of_tree["joint_stiffness"])

    return {
        f"motors_{spring.name}_torque": projected(lambda p: -reduced(p)[0]),
        f"motors_{spring.name}_joint_stiffness": projected(lambda p: reduced(p)[1]),
    }


def of_options(options: KernelOptions | None) -> dict[str, tuple[Oracle, ...]]:
    """Return the oracles of the chosen springs."""
    chosen = (options or KernelOptions()).all_springs()
    return {name: oracle for spring in chosen for name, oracle in loop_oracles(spring).items()}
