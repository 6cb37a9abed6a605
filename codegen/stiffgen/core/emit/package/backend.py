# SPDX-License-Identifier: MIT
"""Describe CMakeLists.txt and README.md of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.python.backend import packed_functions

_IDENTITY = tuple(float(k % 5 == 0) for k in range(16))
_WRENCH = "np.array([0, 0, -10, 0, 0, 0])"
_TASK_STIFFNESS = "np.diag([800, 800, 800, 50, 50, 50])"


def _example(request: Request) -> dict[str, Any]:
    """Return the functions that the README calls, and C values and Python text of their arguments."""
    chain = request.chain
    several = len(chain.tips) > 1
    names = {page.qualified_name for page in request.kernels}
    path = [chain.tips[0].name] if several else []
    has_jacobian = "_".join((*path, "hybrid", "jacobian")) in names
    path += ["hybrid", "jacobian"] if has_jacobian else ["forward_kinematics"]
    poses = ("base_pose", chain.floating), ("tool_pose", chain.runtime_tool)
    example = {
        "q": (0.1, 0.2, 0.3)[: len(chain.coordinates)],
        "path": path,
        "result": path[-1],
        "size": 6 * chain.dof if has_jacobian else 16,
        "poses": [(pose, _IDENTITY) for pose, is_argument in poses if is_argument],
    }
    return example | _python_example(request, names, path)


def _python_example(request: Request, names: set[str], path: list[str]) -> dict[str, Any]:
    """Return call and arguments of the README's example: a joint stiffness where there is one."""
    chain = request.chain
    several = len(chain.tips) > 1
    stiffness = "hybrid.joint_stiffness_total" if several else "hybrid.joint_stiffness"
    values = {"tool_pose": "np.eye(4)", "wrench": _WRENCH, "task_stiffness": _TASK_STIFFNESS}
    if stiffness.replace(".", "_") not in names:
        stiffness, values = ".".join(path), {"tool_pose": "np.eye(4)"}
    elif several:
        plural = {"tool_pose": "tool_poses", "wrench": "wrenches", "task_stiffness": "task_stiffnesses"}
        values = {plural[key]: f"np.stack({len(chain.tips)} * [{value}])" for key, value in values.items()}
    arguments = list(values.items())[0 if chain.runtime_tool else 1 :]
    return {"call": stiffness, "arguments": [*([("base_pose", "np.eye(4)")] if chain.floating else []), *arguments]}


def _variables(request: Request) -> dict[str, Any]:
    return {
        "example": _example(request),
        "group_names": {page.group for page in request.kernels},
        "pair_names": list(dict.fromkeys(page.group for page in request.kernels if page.kernel.span)),
        "wrappers": request.has_wrappers,
    } | packed_functions(request)


def _files(request: Request) -> dict[str, str]:
    return {"CMakeLists.txt": "CMakeLists.txt.j2", "README.md": "README.md.j2"}


BACKEND = Backend(Path(__file__).parent, _files, _variables)
