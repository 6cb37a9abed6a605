# SPDX-License-Identifier: MIT
"""Differentiate the energy between two tips along plain products of joint poses, as references for the kernels.

The energy is that of the textbook, in base axes: neither seen from one tip nor in parts.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

FramePose = tuple[ca.SX, ca.SX]
"""Rotation and origin of a frame in the base."""


def energies(a: FramePose, b: FramePose, rest: ca.SX, Kt: ca.SX, Ko: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the energies of translation and rotation [J] at the poses of both tips, from their definitions.

    Each tip's axes carry half of Kt for the displacement e of the half-way points; G = tr(Ko)/2 I - Ko is the trace
    form's matrix, B the rotation of tip b turned back by the rest rotation.
    """
    (A, pa), (Rb, pb) = a, b
    Kt, Ko = (Kt + Kt.T) / 2, (Ko + Ko.T) / 2
    B = Rb @ rest[:3, :3].T
    e = pb - pa - (A + B) @ rest[:3, 3] / 2
    in_a, in_b = A.T @ e, B.T @ e
    G = ca.trace(Ko) / 2 * ca.SX.eye(3) - Ko
    return (in_a.T @ Kt @ in_a + in_b.T @ Kt @ in_b) / 4, ca.trace((A - B) @ G @ (A - B).T) / 2


def limited(V: ca.SX, K: ca.SX, limit: ca.SX) -> ca.SX:
    """Return E (sqrt(1 + 2 V/E) - 1), E = limit^2/kappa, kappa the largest sum of absolute values in a row of K."""
    E = limit**2 / ca.mmax(ca.sum2(ca.fabs((K + K.T) / 2)))
    return E * (ca.sqrt(1 + 2 * V / E) - 1)


def energy(a: FramePose, b: FramePose, rest: ca.SX, Kt: ca.SX, Ko: ca.SX, *limits: ca.SX) -> ca.SX:
    """Return the energy; ``limits`` are those of force and moment of a bounded spring."""
    translation, rotation = energies(a, b, rest, Kt, Ko)
    if limits:
        return limited(translation, Kt, limits[0]) + limited(rotation, Ko, limits[1])
    return translation + rotation


def moved(pose: FramePose, twist: ca.SX) -> FramePose:
    """Return a pose after a twist (v, w) in base axes, to p + v, exp([w]) R up to second order."""
    turn = ca.skew(twist[3:])
    return (ca.SX.eye(3) + turn + turn @ turn / 2) @ pose[0], pose[1] + twist[:3]


def held(a: FramePose, b: FramePose, H: ca.SX, rest: ca.SX, Kt: ca.SX, Ko: ca.SX) -> ca.SX:
    """Return the energy of the spring that holds both tips in the base."""
    away, R0 = (a[1] + b[1]) / 2 - H[:3, 3], H[:3, :3]
    Kt, Ko = (Kt + Kt.T) / 2, (Ko + Ko.T) / 2
    G = ca.trace(Ko) / 2 * ca.SX.eye(3) - Ko
    turns = [R - R0 for R in (a[0], b[0] @ rest[:3, :3].T)]
    return away.T @ Kt @ away / 2 + sum(ca.trace(D @ G @ D.T) for D in turns) / 4


def energy_of(kind: str, a: FramePose, b: FramePose, parameters: Sequence[ca.SX]) -> ca.SX:
    """Return the energy of a group of kernels ("pair", "pair_bounded", "absolute", "bimanual")."""
    if kind.startswith("pair"):
        return energy(a, b, *parameters)
    H, rest, Kt, Ko, *between = parameters
    return held(a, b, H, rest, Kt, Ko) + (energy(a, b, rest, *between) if between else 0)
