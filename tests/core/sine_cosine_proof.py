# SPDX-License-Identifier: MIT
"""Prove bounds on the errors of the printed sine and cosine, in units of 2^-53.

The proof is about the text of templates/sine_cosine.c. It reads the constants there. It evaluates the statements of the
two polynomials and of the results as printed, in interval arithmetic (Arb), over small pieces of the reduced angle.
Every operation may be rounded or, as part of a fused multiply-add, not.

The steps, for angles |x| <= FAR:

1. k, the nearest integer to x 2/pi as computed, leaves |x - k pi/2| <= pi/4 + 2^-39 (the product and its constant are
   off by 2^-52 of at most 6367, the sum is rounded to an integer). turn = k/2 is exact.
2. The products of the first two parts of pi with the turn are exact: 39 and 13 bits.
3. r1 = x - turn pi_1 is exact. k = 0: r1 = x. Else |x| > 1/2: both are multiples of 2^-53 (of 2^-38), and |r1| < 1.
4. r2 + (first part of low) = r1 - w2 exactly: where |r1| >= |w2| by Dekker's theorem; else r1 - w2 is a multiple of
   2^-77 below 2^-24, so that r2 has it without rounding.
5. r + (second part of low) = r2 - w3 but for 2^-115, as |w3| < 2^-65.
6. So r + low = x - k pi/2 but for 2^-104 (the parts of pi, 2^-118; the sum of low, 2^-106), |low| <= 2^-53 |r| + 2^-64.
7. On pieces of [0, pi/4 + 2^-38], sine and cosine as polynomials of r are compared with those of r + low (Taylor's
   series, mean values), and the roundings of the statements are added up.
8. The exchange by k mod 4 and the signs are exact.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from flint import arb, ctx

_UNIT = arb(2) ** -53
_PIECES = 1024
_STEPS = 16
"""Length of a piece, for the error of the polynomials."""
STATEMENTS = (
    "const lanes z = r * r, z2 = z * z, z4 = z2 * z2;",
    "const lanes half = 0.5 * z;",
    "const lanes rest = whole(1.0 - half);",
    "s.number = r + (low + (z * r) * P);",
    "c.number = rest + ((whole(1.0 - rest) - half) + (z2 * Q - r * low));",
    "turns.number = x[n] * 0.6366197723675814 + round;",
    "halved.bits = turns.bits - 0x0010000000000000ULL;",
    "const lanes turn = halved.number - 0.5 * round;",
    "const lanes r1 = whole(x[n] - turn * pi_1);",
    "const lanes w2 = turn * pi_2;",
    "const lanes r2 = whole(r1 - w2);",
    "const lanes w3 = turn * pi_3;",
    "const lanes r = whole(r2 - w3);",
    "const lanes low = (whole(r1 - r2) - w2) + (whole(r2 - r) - w3);",
)
"""Statements that the proof covers; the text must contain them."""


class NotProvedError(Exception):
    """The text is not that of the proof, or a step of the proof fails."""


def _upper(x: arb) -> arb:
    return arb(abs(x).upper())


@dataclass(frozen=True)
class _Rounded:
    """Value without rounding, and bound on the error."""

    value: arb
    error: arb

    @staticmethod
    def of(x: _Rounded | float) -> _Rounded:
        return x if isinstance(x, _Rounded) else _Rounded(arb(x), arb(0))

    def _rounded(self) -> _Rounded:
        largest = _upper(self.value) + self.error
        half_ulp = _UNIT
        while half_ulp > arb(2) ** -200 and largest < half_ulp / _UNIT:  # half_ulp is right for [2^e, 2^(e+1))
            half_ulp /= 2
        return _Rounded(self.value, self.error + half_ulp)

    def __add__(self, other: _Rounded | float) -> _Rounded:
        y = _Rounded.of(other)
        return _Rounded(self.value + y.value, self.error + y.error)._rounded()

    def __sub__(self, other: _Rounded | float) -> _Rounded:
        y = _Rounded.of(other)
        return _Rounded(self.value - y.value, self.error + y.error)._rounded()

    def __rsub__(self, other: float) -> _Rounded:
        return _Rounded.of(other) - self

    def __mul__(self, other: _Rounded | float) -> _Rounded:
        y = _Rounded.of(other)
        error = _upper(self.value) * y.error + _upper(y.value) * self.error + self.error * y.error
        return _Rounded(self.value * y.value, error)._rounded()

    __rmul__ = __mul__
    __radd__ = __add__


def _statement(text: str, name: str) -> str:
    found = re.search(rf"const lanes {name} = ([^;]+);", text)
    if found is None:
        raise NotProvedError(f"no statement defines {name}")
    return " ".join(found[1].split())


def _number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    if found is None:
        raise NotProvedError(f"not found: {pattern}")
    return float(found[1])


def _check_reduction(text: str) -> None:
    """Check steps 1 to 6, as far as they depend on constants."""
    for statement in STATEMENTS:
        if statement not in " ".join(text.split()):
            raise NotProvedError(f"not found: {statement}")
    parts = [_number(rf"pi_{k} = ([^,;]+)[,;]", text) for k in (1, 2, 3)]
    largest = _number(r"#define FAR (\S+)", text)
    turns = largest * 0.6366197723675814 + 1  # 2/pi: multiples of pi/2 in the largest argument
    first, second, third = map(arb, parts)
    holds = {
        "the turn has 13 bits": turns < 2**13,
        "pi_1 has 39 bits": parts[0] * 2**37 == int(parts[0] * 2**37) < 2**39,
        "pi_2 has 39 bits, the last one 2^-76": parts[1] * 2**76 == int(parts[1] * 2**76) < 2**39,
        "the parts of pi": abs(arb.pi() - first - second - third) * turns / 2 < arb(2) ** -118,
        "w2 below 2^-25": second * turns / 2 < arb(2) ** -25,
        "w3 below 2^-65": third * turns / 2 < arb(2) ** -65,
        "the nearest integer": (turns + 1) * arb(2) ** -52 < arb(2) ** -39,
        "2/pi": abs(arb(0.6366197723675814) - 2 / arb.pi()) < arb(2) ** -53,
        "round": "const double round = 6755399441055744.0;" in text and 6755399441055744.0 == 1.5 * 2.0**52,
        "r1 below 1": arb.pi() / 4 + arb(2) ** -24 < 1,
    }
    if wrong := [step for step, true in holds.items() if not true]:
        raise NotProvedError("; ".join(wrong))


def _polynomial(text: str, name: str) -> list[arb]:
    """Return the exact coefficients of a printed polynomial in z, of degree 5, evaluated in real arithmetic."""
    expression = _statement(text, name)

    class Term:
        def __init__(self, c: list[arb]) -> None:
            self.c = c

        def _of(self, other: Term | float) -> list[arb]:
            return other.c if isinstance(other, Term) else [arb(other)] + [arb(0)] * 5

        def __add__(self, other: Term | float) -> Term:
            return Term([a + b for a, b in zip(self.c, self._of(other), strict=True)])

        def __sub__(self, other: Term | float) -> Term:
            return Term([a - b for a, b in zip(self.c, self._of(other), strict=True)])

        def __rsub__(self, other: float) -> Term:
            return Term([b - a for a, b in zip(self.c, self._of(other), strict=True)])

        def __mul__(self, other: Term | float) -> Term:
            b = self._of(other)
            return Term([sum((self.c[i] * b[k - i] for i in range(k + 1)), arb(0)) for k in range(6)])

    def power(k: int) -> Term:
        return Term([arb(int(i == k)) for i in range(6)])

    polynomial: Term = eval(expression, {"z": power(1), "z2": power(2), "z4": power(4)})
    return polynomial.c


def proved_units(text: str) -> tuple[arb, arb]:
    """Bounds of the errors of sine and cosine, in units of 2^-53, for angles up to FAR.

    Args:
        text: of templates/sine_cosine.c.

    Raises:
        NotProvedError: a step does not hold.

    """
    with ctx.workprec(160):
        return _proved_units(text)


def _proved_units(text: str) -> tuple[arb, arb]:
    """Return the proved largest errors of sine and cosine in units of 2^-53, by intervals over [0, pi/4]."""
    _check_reduction(text)
    P, Q = _polynomial(text, "P"), _polynomial(text, "Q")
    texts = {name: _statement(text, name) for name in ("P", "Q")}
    end = arb.pi() / 4 + arb(2) ** -38
    worst = [arb(0), arb(0)]
    for piece in range(_PIECES):
        a, b = end * piece / _PIECES, end * (piece + 1) / _PIECES
        r = a.union(b)
        reduced = arb(2) ** -104
        low = _upper(r) * _UNIT + arb(2) ** -64
        methods = _method(P, Q, a, b)
        # The statements.
        R, L = _Rounded(r, arb(0)), _Rounded((-low).union(low), arb(0))
        z = R * R
        z2 = z * z
        values = {"z": z, "z2": z2, "z4": z2 * z2}
        p, q = (eval(texts[name], dict(values)) for name in ("P", "Q"))
        sine = (R + (L + (z * R) * p)).error + methods[0] + low * _upper(1 - r.cos()) + low * low + reduced
        # half is exact but for z's error; 1 - half is rounded to rest, and (1 - rest) - half is that rounding, exactly
        # (Sterbenz, Dekker: rest > 1/2); what is added to rest is rounded, and so is the sum.
        lost = _Rounded((-_UNIT).union(_UNIT), arb(0))
        added = lost + (z2 * q - R * L)
        total = _Rounded(r.cos() + (-low).union(low), added.error + z.error / 2)._rounded()
        cosine = total.error + methods[1] + low * _upper(r - r.sin()) + low * low + reduced
        worst = [x.max(arb(y.upper())) for x, y in zip(worst, (sine / _UNIT, cosine / _UNIT), strict=True)]
    return worst[0], worst[1]


def _method(P: list[arb], Q: list[arb], a: arb, b: arb) -> tuple[arb, arb]:
    """Return bounds of |r + r^3 P(r^2) - sin r| and |1 - r^2/2 + r^4 Q(r^2) - cos r| between a and b."""
    sine = {3 + 2 * k: c for k, c in enumerate(P)} | {1: arb(1)}
    cosine = {4 + 2 * k: c for k, c in enumerate(Q)} | {0: arb(1), 2: arb(-1) / 2}
    errors = []
    for terms, first in ((sine, 1), (cosine, 0)):
        for k in range(first, 28, 2):
            terms[k] = terms.get(k, arb(0)) - (-1) ** (k // 2) / arb(k).fac()
        worst = arb(0)
        for step in range(_STEPS):
            x, y = a + (b - a) * step / _STEPS, a + (b - a) * (step + 1) / _STEPS
            middle, whole = (x + y) / 2, x.union(y)
            at = sum((c * middle**k for k, c in terms.items()), arb(0))
            rate = sum((k * c * whole ** (k - 1) for k, c in terms.items() if k), arb(0))
            worst = worst.max(_upper(at) + _upper(rate) * _upper((y - x) / 2))
        errors.append(worst + _upper(b) ** 28 / arb(28).fac())
    return errors[0], errors[1]
