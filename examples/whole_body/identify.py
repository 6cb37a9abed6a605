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
MOST_COLUMNS = 150
"""Columns of a Hankel matrix per kick, spread over the responses."""


@dataclass(frozen=True)
class Found:
    """A mode of recorded motion: exponent s [1/s] of exp(s t), and shape (outputs)."""

    exponent: complex
    shape: Array

    @property
    def frequency(self) -> float:
        """Frequency [Hz]; for growth without oscillation, minus the growth rate over 2 pi."""
        size = abs(self.exponent) if oscillates(self.exponent) else -abs(self.exponent)
        return float(size / (2 * np.pi))


def oscillates(exponent: complex) -> bool:
    """Return whether exp(s t) swings rather than grows or decays; its frequency exceeds its rate."""
    return abs(exponent.imag) > abs(exponent.real)


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
    scale = np.abs(responses).max(axis=(0, 2), keepdims=True)  # of each output (1, outputs, 1)
    scaled = responses / np.where(scale == 0, 1, scale)
    eigenvalues, shapes, parts = _realised(scaled, order, block_rows)
    shapes = shapes * np.where(scale == 0, 0, scale).ravel()[:, None]
    exponents = np.log(eigenvalues.astype(complex)) / sample_time
    found = []
    for exponent, shape, part in zip(exponents, shapes.T, parts, strict=True):
        is_first_of_pair = (exponent.imag if oscillates(exponent) else exponent.real) > 0
        if is_first_of_pair and part > LEAST_PART * parts.max():
            found.append(Found(complex(exponent), _real_shape(shape)))
    return sorted(found, key=lambda mode: mode.frequency)


def _realised(scaled: Array, order: int, block_rows: int) -> tuple[Array, Array, Array]:
    """Return eigenvalues of A (order), their shapes (outputs, order), and the modes' parts in the responses (order).

    With H = U S V^T of the block Hankel matrix and H' of the one a sample later: H = (U S^1/2) (S^1/2 V^T) are the
    responses' two factors, and A = S^-1/2 U^T H' V S^-1/2 stands between them in H'. The outputs of a state are the
    first rows of U S^1/2.
    """
    outputs = scaled.shape[1]
    first, later = (_hankel(scaled, block_rows, delay) for delay in (0, 1))
    U, values, V = np.linalg.svd(first, full_matrices=False)
    root = np.sqrt(values[:order])
    A = (U[:, :order] / root).T @ later @ (V[:order].T / root)
    eigenvalues, vectors = np.linalg.eig(A)
    shapes = (U[:outputs, :order] * root) @ vectors
    # Share of each mode in the responses: a mode with a tiny share comes from nonlinearity.
    amplitudes = np.linalg.solve(vectors, (V[:order].T * root).T)  # of each mode, in each column
    return eigenvalues, shapes, np.linalg.norm(shapes, axis=0) * np.linalg.norm(amplitudes, axis=1)


def _hankel(responses: Array, block_rows: int, delay: int) -> Array:
    """Return the block Hankel matrix (block_rows outputs, starts kicks) of responses from the sample ``delay`` on.

    Its columns are windows of ``block_rows`` samples, from evenly spaced starts.
    """
    samples, _, kicks = responses.shape
    starts = samples - block_rows
    picked = range(0, starts, max(1, starts // MOST_COLUMNS))
    windows = [responses[start + delay : start + delay + block_rows] for start in picked]
    return np.hstack([window.reshape(-1, kicks) for window in windows])


def _real_shape(shape: Array) -> Array:
    """Return the real part of a complex shape, turned so that its largest entry is real."""
    largest = shape[np.abs(shape).argmax()]
    return np.asarray(np.real(shape * np.exp(-1j * np.angle(largest))))


def agreement(mass_matrix: Array, one: Array, other: Array) -> float:
    """Return how well two directions agree, 0 to 1: the modal assurance criterion with the mass matrix."""
    M = mass_matrix
    return float((one @ M @ other) ** 2 / ((one @ M @ one) * (other @ M @ other)))
