# SPDX-License-Identifier: MIT
"""Identify frequencies and mode shapes from recorded free motion, by the eigensystem realization algorithm.

Juang and Pappa (1985): the responses y_k to several kicks, side by side, are C A^k B of a linear system. Two block
Hankel matrices of the responses, one of them a sample later, are products of the same two factors, the later one with A
between them. A singular value decomposition gives A up to a change of state. The eigenvalues of A are exp(s t), with t
the sample time. The method uses nothing of the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_PART = 1e-3
"""Share of the largest mode in the responses below which a mode cannot be told from nonlinearity."""


@dataclass(frozen=True)
class Found:
    """A mode of recorded motion: exponent s [1/s] of exp(s t), and shape (outputs)."""

    exponent: complex
    shape: Array

    @property
    def frequency(self) -> float:
        """Frequency [Hz]; for growth without oscillation, minus the growth rate over 2 pi."""
        swings = abs(self.exponent.imag) > abs(self.exponent.real)
        return float((abs(self.exponent) if swings else -abs(self.exponent)) / (2 * np.pi))


def modes(responses: Array, sample_time: float, order: int, block_rows: int = 60) -> list[Found]:
    """Identify the modes of free responses.

    Args:
        responses: (samples, outputs, kicks).
        sample_time: [s].
        order: of the system, twice its degrees of freedom.
        block_rows: samples that one column of the Hankel matrix holds.

    Returns:
        One mode for every pair of exponents, in the order of frequency; of s and -s the one that grows.

    """
    samples, outputs, _ = responses.shape
    columns = samples - block_rows
    scale = np.abs(responses).max(axis=(0, 2), keepdims=True)
    scaled = responses / np.where(scale == 0, 1, scale)
    picked = range(0, columns, max(1, columns // 150))
    # Eigensystem realisation (Juang and Pappa 1985): Hankel matrices of the responses and of those a sample later;
    # their singular vectors give the system's matrix A, whose eigenvalues are those of the modes.
    first, later = (
        np.hstack(
            [scaled[start + late : start + late + block_rows].reshape(-1, responses.shape[2]) for start in picked]
        )
        for late in (0, 1)
    )
    U, values, V = np.linalg.svd(first, full_matrices=False)
    root = np.sqrt(values[:order])
    A = (U[:, :order] / root).T @ later @ (V[:order].T / root)
    eigenvalues, vectors = np.linalg.eig(A)
    shapes = (U[:outputs, :order] * root) @ vectors
    # Share of each mode in the responses: a mode with a tiny share comes from nonlinearity.
    parts = np.linalg.norm(shapes, axis=0) * np.linalg.norm(np.linalg.solve(vectors, (V[:order].T * root).T), axis=1)
    shapes = shapes * np.where(scale == 0, 0, scale).ravel()[:, None]
    exponents = np.log(eigenvalues.astype(complex)) / sample_time
    found = []
    for exponent, shape, part in zip(exponents, shapes.T, parts, strict=True):
        swings = abs(exponent.imag) > abs(exponent.real)
        of_pair = (exponent.imag if swings else exponent.real) > 0
        if of_pair and part > LEAST_PART * parts.max():
            real = np.real(shape * np.exp(-1j * np.angle(shape[np.abs(shape).argmax()])))
            found.append(Found(complex(exponent), np.asarray(real)))
    return sorted(found, key=lambda mode: mode.frequency)


def agreement(mass_matrix: Array, one: Array, other: Array) -> float:
    """Return how well two directions agree, 0 to 1: the modal assurance criterion with the mass matrix."""
    M = mass_matrix
    return float((one @ M @ other) ** 2 / ((one @ M @ one) * (other @ M @ other)))
