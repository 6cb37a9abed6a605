# SPDX-License-Identifier: MIT
"""Two hands on one object: compliance of one hand seen from the other, internal wrench from two sensors.

Leading dimensions broadcast. All wrenches are those that the environment, here the object, applies to the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import symmetric


@dataclass(frozen=True)
class HeldWrench:
    """Wrenches of an object that two hands hold, (force, moment) about one point in base axes.

    Attributes:
        internal: (..., 6) wrench on hand B that squeezes or twists the object, hand A has the opposite [N, N m].
        net: (..., 6) sum of both hands' wrenches: weight of the object and all that touches it.
        residual: (..., 6) ``net`` less the object's load; zero up to noise for exact sensors and frames.

    """

    internal: FloatArray
    net: FloatArray
    residual: FloatArray


def _shape(name: str, value: ArrayLike, *extents: int) -> FloatArray:
    array = np.asarray(value, dtype=float)
    if array.shape[-len(extents) :] != extents:
        raise StiffgenError(f"{name} must be (..., {', '.join(map(str, extents))}), not {array.shape}")
    return array


def _origins(call: str, pose_a: ArrayLike, pose_b: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the origins of both tips."""
    a, b = _shape(f"{call}: pose_a", pose_a, 4, 4), _shape(f"{call}: pose_b", pose_b, 4, 4)
    return a[..., :3, 3], b[..., :3, 3]


def _at(wrench: FloatArray, from_point: FloatArray, point: FloatArray) -> FloatArray:
    """Return a wrench about another point."""
    force, moment = np.broadcast_arrays(wrench[..., :3], wrench[..., 3:])
    moved = moment + np.cross(from_point - point, force)
    return np.concatenate([np.broadcast_to(force, moved.shape), moved], axis=-1)


def internal_wrench(
    wrench_a: ArrayLike, wrench_b: ArrayLike, pose_a: ArrayLike, pose_b: ArrayLike, *, point: ArrayLike | None = None,
    load: ArrayLike | None = None,
) -> HeldWrench:  # fmt: skip
    """Return the internal wrench of an object between two hands, by least squares from the wrenches of two sensors.

    Twelve numbers are measured; the object's load leaves six unknown ones. With equal noise in both hands the least
    squares are half the difference of the wrenches about one point, and the load is shared by halves.

    The sensors cannot tell how the hands share the load: the share by halves is a convention, and moments depend on
    the point. Half of one sensor's bias is in ``internal``, and all of it in ``residual``. Opposite errors of the hands
    look like an internal wrench and leave no residual; equal errors look like a load and leave ``internal`` as it is.

    Args:
        wrench_a: (..., 6) hybrid wrench at the tip of hand A, as ``sensor.tip_wrench`` returns it [N, N m].
        wrench_b: that of hand B.
        pose_a: (..., 4, 4) pose of tip A [m].
        pose_b: that of tip B.
        point: (..., 3) point of the object [m] (default: half-way between the tips).
        load: (..., 6) weight of the object about the point, (m g, c x m g) with c from the point [N, N m] (default: 0).

    Returns:
        Internal and net wrench about the point, and the residual. ``internal`` moved to tip B compares with the part of
        B of ``pair.wrench``.

    Raises:
        StiffgenError: shapes do not fit.

    """
    pa, pb = _origins("internal_wrench", pose_a, pose_b)
    at = (pa + pb) / 2 if point is None else _shape("internal_wrench: point", point, 3)
    # both hands' wrenches about the one point
    a = _at(_shape("internal_wrench: wrench_a", wrench_a, 6), pa, at)
    b = _at(_shape("internal_wrench: wrench_b", wrench_b, 6), pb, at)
    weight = np.zeros(6) if load is None else _shape("internal_wrench: load", load, 6)
    return HeldWrench((b - a) / 2, a + b, a + b - weight)


def relative_compliance(compliance: ArrayLike, pose_a: ArrayLike, pose_b: ArrayLike) -> FloatArray:
    """Return the compliance of tip B seen from tip A, two loaded tips of one robot.

    An additional wrench on B, and its opposite on A, move B by C dF relative to A: the twist of B at its origin, as
    seen from A, in base axes. Both wrenches keep their components along geodesics of their tips, as the loads of
    ``tip_compliance_total`` do. With a spring between the tips, its joint stiffness belongs to Kth of that function.

    Args:
        compliance: (..., 12, 12) ``hybrid.tip_compliance_total`` of the tips A and B, symmetric; of more tips, their
            rows and columns [m/N, rad/N, rad/(N m)].
        pose_a: (..., 4, 4) pose of tip A [m].
        pose_b: that of tip B.

    Returns:
        (..., 6, 6) C = L C12 L^T, L = [-X, 1] with the twist X of A moved to B's origin; bitwise symmetric.

    Raises:
        StiffgenError: shapes do not fit, or the compliance is not symmetric.

    """
    C = symmetric("relative_compliance: compliance", _shape("relative_compliance: compliance", compliance, 12, 12))
    pa, pb = _origins("relative_compliance", pose_a, pose_b)
    arm = pb - pa
    # relative twist: (vb, wb) - (va + wa x arm, wa) of twists (va, wa, vb, wb)
    L = np.zeros((*arm.shape[:-1], 6, 12))
    L[..., :, 6:] = np.eye(6)
    L[..., :, :6] = -np.eye(6)
    L[..., :3, 3:6] = np.swapaxes(np.cross(arm[..., None, :], np.eye(3)), -1, -2)  # arm x w, as -w x arm
    relative = L @ C @ np.swapaxes(L, -1, -2)
    return np.asarray((relative + np.swapaxes(relative, -1, -2)) / 2)
