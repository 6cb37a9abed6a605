# SPDX-License-Identifier: MIT
"""The page of a passport: findings, the map, one table of quantities, and the worst postures by their joints."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from stiffgen.control.presets import Preset
from stiffgen.core.errors import listed
from stiffgen.core.rendering import environment
from stiffgen.lab.page import POLICY, STYLE
from stiffgen.lab.passport.loop import POSTURE_STIFFNESS
from stiffgen.lab.passport.passport import Passport, Quantity
from stiffgen.lab.passport.picture import draw_map

_POORLY_DAMPED = 0.2
"""Damping ratio below which the page warns."""
HEAD = ("quantity", "unit", "worst", "median", "best", "meaning", "verified against")


def render_page(passport: Passport, motors: Preset, csv: str) -> str:
    """Return the page: one file without scripts, for light and dark.

    Args:
        passport: to show.
        motors: with the sources of its inertias and torque rates.
        csv: name of the file with all postures.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    return (
        environment("stiffgen.lab.passport", escaped=True)
        .get_template("passport.html.j2")
        .render(
            passport=passport,
            statements=statements(passport),
            warnings=warnings(passport),
            head=HEAD,
            table=[_row(each) for each in passport.quantities],
            worst=_worst_postures(passport),
            motors=motors,
            posture_stiffness=f"{POSTURE_STIFFNESS:g}",
            csv=csv,
            map=Markup(draw_map(passport)),
            policy=POLICY,
            style=Markup(STYLE),
        )
    )


def statements(passport: Passport) -> list[str]:
    """Return the findings in sentences."""
    rendered, limit = passport["rendered"], passport["limit"]
    lines = [
        f"The controller renders {_number(rendered.min())} N/m in full in every posture "
        f"(median {_number(float(np.median(rendered)))} N/m), at {passport.timing.text}.",
        f"The loop itself stays passive and stable up to {_number(limit.min())} N/m in every posture, "
        f"{limit.min() / rendered.min():.1f} times as much.",
        f"At the rendered stiffness the least damped mode keeps a damping ratio of {passport['damping'].min():.2f}.",
    ]
    named = {each.name: each for each in passport.quantities}
    if passport.force is not None:
        half = _number(float(np.median(passport.force.min(axis=1))))
        lines.append(f"Half of the postures can exert {half} N in every direction, beside gravity.")
    if passport.unlimited:
        which = f"{'joint' if len(passport.unlimited) == 1 else 'joints'} {listed(passport.unlimited, 8)}"
        result = "no force limit follows" if passport.force is None else "the forces leave them out"
        lines.append(f"The robot's file states no effort limit of {which}: {result}.")
    if "lost to gears" in named:
        lines.append(f"Elastic gears take up to {named['lost to gears'].values.max():.0f} % of the rendered stiffness.")
    if "rest error" in named:
        rest, force = (named[name].values for name in ("rest error", "force error"))
        lines.append(
            f"Friction leaves the tip at most {_number(rest.max())} mm (median {_number(float(np.median(rest)))}) off "
            f"at rest, and its force on a wall {_number(force.max())} N ({_number(float(np.median(force)))})."
        )
    if "buckling" in named:
        lines.append(f"By its joint gains the arm holds {_number(named['buckling'].values.min())} N in every posture.")
    return lines


def warnings(passport: Passport) -> list[str]:
    """Return what somebody who reads only the findings must know; empty if there is nothing."""
    lines, count = [], len(passport.q)
    unstable = int((passport["limit"] < passport["rendered"]).sum())
    if unstable:
        lines.append(
            f"In {unstable} of {count} postures the loop is not stable or passive at the stiffness that the controller "
            f"renders. Stay below the limit, {_number(passport['limit'].min())} N/m."
        )
    elif passport["damping"].min() < _POORLY_DAMPED:
        lines.append(
            f"The damping ratio falls to {passport['damping'].min():.2f} at the rendered stiffness. Choose a softer "
            "spring or a measured velocity."
        )
    fallen = 0 if passport.force is None else int((passport.force.max(axis=1) <= 0).sum())
    if fallen:
        lines.append(f"In {fallen} of {count} postures the motors cannot hold the arm against gravity.")
    return lines


def _number(value: float) -> str:
    """Return a number with three digits, and with spaces between thousands."""
    if not np.isfinite(value):
        return "none"
    if abs(value) < 100:
        return f"{value:.3g}"
    digits = int(np.floor(np.log10(abs(value))))
    return f"{round(value, 2 - digits):,.0f}".replace(",", " ")


def _row(quantity: Quantity) -> tuple[str, ...]:
    """Return the cells of a quantity, in the columns of HEAD."""
    values = quantity.values
    worst = values[quantity.worst]
    best = values.min() if worst == values.max() else values.max()
    numbers = (float(worst), float(np.median(values)), float(best))
    return (quantity.name, quantity.unit, *map(_number, numbers), quantity.meaning, quantity.verified)


def _worst_postures(passport: Passport) -> list[tuple[str, list[str]]]:
    """Return the postures that are worst in something: the quantities' names, and the joint positions."""
    named: dict[int, list[str]] = {}
    for each in passport.quantities:
        named.setdefault(each.worst, []).append(each.name)
    return [(", ".join(names), [f"{value:.3f}" for value in passport.q[k]]) for k, names in named.items()]
