# SPDX-License-Identifier: MIT
"""Parts of springs: energy, wrench and covariant Hessian of a displacement or a rotation, in closed form.

A part has an energy V. A twist x = (v, w) moves the tip to (p + v, exp([w]) R); exp([w]) = I + [w] + [w]^2/2 up to
second order. Each part names the quantities of its formulas in sections, under which the printed C computes them;
docs/theory.md has the table of the symbols.

    displacement    V = d^T Kt d/2, d = X^T e, in axes X of the stiffness: base, equilibrium (R0) or tip (R)
    trace form      V = tr((R - R0) G (R - R0)^T)/2, G = tr(Ko)/2 I - Ko
    by quaternion   V = g(eta) eps^T Ko eps, (eta, eps) the unit quaternion of R0^T R with eta >= 0
    coupling        V = d^T K12 sigma, sigma the axis of R0^T R times the sine of its angle
    bounded         U = 2 V/(1 + rho), rho = sqrt(1 + 2 V kappa/limit^2), of a part V with the largest stiffness kappa
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from stiffgen.core.symbolic.kinematics import Section
from stiffgen.core.symbolic.placement import Axes
from stiffgen.core.symbolic.stiffness import symmetric_from_upper

Centre = tuple[float, float, float]


@dataclass(frozen=True)
class Terms:
    """Energy V, wrench F (6) and covariant Hessian K (6x6) in hybrid axes, with the sections of their computation."""

    V: ca.SX
    F: ca.SX
    K: ca.SX
    sections: tuple[Section, ...] = ()

    def __add__(self, other: Terms) -> Terms:
        return Terms(self.V + other.V, self.F + other.F, self.K + other.K, self.sections + other.sections)

    def of_tip(self, index: int) -> Terms:
        """Return the terms with names that are unique among the tips: "e" becomes "e_1_" for the tip with index 1."""
        sections = tuple(
            replace(each, values={f"{name}_{index}_": value for name, value in each.values.items()})
            for each in self.sections
        )
        return replace(self, sections=sections)


def _axial(matrix: ca.SX) -> ca.SX:
    """Return the vector a of A - A^T = [a]."""
    return ca.vertcat(matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])


def _symmetric(matrix: ca.SX) -> ca.SX:
    return 0.5 * (matrix + matrix.T)


def other_two(matrix: ca.SX, k: int) -> ca.SX:
    """Return tr(A) - A_kk of a matrix (3x3), in which A_kk cancels: the sum of the other two diagonal entries."""
    i, j = (k + 1) % 3, (k + 2) % 3
    return matrix[i, i] + matrix[j, j]


def _blocks(force: ca.SX, moment: ca.SX, vv: ca.SX, vw: ca.SX, ww: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return wrench and Hessian from their blocks."""
    return ca.vertcat(force, moment), ca.vertcat(ca.horzcat(vv, vw), ca.horzcat(vw.T, ww))


@dataclass(frozen=True)
class Displacement:
    """Displacement of the centre of stiffness from the equilibrium, and its first derivative.

    Attributes:
        d: displacement [m] in the axes X of the stiffness; X d' = v + w x arm for a twist (v, w).
        X: axes of the stiffness, None for base axes.
        arm: see ``d`` [m]; None for no arm.
        bend: vector b with second derivative w x (w x b)/2 of X d; None for no arm.
        with_tip: whether X turns with the tip, which adds v x w to the second derivative.
        section: names of the displacement.

    """

    d: ca.SX
    X: ca.SX | None
    arm: ca.SX | None
    bend: ca.SX | None
    with_tip: bool
    section: Section

    @staticmethod
    def of(p: ca.SX, R: ca.SX, H: ca.SX, axes: Axes, centre: Centre) -> Displacement:
        """Return the displacement between a pose (p [m], R) and the equilibrium H (4x4), of the centre of stiffness
        if any.
        """
        p0, R0 = H[:3, 3], H[:3, :3]
        e, arm = p - p0, None  # arm: from the tip to the centre of stiffness, in base axes
        title, values = "displacement e of the tip, in base axes", {"e": e}
        if any(centre):
            c = ca.SX(ca.sparsify(ca.DM(centre)))
            D = R - R0
            e, arm = e + D @ c, R @ c
            title, values = "displacement e of the centre of stiffness, in base axes; D = R - R0", {"D": D, "e": e}
        if axes == "base":
            section = Section(title, values)
            return Displacement(d=e, X=None, arm=arm, bend=arm, with_tip=False, section=section)
        X = R if axes == "tip" else R0
        d = X.T @ e
        section = Section(f"{title}; d: in the {axes}'s axes", {**values, "d": d})
        if axes == "equilibrium":
            return Displacement(d=d, X=X, arm=arm, bend=arm, with_tip=False, section=section)
        # d = R^T e in axes that turn with the tip: R d' = v + w x arm - w x e.
        bend = e if arm is None else e - arm
        return Displacement(d=d, X=X, arm=-bend, bend=bend, with_tip=True, section=section)

    def in_base(self, vector: ca.SX) -> ca.SX:
        """Return a vector of the stiffness' axes in base axes."""
        return vector if self.X is None else self.X @ vector

    def terms(self, force: ca.SX, stiffness: ca.SX, V: ca.SX | None = None) -> Terms:
        """Return the terms of an energy V(d): its gradient ``force`` and Hessian ``stiffness``, in the axes of d.

        Without V, the energy is d . force/2. The chain rule with the derivatives of d (see the attributes) gives the
        moment arm x f, the coupling vw = -S [arm] and the rotational block ww; -[f] is added to vw for tip axes.
        """
        f, S = self.in_base(force), stiffness  # force [N] and stiffness [N/m] in base axes
        sections = [self.section]
        if self.X is None:
            sections.append(Section("force f", {"f": f}))
        else:
            XK = self.X @ stiffness
            S = symmetric_from_upper(XK @ self.X.T)
            sections += (
                Section("force: fd in the axes X of the stiffness, f in base axes", {"fd": force, "f": f}),
                Section("stiffness in base axes: S = XK X^T, XK = X Kt", {"XK": XK, "S": S}),
            )
        moment, vw, ww = ca.SX(3, 1), ca.SX(3, 3), ca.SX(3, 3)
        if self.arm is not None and self.bend is not None:
            arm, bend = ca.skew(self.arm), self.bend
            SA = S @ arm  # the spring's force per turn of the tip, without its sign
            products = {f"S{i}{j}_b{k}": S[i, j] * bend[k] for i in range(3) for j in range(i, 3) for k in range(3)}
            products |= {f"f{i}_b{k}": f[i] * bend[k] for i in range(3) for k in range(3)}
            sign = "-" if self.with_tip else ""
            sections += (
                Section(f"arm {sign}b of the force about the tip's origin", {"b": bend}),
                Section("products that several formulas share", products, shared=True),
                Section(f"SA = S [{sign}b]; f_b = f . b", {"SA": SA, "f_b": ca.dot(f, bend)}),
            )
            moment, vw = ca.cross(self.arm, f), -SA
            # f . (w x (w x b))/2 as a quadratic form of w: sym(f b^T) - (f . b) I
            ww = arm @ vw + _symmetric(f @ bend.T)
            for k in range(3):
                ww[k, k] -= ca.dot(f, bend)
            if self.with_tip:
                vw -= ca.skew(f)
        work = ca.dot(self.d, force)
        sections.append(Section("twice the energy", {"twice_V": work}, shared=True))
        V = 0.5 * work if V is None else V
        return Terms(V, *_blocks(f, moment, S, vw, ww), tuple(sections))


def translation(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, axes: Axes, centre: Centre) -> Terms:
    """Return the terms of V = d^T Kt d/2."""
    displacement = Displacement.of(p, R, H, axes, centre)
    d = displacement.d
    return displacement.terms(Kt @ d, Kt)


def trace_form(R: ca.SX, H: ca.SX, Ko: ca.SX, axes: Axes) -> Terms:
    """Return the terms of V = tr(D G D^T)/2 with D = R - R0; neither cancels near the equilibrium.

    For a stiffness in base axes, R0^T multiplies R and R0 from the right: N = R R0^T stands for R, and 1 for R0.
    """
    R0 = H[:3, :3]
    D = R - R0
    if axes != "base":
        return _trace_form(R, R0, D, Ko, rotation="R", difference="D = R - R0", product="L R0^T")
    N, DN = R @ R0.T, D @ R0.T
    turned = Section("D = R - R0, rotation N = R R0^T from the equilibrium", {"D": D, "N": N})
    part = _trace_form(N, ca.SX.eye(3), DN, Ko, rotation="N", difference="DN = D R0^T", product="L")
    return replace(part, sections=(turned, *part.sections))


def _trace_form(R: ca.SX, R0: ca.SX, D: ca.SX, Ko: ca.SX, *, rotation: str, difference: str, product: str) -> Terms:
    """Return the terms of V = tr(D G D^T)/2 for D = R - R0, which the caller has computed without cancellation.

    The texts are for the sections: name of R, name of D and its formula, formula of P.
    """
    name = difference.split()[0]
    half_trace = 0.5 * ca.trace(Ko)
    G = half_trace * ca.SX.eye(3) - Ko
    W, L = D @ G, R @ G
    Y, P = W @ R.T, L @ R0.T
    work = sum((ca.dot(D[row, :], W[row, :]) for row in range(3)), ca.SX(0))
    sections = (
        Section(
            f"{difference}; G = tr(Ko)/2 I - Ko, its diagonal",
            {name: D, "half_trace": half_trace, "G": ca.diag(G)},
        ),
        Section(f"gradient W = {name} G with respect to {rotation}; Y = W {rotation}^T; moment: Y - Y^T",
                {"W": W, "Y": Y}),
        Section(f"P = {product}, L = {rotation} G; covariant Hessian: tr(P) I - (P + P^T)/2", {"L": L, "P": P}),
        Section("twice the energy", {"twice_Vo": work}, shared=True),
    )  # fmt: skip
    V = 0.5 * work
    hessian = -_symmetric(P)  # tr(P) I - sym(P)
    for k in range(3):
        hessian[k, k] = other_two(P, k)
    zero = ca.SX(3, 3)
    F, K = _blocks(ca.SX(3, 1), _axial(Y), zero, zero, hessian)
    return Terms(V, F, K, sections)


def _outer(a: ca.SX, b: ca.SX) -> ca.SX:
    return a @ b.T


def _quaternion(R: ca.SX, R0: ca.SX) -> tuple[ca.SX, ca.SX, tuple[Section, ...]]:
    """Return the unit quaternion (eta, eps) of R0^T R with eta >= 0, and its sections.

    The products 4 (eta, eps) (eta, eps)^T are linear in R0^T R; the row with the largest of the four squares keeps all
    digits up to the cut locus. eta eps comes from R - R0, since R0^T R - R^T R0 cancels near the equilibrium.
    """
    E = R0.T @ R
    D = R0.T @ (R - R0)
    # 4 times the products of (w, x, y, z): first those of two components, then the squares
    wx, wy, wz = ca.vertsplit(_axial(D))
    xy, xz, yz = E[0, 1] + E[1, 0], E[0, 2] + E[2, 0], E[1, 2] + E[2, 1]
    one_plus, one_minus = 1 + E[0, 0], 1 - E[0, 0]
    ww, xx = one_plus + E[1, 1] + E[2, 2], one_plus - E[1, 1] - E[2, 2]
    yy, zz = one_minus + E[1, 1] - E[2, 2], one_minus - E[1, 1] + E[2, 2]
    products = (ww, wx, wy, wz), (wx, xx, xy, xz), (wy, xy, yy, yz), (wz, xz, yz, zz)
    rows = [ca.vertcat(*each) for each in products]
    # branches of a tournament: the better one of w and x, of y and z, and of both
    x_first, z_first, yz_first = ww < xx, yy < zz, ca.fmax(ww, xx) < ca.fmax(yy, zz)
    row = ca.if_else(yz_first, ca.if_else(z_first, rows[3], rows[2]), ca.if_else(x_first, rows[1], rows[0]))
    is_negative = row[0] < 0
    # the row is the quaternion times 4 times one of its components; the sign makes eta >= 0
    length = ca.if_else(is_negative, -1, 1) * ca.sqrt(ca.dot(row, row))
    unit = row / length
    diagonal = {f"E{k}{k}": E[k, k] for k in range(3)}
    squares = {
        "one_plus": one_plus, "one_minus": one_minus, "ww": ww, "xx": xx, "yy": yy, "zz": zz,
        "wx": wx, "wy": wy, "wz": wz, "xy": xy, "xz": xz, "yz": yz,
    }  # fmt: skip
    choices = {"x_first": x_first, "z_first": z_first, "yz_first": yz_first}
    choices |= {f"not_{name}": ca.logic_not(flag) for name, flag in choices.items()}
    return (
        unit[0],
        unit[1:],
        (
            Section("E = R0^T R: rotation from the equilibrium; D = R - R0", {"D": R - R0, **diagonal}),
            Section("4 times the products of the quaternion's components (w, x, y, z)", squares),
            Section("choice of the row with the largest square; the row, and its length with the sign of w",
                    {**choices, "row": row, "negative": is_negative, "length": length}),
            Section("unit quaternion (eta, eps) of E, eta >= 0", {"eta": unit[0], "eps": unit[1:]}),
        ),
    )  # fmt: skip


Factor = Callable[[ca.SX], tuple[ca.SX, ca.SX, ca.SX, dict[str, ca.SX]]]
"""Function of eta: factor g of the energy g eps^T Ko eps, its first and second derivative, names of what they take."""


def quaternion_factor(eta: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, dict[str, ca.SX]]:
    """Return g = 4/(1 + eta) and its derivatives."""
    plus = 1 + eta
    g = 4 / plus
    fall = g / plus
    bend = 2 * fall / plus
    return g, -fall, bend, {"one_plus_eta": plus, "g": g, "fall": fall, "ddg": bend}


_SERIES = (1.0, 1 / 6, 3 / 40, 15 / 336)
"""Coefficients c_k of asin(x)/x in powers of x^2: (2k)!/(4^k k!^2 (2k + 1))."""
_SERIES_BOUND = 1e-4
"""Bound on x^2 below which the series replaces the closed form.

At the bound the first term left out is below 1e-17 of the half angle's ratio. The closed form of the second derivative
loses the digits of 1/x^2 twice, but multiplies eps^T Ko eps, which is of the order of x^2, and eps eps^T.
"""


def _polynomial(coefficients: Sequence[float], x: ca.SX) -> ca.SX:
    """Return c_0 + c_1 x + c_2 x^2 + ..., by Horner's scheme."""
    value = ca.SX(0)
    for coefficient in reversed(coefficients):
        value = value * x + coefficient
    return value


def rotation_vector_factor(eta: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, dict[str, ca.SX]]:
    """Return g = 2 h^2 and its derivatives, h = acos(eta)/sqrt(1 - eta^2) the half angle divided by its sine.

    From (1 - eta^2) h' = eta h - 1 follows (1 - eta^2) h'' = h + 3 eta h'. Near eta = 1, h is a series s in x =
    1 - eta^2, whose derivatives with respect to eta are h' = -2 eta s'(x) and h'' = 4 eta^2 s''(x) - 2 s'(x).
    """
    square = 1 - eta * eta
    is_near = square < _SERIES_BOUND
    away = ca.if_else(is_near, 1, square)  # 1 avoids a division by zero where the series applies
    sine = ca.sqrt(away)
    far = 2 * ca.atan(sine / (1 + eta)) / sine
    far_first = (eta * far - 1) / away
    far_second = (far + 3 * eta * far_first) / away
    near = _polynomial(_SERIES, square)
    slope = _polynomial([k * c for k, c in enumerate(_SERIES)][1:], square)
    bend = _polynomial([k * (k - 1) * c for k, c in enumerate(_SERIES)][2:], square)
    h = ca.if_else(is_near, near, far)
    first = ca.if_else(is_near, -2 * eta * slope, far_first)
    second = ca.if_else(is_near, 4 * eta * eta * bend - 2 * slope, far_second)
    names = {
        "sin_square": square, "is_near": is_near, "is_far": ca.logic_not(is_near), "divisor": away, "sin_half": sine,
        "h_far": far, "dh_far": far_first, "series_slope": slope, "h": h, "dh": first, "ddh": second,
    }  # fmt: skip
    g, dg, ddg = 2 * h * h, 4 * h * first, 4 * (first * first + h * second)
    return g, dg, ddg, names | {"g": g, "dg": dg, "ddg": ddg}


def by_quaternion(R: ca.SX, H: ca.SX, Ko: ca.SX, axes: Axes, factor: Factor, meaning: str) -> Terms:
    """Return the terms of V = g(eta) eps^T Ko eps.

    A rotation by y in the axes X of eps changes (eta, eps) by (-eps . y, eta y + y x eps)/2 - |y|^2/8 (eta, eps).
    Inserted into V, with k = Ko eps, form = eps . k, n = eta k + eps x k and T = eta I - [eps], the terms of each order
    in y give the moment m and the Hessian:

        V(y) = V + m . y + y . hess y / 2
        m    = g n - down eps
        hess = bent eps eps^T - g' sym(eps n^T) + g/2 T^T Ko T - across I

    where down = form g'/2, bent = form g''/4 and across = form (eta g' + 2 g)/4.
    """
    eta, eps, sections = _quaternion(R, H[:3, :3])
    X = H[:3, :3]
    if axes == "base":
        eps = X @ eps
        sections += (Section("eps in base axes", {"epsb": eps}),)
    g, dg, ddg, names = factor(eta)
    k = Ko @ eps
    form = ca.dot(eps, k)
    n = eta * k + ca.cross(eps, k)
    T = eta * ca.SX.eye(3) - ca.skew(eps)  # twice the derivative of eps with respect to y
    KT = Ko @ T
    Z = symmetric_from_upper(T.T @ KT)
    down, quarter, half_g = 0.5 * form * dg, 0.25 * form, 0.5 * g
    across, bent = quarter * (eta * dg + 2 * g), quarter * ddg
    moment = g * n - down * eps
    hessian = bent * _outer(eps, eps) - dg * _symmetric(_outer(eps, n)) + half_g * Z - across * ca.SX.eye(3)
    hessian = symmetric_from_upper(hessian)
    products = {f"Ko{i}{j}_eps{k}": Ko[i, j] * eps[k] for i in range(3) for j in range(i, 3) for k in range(3)}
    products |= {f"Ko{i}{j}_eta": Ko[i, j] * eta for i in range(3) for j in range(i, 3)}
    last = {"KT": KT, "Z": Z, "bent": bent, "half_g": half_g, "across": across, "hess": hessian}
    title = "hess: covariant Hessian in the axes of eps, with Z = T^T KT, KT = Ko T, T = eta I - [eps]"
    first = {"m": moment}
    if axes != "base":
        turned = X @ hessian
        last["Xhess"] = turned
        moment, hessian = X @ moment, turned @ X.T
        title += "; Xhess = R0 hess"
    sections += (
        Section("products that several formulas share", products, shared=True),
        Section(meaning, names),
        Section("k = Ko eps, form = eps . k, n = eta k + eps x k", {"k": k, "form": form, "n": n}),
        Section("down = form dg/2, a quarter of form", {"down": down, "quarter_form": quarter}, shared=True),
        Section("moment m = g n - down eps, in the axes of eps", first),
        Section(title, last),
    )
    zero = ca.SX(3, 3)
    return Terms(g * form, *_blocks(ca.SX(3, 1), moment, zero, zero, hessian), sections)


def coupled(p: ca.SX, R: ca.SX, H: ca.SX, K: ca.SX, axes: tuple[Axes, Axes], centre: Centre) -> Terms:
    """Return the terms of d^T K11 d/2 + d^T K12 sigma and the trace form of K22; axes of translation and rotation.

    With Y the rotational axes in the base, Y sigma is the axial vector of N/2, N = R R0^T. Its derivative with respect
    to w is M = (tr(N) I - N)/2. The middle term therefore has the force K12 sigma (with that of K11) and the moment
    M^T Y K12^T d; without K12 the other two are a translation and a trace form.
    """
    translation_axes, rotation_axes = axes
    K11, K12, K22 = K[:3, :3], K[:3, 3:], K[3:, 3:]
    displacement, R0 = Displacement.of(p, R, H, translation_axes, centre), H[:3, :3]
    d, X = displacement.d, displacement.X
    sine = 0.5 * _axial(R0.T @ (R - R0))  # in the equilibrium's axes
    Y, sigma, turn = R0, sine, dict[str, ca.SX]()
    if rotation_axes == "base":
        Y, sigma, turn = ca.SX.eye(3), R0 @ sine, {"turn": sine}
    # forces [N] of the displacement and of the turn, moment [N m] of the displacement
    Kl, Ks, Kd = K11 @ d, K12 @ sigma, K12.T @ d
    linear = displacement.terms(Kl + Ks, K11, ca.dot(d, 0.5 * Kl + Ks))
    turning = trace_form(R, H, K22, rotation_axes)
    N = R @ R0.T
    M = -0.5 * N
    for k in range(3):
        M[k, k] = 0.5 * other_two(N, k)
    XK, pull = (ca.SX.eye(3) if X is None else X) @ K12, Y @ Kd  # rows of K12 and the moment K12^T d in base axes
    C = XK @ Y.T
    CM = C @ M
    # second derivative of the middle term with respect to the rotation: that of a trace form with [-pull]
    bend = N @ ca.skew(-pull)
    ww = 0.5 * _symmetric(bend)
    for k in range(3):
        ww[k, k] = -0.5 * other_two(bend, k)
    if displacement.arm is not None:
        ww += 2 * _symmetric(ca.skew(displacement.arm) @ CM)
    F, K6 = _blocks(ca.SX(3, 1), M.T @ pull, ca.SX(3, 3), CM, ww)
    sections = (
        linear.sections[0],
        *turning.sections,
        Section("sigma: axis of R0^T R times the sine of its angle, in the axes of K22", {**turn, "sigma": sigma}),
        Section("Kl = K11 d, Ks = K12 sigma, Kd = K12^T d", {"Kl": Kl, "Ks": Ks, "Kd": Kd}),
        *linear.sections[1:],
        Section(
            "N = R R0^T, derivative M = (tr(N) I - N)/2 of sigma; Kd in base axes (pull)",
            {"N": N, "half_N": 0.5 * N, "M": M, "pull": pull},
        ),
        Section(
            "C = XC Y^T: K12 in base axes, XC = X K12; CM = C M; Np = N [-pull]",
            {"XC": XK, "C": C, "CM": CM, "Np": bend},
        ),
    )
    return replace(linear + turning + Terms(ca.SX(0), F, K6), sections=sections)


def bounded(part: Terms, stiffness: ca.SX, limit: ca.SX, suffix: str) -> Terms:
    """Return the terms of U = 2 V/(1 + rho), rho = sqrt(1 + 2 soft V), soft = kappa/limit^2.

    From rho^2 = 1 + 2 soft V follows d rho = soft dV/rho, so that

        dU = dV/rho        d2U = d2V/rho - soft/rho dU dU^T

    No force or moment is larger than the limit: |dV|^2 <= 2 kappa V, kappa at least the largest eigenvalue of the
    stiffness. kappa is the largest sum of absolute values in a row, which is the largest eigenvalue of a diagonal
    stiffness. ``suffix`` ends the names in C.
    """
    sizes = ca.fabs(stiffness)
    row_sums = [sum((sizes[i, j] for j in range(3)), ca.SX(0)) for i in range(3)]
    kappa = ca.fmax(ca.fmax(row_sums[0], row_sums[1]), row_sums[2])
    soft = kappa / (limit * limit)
    rho = ca.sqrt(1 + 2 * soft * part.V)
    F = part.F / rho
    bent = soft / rho
    t = suffix
    energy = {f"V{t}": part.V, f"size{t}": sizes, f"kappa{t}": kappa, f"soft{t}": soft, f"rho{t}": rho}
    sections = (
        Section(f"V{t}: energy without limit; kappa{t} >= eigenvalues; soft{t} = kappa{t}/limit^2; rho{t}", energy),
        Section(f"F{t}: wrench of V{t} divided by rho{t}; bent{t} = soft{t}/rho{t}", {f"F{t}": F, f"bent{t}": bent}),
    )
    K = part.K / rho - bent * _outer(F, F)
    return Terms(2 * part.V / (1 + rho), F, K, part.sections + sections)
