# SPDX-License-Identifier: MIT
"""Compile the functions of a generated NAME.cu for the host and call them from Python."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from support.c_program import STRICT
from support.controller_library import compile_c
from support.project import require_compiler

NOTHING = -77.0
"""Value of the result's entries before the call."""


def has_stride(argument: Argument, each: bool) -> bool:
    """Whether a launch function takes a stride for an argument."""
    return argument.varying or (each and len(argument.shape) != 1 and not argument.per_configuration)


class HostCuda:
    """NAME.cu as a shared library for the host; ``number`` is the type that it was printed for."""

    def __init__(
        self,
        source: Path,
        name: str,
        chain: Chain,
        work: Path,
        compiler: str = "g++",
        level: str = "-O1",
        number: type[np.floating[Any]] = np.float64,
        options: KernelOptions | None = None,
    ) -> None:
        """Compile the CUDA source for the host, without a GPU, and load it."""
        flags = [
            "-x",
            "c++",
            "-std=c++11",
            level,
            *STRICT,
            "-Wdouble-promotion",
            "-shared",
            "-fPIC",
            f"-I{source.parent}",
        ]
        library = compile_c(work / f"{name}_cuda.so", *flags, source, compiler=require_compiler(compiler))
        self.library = ctypes.CDLL(str(library))
        self.name = name
        self.number = number
        self.chain = chain
        self.kernels = {kernel.qualified_name: kernel for kernel in chain_kernels(chain, options) if kernel.batch}

    def launch(self, kernel: Kernel, count: int, stride: int, *arrays: np.ndarray | None, each: bool = False) -> int:
        """Call a launch function, ``each``: that which takes matrices and numbers per configuration."""
        function = getattr(self.library, f"{self.name}_{kernel.qualified_name}{'_each' if each else ''}_cuda")
        given: list[object] = []
        for array, argument in zip(arrays, (*kernel.arguments, *kernel.results), strict=True):
            given.append(None if array is None else ctypes.c_void_p(array.ctypes.data))
            if argument in kernel.arguments and has_stride(argument, each):
                given.append(ctypes.c_size_t(self._stride_of(argument, array)))
        return int(function(ctypes.c_size_t(count), ctypes.c_size_t(stride), *given, None))

    def __call__(self, name: str, *arguments: np.ndarray, spare: int = 0, each: bool = False) -> Any:
        """Call a function on stacks.

        Vectors come in stacks (count, m), arguments with a stride of their own in stacks or shared, other arguments
        shared. ``spare`` is stride - count; strides of arguments are even larger, each by another number. Results are
        dense (count, ...).
        """
        kernel = self.kernels[name]
        count = len(arguments[0])
        stride = count + spare
        given = [
            self._columns(a.reshape(count, -1), stride + (3 + index) * has_stride(argument, each))
            if np.ndim(a) > len(argument.shape) or len(argument.shape) == 1
            else np.array(a, dtype=self.number, order="C")
            for index, (a, argument) in enumerate(zip(arguments, kernel.arguments, strict=True))
        ]
        outs = [np.full((self._rows(result) + 1, stride), NOTHING, dtype=self.number) for result in kernel.results]
        assert self.launch(kernel, count, stride, *given, *outs, each=each) == 0
        for out in outs:  # nothing is written beyond the end
            assert (out[-1] == NOTHING).all() and (out[:, count:] == NOTHING).all()
        found = [self._dense(r, out[:-1, :count].T) for r, out in zip(kernel.results, outs, strict=True)]
        return found[0] if len(found) == 1 else tuple(found)

    def _stride_of(self, argument: Argument, array: np.ndarray | None) -> int:
        """Return the stride of columns; 0 of an argument in its own shape, which is shared."""
        if array is None or array.shape == argument.array(self.chain).shape:
            return 0
        return int(array.shape[1])

    def _rows(self, result: Argument) -> int:
        array = result.array(self.chain)
        return array.shape[0] * (array.shape[0] + 1) // 2 if result.symmetric else array.size

    def _dense(self, result: Argument, found: np.ndarray) -> np.ndarray:
        """Return results as matrices; symmetric ones are stored as upper triangles."""
        shape, count = result.array(self.chain).shape, len(found)
        if not result.symmetric:
            return found.reshape(count, *shape)
        n = shape[0]
        dense = np.empty((count, n, n))
        upper = np.triu_indices(n)
        dense[:, upper[0], upper[1]] = dense[:, upper[1], upper[0]] = found
        return dense

    def _columns(self, stack: np.ndarray, stride: int) -> np.ndarray:
        """Return columns: entry k of configuration c at [k, c]; no entry beyond the last configuration may be read."""
        columns = np.full((stack.shape[1], stride), np.nan, dtype=self.number)
        columns[:, : len(stack)] = stack.T
        return columns
