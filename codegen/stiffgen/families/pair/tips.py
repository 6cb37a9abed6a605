# SPDX-License-Identifier: MIT
"""CasADi expressions of a spring between two tips on the twists of both: wrenches (12), covariant Hessian (12x12).

The order is (va, wa, vb, wb), hybrid axes: base axes, each tip's own origin. With A, B, e of
:mod:`stiffgen.families.pair.springs`, la = A d0/2 and lb = B d0/2, the rotation has M = B G A^T and

    u = vee(M - M^T):   ma = -u, mb = u;    Kaa = Kbb = tr(M) I - sym(M),  Kab = M - tr(M) I

The half of the translation whose S turns with a has, with f = S e, ca = e + la, cb = lb and P = [-I, [ca], I, [cb]],

    F = P^T f,   K = P^T S P + Z,   Z(wa,wa) = sym([f][ca]),  Z(wb,wb) = -sym([f][lb]),  Z(wa,wb) = [f][lb],
                                    Z(wa,vb) = [f],  Z(wa,va) = -[f]

and the other half the same with the tips exchanged: ca = la, cb = e + lb.

The absolute spring holds the middle of the tips' origins, and half on each tip the rotation: A and B towards R0. A
turn of both hands costs what the ordinary spring costs; the relative rotational stiffness grows by Ko/4. A frame
half-way between A and B would not add that, but jumps at relative half turns, where its spring would do work round a
closed path.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.core.symbolic.kinematics import Kind, Section
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.pair.springs import TRACE, PairKind, with_limits
from stiffgen.families.springs.parts import Terms, other_two, trace_form

TipFrame = tuple[ca.SX, ca.SX]
"""Rotation and origin of a tip, in base axes."""
VA, WA, VB, WB = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Entries of the twists of both tips, (va, wa, vb, wb)."""


def axial(matrix: ca.SX) -> ca.SX:
    """Return the vector a of A - A^T = [a]."""
    return ca.vertcat(matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])


def _rotation(A: ca.SX, B: ca.SX, Ko: ca.SX) -> Terms:
    """Return the terms of tr(G (I - A^T B)) = tr((B - A) G (B - A)^T)/2; none cancels near the rest pose.

    A and B are the tips' rotations, B turned back by the rest rotation. Differentiating A by a turn w gives [w] A,
    so that moments are axial vectors of Y = (B - A) G A^T, and second derivatives follow from M = B G A^T. A G A^T is
    symmetric, so that Y and M have the same axial vector.
    """
    G = 0.5 * ca.trace(Ko) * ca.SX.eye(3) - Ko
    D = B - A
    W, L = D @ G, B @ G
    M, Y = L @ A.T, W @ A.T
    u = axial(Y)
    # Blocks of two turns: tr(M) I - sym(M) of one tip with itself, M - tr(M) I between the tips.
    own, coupling = -0.5 * (M + M.T), ca.densify(ca.SX(M))
    for k in range(3):
        others = other_two(M, k)
        own[k, k], coupling[k, k] = others, -others
    K = ca.SX(12, 12)
    K[WA, WA] = K[WB, WB] = own
    K[WA, WB], K[WB, WA] = coupling, coupling.T
    zero = ca.SX(3, 1)
    V = 0.5 * sum((ca.dot(D[row, :], W[row, :]) for row in range(3)), ca.SX(0))
    sections = (
        Section(
            "G = tr(Ko)/2 I - Ko; D = B - A, W = D G; Y = W A^T, moments Y - Y^T", {"G": G, "D": D, "W": W, "Y": Y}
        ),
        Section("M = L A^T, L = B G", {"L": L, "M": M}),
        Section("moment u on B", {"u": u}),
    )
    return Terms(V, ca.vertcat(zero, -u, zero, u), K, sections)


def _half(S: ca.SX, f: ca.SX, arms: tuple[ca.SX, ca.SX], other: ca.SX, *, turns_with_second: bool) -> ca.SX:
    """Return the Hessian (12x12) of the half whose stiffness S turns with one tip: P^T S P + Z of the module's head.

    ``arms`` are ca and cb, ``other`` is la or lb of the tip that S does not turn with.
    """
    # displacement of the half's spring per unit of both tips' motions (3, 12)
    P = ca.horzcat(-ca.SX.eye(3), ca.skew(arms[0]), ca.SX.eye(3), ca.skew(arms[1]))
    W_own, W_other, own_arm = (WB, WA, arms[1]) if turns_with_second else (WA, WB, arms[0])
    force, arm, toward = ca.skew(f), ca.skew(own_arm), ca.skew(other)
    # curvature of the displacement times the force
    Z = ca.SX(12, 12)
    Z[W_own, W_own] = 0.5 * (force @ arm + (force @ arm).T)
    Z[W_other, W_other] = -0.5 * (force @ toward + (force @ toward).T)
    for columns, block in ((W_other, force @ toward), (VB, force), (VA, -force)):
        Z[W_own, columns], Z[columns, W_own] = block, block.T
    return P.T @ S @ P + Z


def _translation(a: TipFrame, b: TipFrame, B: ca.SX, d0: ca.SX, Kt: ca.SX) -> Terms:
    """Return the terms of e^T S e/2: e is B's origin less A's less the rest displacement, half in each tip's axes."""
    (A, pa), (_, pb) = a, b
    half = 0.5 * d0
    la, lb = A @ half, B @ half  # arms from either tip to the spring's centre [m]
    e = pb - pa - la - lb
    SA, SB = (symmetric_from_upper((X @ (0.5 * Kt)) @ X.T) for X in (A, B))
    fA, fB = SA @ e, SB @ e
    f = fA + fB  # the force on B; A's axes carry one half of the stiffness, B's the other
    moment_on_a = -ca.cross(la, f) - ca.cross(e, fA)
    moment_on_b = -ca.cross(lb, f) - ca.cross(e, fB)
    F = ca.vertcat(-f, moment_on_a, f, moment_on_b)
    K_with_a = _half(SA, fA, arms=(e + la, lb), other=lb, turns_with_second=False)
    K_with_b = _half(SB, fB, arms=(la, e + lb), other=la, turns_with_second=True)
    sections = (
        Section("arms la = A d0/2, lb = B d0/2; displacement e half-way", {"la": la, "lb": lb, "e": e}),
        Section("halves of the stiffness in base axes: SA = A Kt/2 A^T, SB = B Kt/2 B^T", {"SA": SA, "SB": SB}),
        Section("their forces", {"fA": fA, "fB": fB}),
        Section("force f on B", {"f": f}),
    )
    return Terms(0.5 * ca.dot(e, f), F, K_with_a + K_with_b, sections)


def relative(kind: PairKind, a: TipFrame, b: TipFrame, parameters: tuple[ca.SX, ...], origin: ca.SX) -> Terms:
    """Return energy, wrenches (12) and Hessian (12x12) of a spring between the tips; the ``origin`` does not matter."""
    rest, Kt, Ko, *_ = parameters  # then the limits of a bounded spring
    (A, _), (Rb, _) = a, b
    E0, d0 = rest[:3, :3], rest[:3, 3]
    B = ca.densify(Rb @ E0.T)
    translation = _translation(a, b, B, d0, symmetric_from_upper(Kt))
    both = with_limits(kind, translation, _rotation(A, B, symmetric_from_upper(Ko)), parameters)
    section = Section("A = Ra, B = Rb E0^T; RB is B", {"RB": B}, {"RB": Kind.ROTATION})
    return Terms(both.V, both.F, both.K, (section, *both.sections))


def absolute(a: TipFrame, b: TipFrame, parameters: tuple[ca.SX, ...], origin: ca.SX) -> Terms:
    """Return energy, wrenches (12) and Hessian (12x12) of a spring that holds both tips in the base.

    The parameters are equilibrium, rest, Kt and Ko. Kt acts on the middle of the tips' origins, half of Ko on each
    tip's rotation. The tips' origins are relative to the ``origin`` of the base link.
    """
    H, rest, Kt, Ko = parameters
    Kt, Ko = symmetric_from_upper(Kt), symmetric_from_upper(Ko)
    (A, pa), (Rb, pb) = a, b
    e = 0.5 * (pa + pb) - (H[:3, 3] - origin)
    f, B = Kt @ e, ca.densify(Rb @ rest[:3, :3].T)
    # half of Ko on the rotation of tip a, half on that of tip b, turned back by the rest rotation
    of_a, of_b = (trace_form(R, H, 0.5 * Ko, "equilibrium").of_tip(k) for k, R in enumerate((A, B)))
    half, quarter = 0.5 * f, 0.25 * Kt  # the middle moves by half of each tip's motion
    K = ca.SX(12, 12)
    for rows in (VA, VB):
        for columns in (VA, VB):
            K[rows, columns] = quarter
    K[WA, WA], K[WB, WB] = of_a.K[3:, 3:], of_b.K[3:, 3:]
    sections = (
        Section("RH = Rb E0^T", {"RH": B}, {"RH": Kind.ROTATION}),
        Section("displacement em of the tips' middle, force fm", {"em": e, "fm": f}),
        *of_a.sections,
        *of_b.sections,
    )
    V = 0.5 * ca.dot(e, f) + of_a.V + of_b.V
    return Terms(V, ca.vertcat(half, of_a.F[3:], half, of_b.F[3:]), K, sections)


def bimanual(a: TipFrame, b: TipFrame, parameters: tuple[ca.SX, ...], origin: ca.SX) -> Terms:
    """Return the sum of both: the parameters are those of :func:`absolute`, then Kt and Ko of :func:`relative`."""
    H, rest, Kt, Ko, between_Kt, between_Ko = parameters
    held = absolute(a, b, (H, rest, Kt, Ko), origin)
    return held + relative(TRACE, a, b, (rest, between_Kt, between_Ko), origin)
