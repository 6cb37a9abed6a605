# SPDX-License-Identifier: MIT
"""Run every CUDA launch function of several robots against the C code: ``python tests/campaigns/cuda.py``.

Every launch function of the kernel table is called with random arguments in columns, with strides beyond the count,
with each matrix shared and not, with NaN and infinity in every fifth row, and with joints many turns away. Values must
be those of the single calls to 1e-12 of the largest entry (floats: 1e-4), or to ten times what a change of the
arguments' last digits makes. Entries that depend on something not finite must be NaN, nothing may be written outside
the result, and short strides must be refused. The robots are arms, trees, a floating base, a closed loop, and chains of
12 and 24 joints, with all springs, derivatives and functions on request. Needs nvcc and a GPU; ``--host`` compiles the
same files for the host. Exit code 1 if a value is wrong.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca

import stiffgen
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.choices import KINDS, Potential
from support.chains import chain_urdf
from support.cuda_device import DeviceCheck
from support.project import ROOT, URDF
from support.small_robots import five_bar

BEYOND_THE_GRID = 65536 * 128 + 129
"""More configurations than a grid has threads: some threads compute several."""


@dataclass(frozen=True)
class Robot:
    """A robot's file, or its text, the options of its chain, and those of generation."""

    urdf: Path | Callable[[], str]
    chain: dict[str, Any] = field(default_factory=dict)
    generation: dict[str, Any] = field(default_factory=dict)

    def check(self, name: str, folder: Path, rows: int) -> DeviceCheck:
        """Print the program that checks the CUDA kernels of a robot on a device."""
        folder.mkdir(parents=True, exist_ok=True)
        file = self.urdf if isinstance(self.urdf, Path) else folder / f"{name}.urdf"
        if not isinstance(self.urdf, Path):
            file.write_text(self.urdf())
        chain = stiffgen.load_chain(file, **self.chain)
        options = GenerationOptions(cuda=True, controller=False, python=False, **self.generation)
        return DeviceCheck(chain, name, options, folder, rows)


def bowl(p: Any, R: Any, parameters: Any) -> Any:
    """Return the energy of a user's potential with a number, a vector and a matrix."""
    away = p - parameters.centre
    along = ca.mtimes(parameters.weights, away) + R[:, 2] / 10
    return parameters.stiffness * ca.dot(along, along) ** 2 / 4


bowl.parameters = {"centre": (3,), "stiffness": (), "weights": (3, 3)}  # type: ignore[attr-defined]

_EVERYTHING = {"derivatives": True, "kernels": "all,compliance,tangents", "springs": KINDS}
_LOOP = five_bar()
_BOWL = {"potentials": (Potential(bowl),)}
ROBOTS = {
    "iiwa14": Robot(URDF, {}, _EVERYTHING),
    "floats": Robot(URDF, {}, {"scalar": "float"}),
    "slides": Robot(lambda: chain_urdf("rprm"), {"floating_base": True}, {"derivatives": True, **_BOWL}),
    "dual_arm": Robot(
        ROOT / "tests" / "data" / "dual_arm.urdf",
        {
            "tip": ["left hand", "right-hand"],
            "runtime_tool": True,
            "sensor": stiffgen.Sensor("right-hand", sign="robot"),
        },
        {"kernels": "all,compliance"},
    ),
    "linkage": Robot(lambda: _LOOP.urdf, _LOOP.all_options(), {"derivatives": True, "kernels": "all,compliance"}),
    "solo12": Robot(
        ROOT / "tests" / "data" / "solo12.urdf",
        {"tip": [f"{foot}_FOOT" for foot in ("FL", "HR")], "floating_base": True},
    ),
    "twelve": Robot(lambda: chain_urdf("r" * 12), {}, {"derivatives": True}),
    "twenty_four": Robot(lambda: chain_urdf("r" * 24)),
}


def main() -> int:
    """Compile and run the CUDA checks of the chosen robots; return 1 if one is wrong, 2 if one does not compile."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="*", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--rows", type=int, default=300, help="random configurations per launch")
    parser.add_argument("--host", action="store_true", help="compile for the host, by g++: needs no GPU")
    parser.add_argument("--options", default="-arch=native", help="of nvcc")
    parser.add_argument("--folder", type=Path, help="keep sources and programs there")
    parser.add_argument("--compile-only", action="store_true", help="run nothing: for another machine with a GPU")
    options = parser.parse_args()
    compiler, flags = ["nvcc", "-O3"], shlex.split(options.options)
    if options.host:
        compiler, flags = ["g++", "-std=c++17", "-O1"], []
    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        for name in options.robots:
            check = ROBOTS[name].check(name, (options.folder or Path(place)) / name, options.rows)
            try:
                program = check.compile(compiler, flags)
            except (FileNotFoundError, subprocess.CalledProcessError) as error:
                print(f"{name} is not compiled: {error}", file=sys.stderr)
                return 2
            if options.compile_only:
                print(f"{name}: {len(check.launches)} launch functions")
                continue
            done = check.run(program, *(() if options.host else (BEYOND_THE_GRID,)))
            print(done.stdout, done.stderr, sep="", end="", flush=True)
            wrong += done.returncode != 0
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
