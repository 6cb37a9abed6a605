# SPDX-License-Identifier: MIT
"""Convert the golden file's samples to calls of kernels with expected results."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from stiffgen.core.symbolic.kernels import KERNELS, Kernel
from support.project import ROOT


def golden_calls(samples: int) -> list[tuple[Kernel, list[np.ndarray], np.ndarray]]:
    """Return (kernel, arguments, expected result) for the iiwa 14's pose and all stiffnesses."""
    data = json.loads((ROOT / "tests" / "data" / "golden_iiwa14.json").read_text())["samples"]
    kernels = {kernel.qualified_name: kernel for kernel in KERNELS}
    calls: list[tuple[Kernel, list[np.ndarray], np.ndarray]] = []

    def add(name: str, given: list[Any], expected: Any) -> None:
        calls.append((kernels[name], [np.array(each) for each in given], np.array(expected)))

    for sample in data[:samples]:
        q, wrench, task_stiffness = (sample[key] for key in ("q", "wrench", "task_stiffness"))
        add("forward_kinematics", [q], sample["pose"])
        for group in ("body", "spatial", "hybrid"):
            own = sample[group]
            add(f"{group}_jacobian", [q], own["jacobian"])
            add(f"{group}_kinematic_stiffness", [q, wrench], own["kinematic_stiffness"])
            add(f"{group}_joint_stiffness", [q, wrench, task_stiffness], own["joint_stiffness"])
    return calls
