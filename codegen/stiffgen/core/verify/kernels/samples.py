# SPDX-License-Identifier: MIT
"""Draw random states: values of the arguments of kernels, each from its record."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.quantities import Sampling


class Samples:
    """Random states of a chain: ``samples[argument]`` are values of an argument in ``count`` states.

    Stiffnesses of which kernels use the symmetric part are asymmetric, which a kernel that reads one triangle shows.
    Values depend on the seed, the argument's name and, if each tip has its own, on the tip. ``known`` values take the
    place of random ones.
    """

    def __init__(
        self, chain: Chain, count: int, seed: int, known: Mapping[Argument, FloatArray] | None = None, tip: int = 0
    ) -> None:
        self.chain, self.count, self.seed, self.tip = chain, count, seed, tip
        self._values = dict(known or {})

    def __getitem__(self, argument: Argument) -> FloatArray:
        """Return the values of an argument."""
        if argument not in self._values:
            self._values[argument] = self._drawn(argument)
        return self._values[argument]

    def of(self, arguments: tuple[Argument, ...]) -> tuple[FloatArray, ...]:
        """Return the values of several arguments."""
        return tuple(self[argument] for argument in arguments)

    def of_tip(self, tip: int) -> Samples:
        """Return the same states with the values that a tip has for itself."""
        known = {argument: values for argument, values in self._values.items() if not argument.plural}
        return Samples(self.chain, self.count, self.seed, known, tip)

    def _drawn(self, argument: Argument) -> FloatArray:
        """Return random values of an argument; one with a value per tip has those that the tips have alone."""
        if argument.each:
            each = argument.each
            return np.stack([self.of_tip(tip)[each] for tip in range(len(self.chain.tips))], axis=1)
        assert argument.draw is not None, f"{argument.name} is no argument of a kernel"
        tip = [self.tip] if argument.plural else []
        random = np.random.default_rng([self.seed, *tip, *argument.name.encode()])
        shape = argument.array(self.chain).shape
        values = argument.draw(Sampling(random, self.count, shape, self.chain, self.__getitem__))
        return asymmetric(values) if argument.symmetric_part else values


def argument_samples(
    chain: Chain, count: int, seed: int, options: KernelOptions | None = None
) -> dict[Argument, FloatArray]:
    """Draw a stack of ``count`` random values for every argument that kernels take."""
    samples = Samples(chain, count, seed)
    return {argument: samples[argument] for kernel in chain_kernels(chain, options) for argument in kernel.arguments}


def asymmetric(matrices: FloatArray) -> FloatArray:
    """Return matrices with these symmetric parts, up to rounding, of which no entry equals its mirror image."""
    half_gap = np.triu(1.0 + np.abs(matrices), 1) / 2  # above the diagonal; below it the matrix loses as much
    return np.asarray(matrices + half_gap - np.swapaxes(half_gap, -1, -2))


def symmetric(matrices: FloatArray) -> FloatArray:
    """Return symmetric parts, which kernels use of stiffnesses."""
    return np.asarray((matrices + np.swapaxes(matrices, -1, -2)) / 2)
