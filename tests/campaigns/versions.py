# SPDX-License-Identifier: MIT
"""Compare robots made with the oldest and the newest packages allowed: ``make campaign NAME=versions``.

Of casadi, sympy, mpmath and Jinja2 each bound of pyproject.toml's range is installed into a folder, the iiwa 14 is
generated and compiled with it, and every function is called at random states. Exit code 1 if a value differs from those
of this environment by more than 1e-12 of the function's largest, or if the package index refuses a version.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.emit.manifest import SHAPING
from support.project import ROOT

EVALUATE = """
import sys
import numpy as np
import stiffgen
from stiffgen.core.verify.kernels.samples import argument_samples
folder = stiffgen.generate({urdf!r}, output=sys.argv[1], controller=False)
robot = stiffgen.open_robot(folder)
pool = argument_samples(robot.chain, {states}, 1, robot.springs)
values = {{}}
for kernel in robot.table:
    found = robot.kernels[kernel.qualified_name](*(pool[argument] for argument in kernel.arguments))
    for k, value in enumerate(found if isinstance(found, tuple) else (found,)):
        values[f"{{kernel.qualified_name}} {{k}}"] = value
np.savez(sys.argv[2], **values)
print(robot.manifest["versions"])
"""


def ranges() -> dict[str, tuple[str, str]]:
    """Return the lower bound and the bound above of each package."""
    project = (ROOT / "pyproject.toml").read_text()
    found = {name: re.search(rf'^    "{name}>=([\d.]+),<([\d.]+)"', project, re.MULTILINE) for name in SHAPING}
    assert all(found.values()), "a package without a range"
    return {name: (match[1], match[2]) for name, match in found.items() if match}


def values_with(requirements: list[str], folder: Path, states: int) -> dict[str, Any]:
    """Return the values of every function of a robot that was generated with these packages; none: with those here."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = dict(os.environ)
    if requirements:
        packages = folder / "packages"
        install = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--upgrade",
            "--target",
            str(packages),
        ]
        subprocess.run([*install, *requirements], check=True)
        environment["PYTHONPATH"] = os.pathsep.join([str(packages), environment.get("PYTHONPATH", "")])
    code = EVALUATE.format(urdf=str(ROOT / "urdf" / "iiwa14.urdf"), states=states)
    command = [sys.executable, "-c", code, str(folder / "robots"), str(folder / "values.npz")]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    print(f"{folder.name}: {done.stdout.strip()}", flush=True)
    with np.load(folder / "values.npz") as content:
        return dict(content)


def main() -> int:
    """Compare values computed with the oldest and newest packages; return 1 if they differ by more than 1e-12."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--states", type=int, default=1000)
    options = parser.parse_args()
    place, bounds = ROOT / "build" / "versions", ranges()
    expected = values_with([], place / "here", options.states)
    worst = 0.0
    for name, chosen in {
        "oldest": [f"{package}=={lowest}" for package, (lowest, _) in bounds.items()],
        "newest": [f"{package}<{above}" for package, (_, above) in bounds.items()],
    }.items():
        found = values_with(chosen, place / name, options.states)
        assert found.keys() == expected.keys()
        errors = {
            key: float(np.abs(found[key] - value).max() / max(np.abs(value).max(), 1e-300))
            for key, value in expected.items()
        }
        largest = max(errors, key=lambda key: errors[key])
        count = sum(value.size for value in found.values())
        print(f"{name}: {count} values, largest difference {errors[largest]:.1e} ({largest})")
        worst = max(worst, errors[largest])
    return int(not worst <= 1e-12)


if __name__ == "__main__":
    sys.exit(main())
