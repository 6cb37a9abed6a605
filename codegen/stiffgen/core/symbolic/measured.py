# SPDX-License-Identifier: MIT
"""Stiffness arguments: one check of their symmetry, and the argument of a stiffness measured under a load.

A stiffness K is symmetric. Kernels, which cannot refuse a matrix, use its symmetric part 0.5 (K_ij + K_ji); functions
that raise errors refuse an asymmetric one.

A matrix Km measured or learnt at a loaded pose holds the changes of the wrench's components per small twist. In a
conservative environment it is K + Gamma F: asymmetric by the moment, in body and spatial representation also by the
force. The argument of the kernels is sym(Km - Gamma F). In hybrid representation Gamma F is antisymmetric, so that the
symmetric part of Km is right as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError, listed
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import COEFFICIENTS, REPRESENTATIONS, Representation

ASYMMETRY = 1e-6
"""Share of the largest entry by which a stiffness may differ from its transpose: single precision."""
REMEDY = "for a measured one take stiffgen.measured_stiffness(Km, wrench, representation)"
"""Remedy in every message about an asymmetric stiffness."""


@dataclass(frozen=True)
class StiffnessResidual:
    """Antisymmetric part of a measured stiffness that the wrench does not explain.

    Attributes:
        matrix: antisym(Km) - antisym(Gamma F) (..., 6, 6) [N/m, N, N m].
        moment: length (...) of the moment that would explain the rotational block [N m].
        share: ``moment`` divided by the wrench's moment (...); 0 where both are zero, infinite where only the wrench's
            is. A transposed Km, a wrench of opposite sign, or body for hybrid axes give 2.

    """

    matrix: FloatArray
    moment: FloatArray
    share: FloatArray


class MeasuredStiffness(NamedTuple):
    """Symmetric argument ``K`` of the kernels (..., 6, 6), and the part of Km that nothing explains."""

    K: FloatArray
    residual: StiffnessResidual


def measured_stiffness(
    Km: ArrayLike, wrench: ArrayLike, representation: Representation = "hybrid"
) -> MeasuredStiffness:
    """Return the symmetric task stiffness of a matrix measured under a load, and the part that the load leaves over.

    Leading dimensions broadcast.

    Args:
        Km: (..., 6, 6), change of each component of the wrench per twist (linear, angular), at the loaded pose; wrench
            and twist in ``representation`` [N/m, N, N m].
        wrench: (..., 6), (force, moment) that the environment applies to the robot at this pose [N, N m].
        representation: of both arguments and the result: "body", "spatial" or "hybrid".

    Returns:
        ``(K, residual)``: K = sym(Km - Gamma F) (..., 6, 6), bitwise symmetric, the exact argument of joint_stiffness
        in a conservative environment; and a :class:`StiffnessResidual`, zero there.

    Raises:
        StiffgenError: shapes do not fit, or the representation is unknown.

    """
    if representation not in REPRESENTATIONS:
        raise StiffgenError(
            f"measured_stiffness: no representation {representation!r}; representations are "
            f"{listed(list(REPRESENTATIONS))}"
        )
    matrix, F = np.asarray(Km, dtype=float), np.asarray(wrench, dtype=float)
    if matrix.shape[-2:] != (6, 6):
        raise StiffgenError(f"measured_stiffness: Km must have the shape (..., 6, 6), not {matrix.shape}")
    if F.shape[-1:] != (6,):
        raise StiffgenError(f"measured_stiffness: wrench must have the shape (..., 6), not {F.shape}")
    gamma = np.zeros((*F.shape[:-1], 6, 6))  # Gamma F: what the load adds to the matrix that is measured
    for i, j, k, coefficient in COEFFICIENTS[representation]:
        gamma[..., i, j] += coefficient * F[..., k]
    try:
        without = matrix - gamma
    except ValueError as error:
        raise StiffgenError(
            f"measured_stiffness: leading dimensions {matrix.shape[:-2]} of Km and {F.shape[:-1]} of wrench do not "
            "broadcast"
        ) from error
    left = (without - np.swapaxes(without, -1, -2)) / 2  # zero, if sensor and pose are right
    # A moment m leaves [m]/2 in the rotational block, docs/theory.md (4); above its diagonal are m's entries.
    moment = 2 * np.sqrt(left[..., 3, 4] ** 2 + left[..., 3, 5] ** 2 + left[..., 4, 5] ** 2)
    of_wrench = np.broadcast_to(np.linalg.norm(F[..., 3:], axis=-1), moment.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((moment == 0) & (of_wrench == 0), 0.0, moment / of_wrench)
    return MeasuredStiffness(symmetric_part(without), StiffnessResidual(left, moment, share))


def symmetric_part(matrices: FloatArray) -> FloatArray:
    """Return (K + K^T)/2, bitwise symmetric."""
    return np.asarray((matrices + np.swapaxes(matrices, -1, -2)) / 2)


def symmetric(name: str, values: ArrayLike, size: int | None = None) -> FloatArray:
    """Return a stack of symmetric matrices; StiffgenError, which begins with the name, for any other array."""
    matrix = np.asarray(values, dtype=float)
    n = matrix.shape[-1] if size is None and matrix.ndim else size
    if matrix.ndim < 2 or matrix.shape[-2:] != (n, n):
        wanted = "(..., n, n)" if size is None else f"(..., {n}, {n})"
        raise StiffgenError(f"{name} must have the shape {wanted}, not {matrix.shape}")
    check_symmetric(name, matrix)
    return symmetric_part(matrix)


def check_symmetric(name: str, matrices: FloatArray) -> None:
    """Raise StiffgenError if one of a stack of square matrices is not symmetric; matrices with NaN or infinity pass."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(matrices - np.swapaxes(matrices, -1, -2))
        is_off = apart > ASYMMETRY * np.abs(matrices).max(axis=(-1, -2), keepdims=True, initial=0.0)
    if not is_off.any():
        return
    farthest = np.where(is_off, apart, -1.0).argmax()  # the entry that is off by most
    *stack, row, column = (int(k) for k in np.unravel_index(farthest, apart.shape))
    entry, mirrored = matrices[(*stack, row, column)], matrices[(*stack, column, row)]
    number = f" of number {', '.join(map(str, stack))}" if stack else ""
    raise StiffgenError(
        f"{name} is not symmetric: entry ({row}, {column}){number} is {entry:.9g}, "
        f"({column}, {row}) is {mirrored:.9g} (counted from 0); give (K + K^T)/2, or {REMEDY}"
    )
