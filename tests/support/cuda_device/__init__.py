# SPDX-License-Identifier: MIT
"""Print a program that runs every launch function of a robot's CUDA file against the single calls, and compile it."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from stiffgen.core.emit import build
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import bound_of
from support.cuda_host import has_stride

HERE = Path(__file__).parent
FAR = 1e5
"""Factor on the angles of some rows: past the range of the fast reductions of sine and cosine."""


class DeviceCheck:
    """Sources of the program for a robot in a folder: NAME's C and CUDA, ``launches.cu`` and ``samples.bin``."""

    def __init__(self, chain: Chain, name: str, options: GenerationOptions, folder: Path, rows: int = 300) -> None:
        """Write the robot's sources, samples and table of launch functions to the folder."""
        self.chain, self.name, self.folder = chain, name, folder
        self.number = np.float64 if options.scalar == "double" else np.float32
        self.kernels = [kernel for kernel in chain_kernels(chain, options) if kernel.batch]
        folder.mkdir(parents=True, exist_ok=True)
        texts = render(chain, name, options)
        for file in (f"{name}.h", f"{name}.c", f"{name}_lanes.h", f"{name}.cu", f"{name}_cuda.h"):
            (folder / file).write_text(texts[file])
        pool = argument_samples(chain, rows, 17, options)
        self.pool = list(dict.fromkeys(argument for kernel in self.kernels for argument in kernel.arguments))
        self._write_samples([self._turned(argument, pool[argument]) for argument in self.pool])
        self.launches = list(self._launches())
        declared = re.findall(r"^int (\w+)_cuda\(", texts[f"{name}_cuda.h"], re.MULTILINE)
        if declared != [f"{name}_{launch}" for launch, _, _ in self.launches]:
            raise ValueError(f"{name}_cuda.h declares other launch functions than the kernel table has")
        (folder / "launches.cu").write_text(self._table())

    def compile(self, compiler: Sequence[str], options: Sequence[str]) -> Path:
        """Compile with nvcc, or for the host with a C++ compiler; return the program."""
        program, flags = self.folder / "check", [f"-I{HERE}", f"-I{self.folder}", *options]
        language = [] if compiler[0].endswith("nvcc") else ["-x", "c++"]
        commands = [
            [*command, "-c", str(self.folder / source), "-o", str(self.folder / f"{source}.o")]
            for source, command in (
                (f"{self.name}.c", ["cc", "-std=gnu99", "-O1"]),
                (f"{self.name}.cu", [*compiler, *flags, *language]),
                ("launches.cu", [*compiler, *flags, *language]),
            )
        ]
        build.run_all(commands, compiler[0], self.folder)  # in the tests, KeptObjects': faults change one source
        objects = [command[-1] for command in commands]
        subprocess.run([*compiler, *options, *objects, "-lm", "-o", str(program)], check=True)
        return program

    def run(self, program: Path, *words: object) -> subprocess.CompletedProcess[str]:
        """Run the program on the samples; ``words``: number of configurations of one more launch."""
        command = [str(program), str(self.folder / "samples.bin"), *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    def _launches(self) -> Iterator[tuple[str, Kernel, bool]]:
        """Yield the name of every launch function, its kernel, and whether each configuration has its own matrices."""
        for kernel in self.kernels:
            yield kernel.qualified_name, kernel, False
            if any(_kind(a, each=True) != _kind(a, each=False) for a in kernel.arguments):
                yield f"{kernel.qualified_name}_each", kernel, True

    def _turned(self, argument: Argument, values: np.ndarray) -> np.ndarray:
        """Return an argument's values; in every tenth row the positions of revolute joints are many turns away."""
        values = np.array(values, dtype=float)
        if argument.is_q:
            turning = [k for k, each in enumerate(self.chain.coordinates) if each.type != "prismatic"]
            for row in range(3, len(values), 10):
                values[row, turning] *= FAR
        return values

    def _write_samples(self, stacks: Sequence[np.ndarray]) -> None:
        with (self.folder / "samples.bin").open("wb") as file:
            for stack in stacks:
                file.write(np.ascontiguousarray(stack, dtype=self.number).tobytes())

    def _table(self) -> str:
        """Return the text of launches.cu: sizes of the arguments, and a record of each launch function."""
        number = "double" if self.number is np.float64 else "float"
        sizes = ", ".join(str(argument.array(self.chain).size) for argument in self.pool)
        rows = "\n".join(self._row(*launch) for launch in self.launches)
        return (
            f'#include "{self.name}.h"\n#include "{self.name}_cuda.h"\n\ntypedef {number} number;\n'
            f'#include "check.h"\n\nstatic const std::vector<size_t> SIZES = {{{sizes}}};\n\n'
            f"static const std::vector<Launch> LAUNCHES = {{\n{rows}\n}};\n\nint main(int argc, char **argv)\n{{\n"
            f'    return check_all("{self.name}", {bound_of(self.number(0))}, SIZES, LAUNCHES, argc, argv);\n}}\n'
        )

    def _row(self, launch: str, kernel: Kernel, each: bool) -> str:
        """Return the record of a launch function: arguments, their strides, and its results."""
        given, passed = [], []
        for i, argument in enumerate(kernel.arguments):
            given.append(f"{{{self.pool.index(argument)}, {_kind(argument, each=each)}}}")
            passed += [f"x[{i}]", *([f"strides[{i}]"] if _kind(argument, each=each) == "VARYING" else [])]
        results = []
        for result in kernel.results:
            array = result.array(self.chain)
            results.append(f'{{"{result.name}", {array.size}, {array.shape[0] if result.symmetric else 0}}}')
        y = [f"y[{i}]" for i in range(len(results))]
        single = ", ".join([*(f"x[{i}]" for i in range(len(given))), *y])
        return (
            f'    {{"{launch}", {{{", ".join(given)}}}, {{{", ".join(results)}}},\n'
            "        [](size_t count, size_t stride, const number *const *x, const size_t *strides, number *const *y,"
            " void *stream) {\n            (void)strides;\n"
            f"            return {self.name}_{launch}_cuda({', '.join(['count', 'stride', *passed, *y, 'stream'])});\n"
            "        },\n        [](const number *const *x, number *const *y) { "
            f"{self.name}_{kernel.qualified_name}({single}); }}}},"
        )


def _kind(argument: Argument, *, each: bool) -> str:
    """Return how a launch function takes an argument: in columns, with a stride of its own, or shared."""
    if has_stride(argument, each):
        return "VARYING"
    return "OWN" if len(argument.shape) == 1 or argument.per_configuration else "SHARED"
