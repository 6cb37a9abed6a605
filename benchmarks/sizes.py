# SPDX-License-Identifier: MIT
"""Object code of a folder with the pose and the hybrid joint stiffness of the iiwa 14, compiled with -Os.

Code, constants and tables in kB, per processor and type of numbers; without libm.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.tools import URDF, run

MINIMAL = ("--kernels", "hybrid.joint_stiffness", "--no-controller", "--no-batches", "--no-python", "--no-build")
PROCESSORS = {
    "x86-64": ("gcc",),
    "Cortex-A72": ("aarch64-linux-gnu-gcc", "-mcpu=cortex-a72"),
    "Cortex-M7": ("arm-none-eabi-gcc", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
}


def object_size(source: Path, compiler: tuple[str, ...]) -> int:
    """Return bytes of code, constants and tables."""
    compiled = source.with_suffix(".o")
    run([*compiler, "-std=c99", "-Os", "-c", str(source), "-o", str(compiled)])
    triple = compiler[0].removesuffix("gcc")
    return sum(int(number) for number in run([f"{triple}size", str(compiled)]).splitlines()[1].split()[:3])


def main() -> None:
    with tempfile.TemporaryDirectory() as work:
        for scalar in ("double", "float"):
            output = Path(work) / scalar
            command = [sys.executable, "-m", "stiffgen.cli", "generate", str(URDF), "--output", str(output)]
            subprocess.run([*command, "--scalar", scalar, *MINIMAL], check=True, capture_output=True)
            for processor, compiler in PROCESSORS.items():
                if shutil.which(compiler[0]):
                    size = object_size(output / "iiwa14" / "iiwa14.c", compiler)
                    print(f"{processor:11} {scalar:7} {size / 1000:5.1f} kB")


if __name__ == "__main__":
    main()
