# SPDX-License-Identifier: MIT
"""Run the playground's scripts under node, and draw random arguments for the page's kernels."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.lab.play.page import SCRIPTS, page_data
from stiffgen.lab.play.wasm import compile_wasm
from support.project import require_program

Array = NDArray[np.float64]


def require_wasm() -> None:
    """Skip where clang or lld is missing; fail on CI."""
    require_program("wasm-ld", "lld")
    require_program("clang", "clang")


class Scripts:
    """The page's modules with a robot's kernels, in node."""

    def __init__(self, robot: GeneratedRobot, folder: Path) -> None:
        """Compile the robot for WebAssembly and copy the page's scripts for Node."""
        require_wasm()
        self._node = require_program("node", "nodejs")
        self.robot, self._folder = robot, folder
        self.data = page_data(robot)
        functions = [*self.data["functions"], f"{robot.name}_self_check"]
        self._wasm = base64.b64encode(compile_wasm(robot.folder / f"{robot.name}.c", functions)).decode()
        for file in SCRIPTS:
            with as_file(files("stiffgen.lab.play") / "page" / file) as source:
                shutil.copyfile(source, folder / file)
        shutil.copyfile(Path(__file__).with_name("play.mjs"), folder / "play.mjs")
        (folder / "package.json").write_text('{"type": "module"}')

    def run(self, tasks: list[dict[str, Any]], tip: int = 0) -> list[Any]:
        """Return the results of the tasks of play.mjs."""
        request = {"data": self.data, "wasm": self._wasm, "tip": tip, "tasks": tasks}
        (self._folder / "request.json").write_text(json.dumps(request, default=np.ndarray.tolist))
        command = [self._node, "play.mjs", "request.json"]
        done = subprocess.run(command, cwd=self._folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        results: list[Any] = json.loads(done.stdout)
        return results


def random_value(argument: Argument, robot: GeneratedRobot, random: np.random.Generator) -> Array:
    """Draw a plausible argument of a kernel: rotations rotate, stiffnesses are symmetric and positive."""
    shape = argument.array(robot.chain).shape
    if argument.name == "q":
        return random.uniform(-3, 3, shape)
    if argument.name in ("base_pose", "tool_pose", "equilibrium"):
        pose = np.eye(4)
        turned, _ = np.linalg.qr(random.normal(size=(3, 3)))
        pose[:3, :3] = turned * np.linalg.det(turned)
        pose[:3, 3] = random.normal(size=3)
        return pose
    if len(shape) == 2:
        factor = random.normal(size=shape)
        return np.asarray(100 * factor @ factor.T + np.eye(shape[0]))
    return 20 * random.normal(size=shape)
