# SPDX-License-Identifier: MIT
"""Rigid poses and inertias in high precision, rounded once.

A URDF holds orientations as decimal roll-pitch-yaw angles. The generated code holds rotation matrices, and its bytes
must not depend on the machine's libm. Matrices are therefore computed with 50 digits (mpmath, pure integer arithmetic)
and rounded to double once, at the end.

An angle within 1e-11 rad of a multiple of pi/2 is replaced by that multiple, and an axis within 1e-11 rad of a
coordinate axis or plane by its projection (:data:`SNAP`), because files contain 1.57079632679 for a right angle. The
matrix then has exact zeros and ones, which keeps the printed kinematics short.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import mpmath
import numpy as np
from numpy.typing import NDArray

_DIGITS = 50
SNAP = 1e-11
"""Threshold [rad] for the replacement of angles near multiples of pi/2 and of axes near coordinate planes.

An axis near two coordinate planes becomes a coordinate axis. All other angles and axes stay as the file has them.
"""
_NEGLIGIBLE = 1e-15
"""Fraction of a number's scale at or below which the number becomes 0, as the residue of a cancellation.

Rotations and translations have the scales 1 and 1 m: a length of at most 1e-15 m in a file is 0 in the generated code.
"""

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

_context = mpmath.mp.clone()
_context.dps = _DIGITS
mpf = _context.mpf
Real: TypeAlias = Any  # mpmath number, whose class exists only at run time


def exact(value: float | Real) -> Real:
    """Return the shortest decimal number that rounds to a double, so that 0.228 + 0.192 is exactly 0.42."""
    return mpf(repr(value)) if isinstance(value, float) else mpf(value)


IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Pose:
    """Pose of one frame in another with high-precision entries (mpmath numbers): x_outer = R x_inner + p."""

    rotation: tuple[tuple[Real, ...], ...]
    translation: tuple[Real, ...]

    @staticmethod
    def identity() -> Pose:
        """Return the identity."""
        return Pose(_exact(IDENTITY), (mpf(0), mpf(0), mpf(0)))

    @staticmethod
    def from_xyz_rpy(xyz: Sequence[float], rpy: Sequence[float]) -> Pose:
        """Return the pose of an ``<origin>``: translation [m] and fixed-axis rpy [rad], R = Rz(y) Ry(p) Rx(r)."""
        (cr, sr), (cp, sp), (cy, sy) = (_cos_sin(angle) for angle in rpy)
        rotation = (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
        return Pose(rotation, tuple(exact(v) for v in xyz))

    @staticmethod
    def placed(xyz: Sequence[float], orientation: Sequence[float]) -> Pose:
        """Return the pose with a translation [m] and an orientation: three angles as in a URDF, or a quaternion."""
        if len(orientation) == 3:
            return Pose.from_xyz_rpy(xyz, orientation)
        w, x, y, z = _snapped([exact(v) for v in orientation])
        rotation = (
            (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
        )
        return Pose(rotation, tuple(exact(v) for v in xyz))

    @staticmethod
    def rotation_about(axis: Sequence[float], angle: float) -> Pose:
        """Return the rotation by ``angle`` [rad] about a unit axis through the origin (Rodrigues)."""
        c, s = _cos_sin(angle)
        x, y, z = (mpf(v) for v in axis)
        t = 1 - c
        rotation = (
            (t * x * x + c, t * x * y - s * z, t * x * z + s * y),
            (t * x * y + s * z, t * y * y + c, t * y * z - s * x),
            (t * x * z - s * y, t * y * z + s * x, t * z * z + c),
        )
        return Pose(rotation, (mpf(0), mpf(0), mpf(0)))

    @staticmethod
    def translated(offset: Sequence[float | Real]) -> Pose:
        """Return a frame with the same axes and its origin at ``offset`` [m]."""
        return Pose(_exact(IDENTITY), tuple(exact(v) for v in offset))

    @staticmethod
    def turned(rotation: Matrix) -> Pose:
        """Return a frame with the same origin and rotated axes."""
        return Pose(_exact(rotation), (mpf(0),) * 3)

    def __matmul__(self, inner: Pose) -> Pose:
        rotation = multiply(self.rotation, inner.rotation)
        offset = apply(self.rotation, inner.translation)
        return Pose(rotation, tuple(a + b for a, b in zip(offset, self.translation, strict=True)))

    def inverse(self) -> Pose:
        """Return the pose of the outer frame in the inner frame."""
        transpose = tuple(zip(*self.rotation, strict=True))
        return Pose(transpose, tuple(-v for v in apply(transpose, self.translation)))

    def rounded(self) -> tuple[Matrix, Vector]:
        """Return rotation and translation as doubles, each entry correctly rounded.

        Entries of at most 1e-15 (of a translation: 1e-15 m) become 0.
        """
        r, p = self.rotation, self.translation
        return (_vector(r[0]), _vector(r[1]), _vector(r[2])), _vector(p)


def multiply(a: Sequence[Sequence[Real]], b: Sequence[Sequence[Real]]) -> tuple[tuple[Real, ...], ...]:
    """Return the product of two 3x3 matrices."""
    columns = list(zip(*b, strict=True))
    return tuple(tuple(sum(x * y for x, y in zip(row, col, strict=True)) for col in columns) for row in a)


def apply(a: Sequence[Sequence[Real]], v: Sequence[Real]) -> tuple[Real, ...]:
    """Return the product of a 3x3 matrix and a vector."""
    return tuple(sum(x * y for x, y in zip(row, v, strict=True)) for row in a)


def unit(vector: Sequence[float]) -> Vector:
    """Return a non-zero vector scaled to unit length; entries of at most SNAP times its length become zero."""
    entries = [exact(v) for v in vector]
    length = _context.sqrt(sum(v * v for v in entries))
    entries = [v if abs(v) > SNAP * length else mpf(0) for v in entries]
    length = _context.sqrt(sum(v * v for v in entries))
    return _vector([v / length for v in entries])


def _snapped(quaternion: Sequence[Real]) -> list[Real]:
    """Return a quaternion of unit length, whose entries within SNAP of zero or of each other become so exactly."""
    length = _context.sqrt(sum(v * v for v in quaternion))
    sizes: list[Real] = [mpf(0)]
    entries = []
    for value in quaternion:
        size = abs(value) / length
        near = next((known for known in sizes if abs(size - known) < SNAP / 2), None)
        if near is None:
            sizes.append(near := size)
        entries.append(near if value > 0 else -near)
    length = _context.sqrt(sum(v * v for v in entries))
    return [v / length for v in entries]


def aligning_rotation(axis: Vector) -> Matrix:
    """Return the rotation, rounded to doubles, that turns the z axis (0, 0, 1) into a joint's axis (of unit length)."""
    sign = 1 if axis[2] >= 0 else -1
    x, y, z = (sign * mpf(v) for v in axis)
    k = 1 / (1 + z)
    shortest_turn = ((1 - k * x * x, -k * x * y, x), (-k * x * y, 1 - k * y * y, y), (-x, -y, z))
    half_turn = _exact(((1.0, 0.0, 0.0), (0.0, float(sign), 0.0), (0.0, 0.0, float(sign))))
    return Pose(multiply(shortest_turn, half_turn), (mpf(0),) * 3).rounded()[0]


@dataclass(frozen=True)
class Inertia:
    """Inertia of a body in one frame, in high precision; inertias in the same frame add up.

    ``mass`` [kg], ``moment`` (first moment m*c [kg m]), ``tensor`` (about the frame's origin [kg m^2]).
    """

    mass: Real
    moment: tuple[Real, ...]
    tensor: tuple[tuple[Real, ...], ...]

    @staticmethod
    def zero() -> Inertia:
        """Return an inertia without mass."""
        return Inertia(mpf(0), (mpf(0),) * 3, ((mpf(0),) * 3,) * 3)

    @staticmethod
    def of_body(mass: float, tensor: Sequence[float], frame: Pose) -> Inertia:
        """Return the inertia of a body from (ixx, ixy, ixz, iyy, iyz, izz) about its centre of mass.

        ``frame`` is the pose of the body's inertial frame, whose origin is the centre of mass.
        """
        xx, xy, xz, yy, yz, zz = (exact(v) for v in tensor)
        return Inertia(exact(mass), (mpf(0),) * 3, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))).seen_from(frame)

    def seen_from(self, frame: Pose) -> Inertia:
        """Return the inertia in another frame, where ``frame`` is the pose of the current frame."""
        r, d, m = frame.rotation, frame.translation, self.mass
        old = apply(r, self.moment)  # first moment in the new axes, about the old origin; new: about the new one
        new = tuple(a + m * b for a, b in zip(old, d, strict=True))
        tensor = multiply(multiply(r, self.tensor), tuple(zip(*r, strict=True)))
        # Steiner: tensor + (d . (old + new)) I - old d^T - d new^T, where new = old + m d
        square = sum(b * (v + w) for b, v, w in zip(d, old, new, strict=True))
        steiner = tuple(
            tuple(tensor[i][j] + (square if i == j else 0) - old[i] * d[j] - d[i] * new[j] for j in range(3))
            for i in range(3)
        )
        return Inertia(m, new, steiner)

    def __add__(self, other: Inertia) -> Inertia:
        return self._with(other, 1)

    def __sub__(self, other: Inertia) -> Inertia:
        return self._with(other, -1)

    def _with(self, other: Inertia, sign: int) -> Inertia:
        """Return the sum of two inertias about one point, or with sign -1 their difference."""
        return Inertia(
            self.mass + sign * other.mass,
            tuple(a + sign * b for a, b in zip(self.moment, other.moment, strict=True)),
            tuple(
                tuple(a + sign * b for a, b in zip(ra, rb, strict=True))
                for ra, rb in zip(self.tensor, other.tensor, strict=True)
            ),
        )

    def rounded(self, scale: Inertia | None = None) -> tuple[float, Vector, Matrix]:
        """Return mass, first moment and tensor as doubles.

        An entry of at most 1e-15 of its scale becomes zero. The scales follow from the body ``scale`` (default: this
        body): the largest entry of its tensor, and the largest first moment that its mass and tensor allow. This
        works for bodies of any mass and size.
        """
        body = self if scale is None else scale
        inertia = max(abs(v) for row in body.tensor for v in row)
        moment = _context.sqrt(abs(body.mass) * inertia)  # a body's first moment is at most sqrt(3) times this value
        x, y, z = (rounded(v, moment) for v in self.moment)
        first, second, third = (_vector(row, inertia) for row in self.tensor)
        return rounded(self.mass, body.mass), (x, y, z), (first, second, third)


def physical_inertia(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> bool:
    """Return whether a rigid body can have this inertia tensor about its centre of mass (tolerance 1 %)."""
    # Closed form of the principal moments of a symmetric 3x3 matrix: mean + 2 spread cos(angle + 2 pi k / 3), where
    # 2 half_det is the determinant of (matrix - mean I) / spread.
    largest = max(map(abs, (xx, xy, xz, yy, yz, zz)))
    if largest == 0:
        return True
    xx, xy, xz, yy, yz, zz = (value / largest for value in (xx, xy, xz, yy, yz, zz))
    mean = (xx + yy + zz) / 3
    spread = math.sqrt(((xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * (xy**2 + xz**2 + yz**2)) / 6)
    if spread == 0:
        return mean >= 0
    a, b, c = ((value - mean) / spread for value in (xx, yy, zz))
    d, e, f = xy / spread, xz / spread, yz / spread
    half_det = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    angle = math.acos(min(1.0, max(-1.0, half_det))) / 3
    high = mean + 2 * spread * math.cos(angle)
    low = mean + 2 * spread * math.cos(angle + 2 * math.pi / 3)
    middle = 3 * mean - high - low
    return low >= -0.01 * abs(high) and high <= 1.01 * (low + middle)


def principal_moments(tensor: Sequence[float]) -> tuple[list[Real], Any]:
    """Return the principal moments of a tensor (ixx, ixy, ixz, iyy, iyz, izz), the least first, and their axes."""
    xx, xy, xz, yy, yz, zz = (exact(value) for value in tensor)
    moments, axes = _context.eigsy(_context.matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    return list(moments), axes


def with_moments(moments: Sequence[Real], axes: Any) -> tuple[float, float, float, float, float, float]:
    """Return the tensor with principal moments about axes, as :func:`principal_moments` returns them."""
    full = axes * _context.diag(list(moments)) * axes.T
    scale = max(abs(moment) for moment in moments)
    xx, xy, xz, yy, yz, zz = (rounded(full[i, j], scale) for i in range(3) for j in range(i, 3))
    return xx, xy, xz, yy, yz, zz


def _cos_sin(angle: float) -> tuple[Real, Real]:
    """Return cosine and sine; those of angles within SNAP of whole quarter turns are exactly 0, 1 or -1."""
    quarter = _context.pi / 2
    position = exact(angle)
    turns = int(_context.nint(position / quarter))
    if abs(position - turns * quarter) < SNAP:
        return ((mpf(1), mpf(0)), (mpf(0), mpf(1)), (mpf(-1), mpf(0)), (mpf(0), mpf(-1)))[turns % 4]
    return _context.cos(position), _context.sin(position)


def _exact(matrix: Matrix) -> tuple[tuple[Real, ...], ...]:
    return tuple(tuple(mpf(v) for v in row) for row in matrix)


def rounded(value: Real, scale: Real = 1) -> float:
    """Return the nearest double, or zero for a residue of cancellation (at most 1e-15 of the scale)."""
    return 0.0 if abs(value) <= _NEGLIGIBLE * scale else float(value)


def _vector(values: Sequence[Real], scale: Real = 1) -> Vector:
    x, y, z = (rounded(v, scale) for v in values)
    return x, y, z
