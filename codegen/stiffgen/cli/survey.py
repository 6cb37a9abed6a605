# SPDX-License-Identifier: MIT
"""Survey of a robot's file for the user: chains to tips, joints outside of them, and limits that joints lack."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from stiffgen.core.errors import DescriptionError, StiffgenError, listed, printable
from stiffgen.core.loading import kept_limits
from stiffgen.core.robot.chain import ChainOptions, Coordinate
from stiffgen.core.robot.couplings import Couplings
from stiffgen.core.robot.description import MOVING_TYPES, Description, JointElement
from stiffgen.core.robot.selection import Selection, carried_links, select


@dataclass(frozen=True)
class TipSurvey:
    """Tip, base of the longest chain to the tip, and joints that are the chain's coordinates (q).

    ``left_out`` groups the robot's other joints by their role. ``hindrance`` tells why the chain is rejected, or (if
    there are ``coordinates``) why only its mass matrix is. If ``floating``, a floating joint of the file is the parent
    of the base, and the six coordinates of the base's twist come before q.
    """

    tip: str
    base: str
    coordinates: tuple[str, ...] = ()
    left_out: tuple[tuple[str, tuple[str, ...]], ...] = ()
    hindrance: str = ""
    floating: bool = False


def survey_tip(description: Description, tip: str, base: str | None = None, masses: bool = True) -> TipSurvey:
    """Return the survey of the chain from ``base`` (default: the link nearest the root) to a tip.

    Raises:
        ChainError: the tip or base does not exist.

    """
    for link, names in ((tip, description.links), (base, description.links)):
        if link is not None and link not in names:
            select(description, ChainOptions(tip=tip, base=base))  # raises ChainError
    above, floats = _joints_above(description, tip), False
    if base is None:
        base, floats = _nearest_base(description, above)
    options, hindrance = ChainOptions(tip=tip, base=None if floats else base, masses=masses), ""
    try:
        selection = select(description, options)
    except DescriptionError as error:
        try:
            selection = select(description, replace(options, masses=False))
        except StiffgenError:
            return TipSurvey(tip, base, hindrance=f"refused: {_first(error.problems)}")
        hindrance = f"only with --no-masses: {_first(error.problems)}"
    except StiffgenError as error:
        moves = any(joint.type in MOVING_TYPES for joint in above)
        reason = str(error).removeprefix(f"{description.file}: ") if moves else "no moving joint"
        return TipSurvey(tip, base, hindrance=reason)
    left_out = tuple(_left_out(description, selection))
    return TipSurvey(tip, base, selection.masters, left_out, hindrance, selection.floating)


_NEEDED = {
    "velocity": ("", "velocity_limit and reference_velocity_limit"),
    "effort": ("actuatorfrcrange", "effort_limit, torque_rate_limit and limit_stiffness"),
}
"""Limits of a joint that the impedance controller needs: attribute of MJCF, and the fields that follow from each."""


def missing_limits(
    file: str, joints: Iterable[JointElement | Coordinate], guesses: str = "", *, is_mjcf: bool = False
) -> list[str]:
    """Return a sentence for each limit that joints lack and the impedance controller needs, with the remedy.

    Args:
        file: name of the robot's file.
        joints: coordinates of the controller.
        guesses: file of a project that has guesses in place of the limits; else the remedy is the configuration.
        is_mjcf: whether the file is an MJCF file, which has no <limit>.

    """
    joints = list(joints)
    sentences = []
    for limit, (in_mjcf, fields) in _NEEDED.items():
        names = [joint.name for joint in joints if not math.isfinite(getattr(joint, limit))]
        if names:
            remedy = f"replace the guesses in {guesses}" if guesses else f"set {fields} of its configuration"
            which = f"{'joint' if len(names) == 1 else 'joints'} {listed(names)}"
            if not is_mjcf:
                place = f'add {limit}="..." to the <limit> of {which} or {remedy}'
            elif in_mjcf:
                place = f'add {in_mjcf}="..." to {which}, or {remedy}'
            else:
                place = f"MJCF has none: {remedy} for {which}"
            sentences.append(f"{file}: no {limit} limit, which the impedance controller needs: {place}")
    return sentences


def narrowed_limits(description: Description, coordinates: Iterable[JointElement]) -> Iterator[str]:
    """Yield a sentence for each coordinate that joints which follow it narrow (:meth:`Couplings.limited`)."""
    couplings = Couplings(description, {})
    for limited in coordinates:
        fault = couplings.exclusion(description.joints[limited.name])
        if fault:
            yield kept_limits(limited, fault)
        if limited != description.joints[limited.name]:
            names = listed([each.name for each in couplings.followers(limited)], 4)
            bounds = {
                key: getattr(limited, key) for key in ("velocity", "effort", "acceleration", "deceleration", "jerk")
            }
            shown = [f"{key} {bound:g}" for key, bound in bounds.items() if math.isfinite(bound)]
            if not fault:
                shown.insert(0, f"position {limited.lower:g} to {limited.upper:g}")
            yield (
                f"joint '{printable(limited.name)}', with the limits of joints that follow it ({names}): "
                f"{', '.join(shown)}"
            )


def _first(problems: Sequence[str]) -> str:
    """Return the first problem with its remedy, and how many more there are."""
    return printable(problems[0], 4000) + (f" (and {len(problems) - 1} more)" if len(problems) > 1 else "")


def _joints_above(description: Description, link: str) -> list[JointElement]:
    """Return the joints from the root to a link."""
    above, parents = [], description.parent_joint
    while link in parents:
        above.append(parents[link])
        link = parents[link].parent
    return above[::-1]


def _nearest_base(description: Description, above: Sequence[JointElement]) -> tuple[str, bool]:
    """Return the base nearest the root from which all joints to a tip have coordinates, and whether it floats.

    As `generate` without --base: a floating joint frees the base if no joint before it moves.
    """
    movable = [joint for joint in above if joint.type != "fixed"]
    free = [joint for joint in movable if joint.type not in MOVING_TYPES]
    if not free:
        return description.root, False
    return free[-1].child, free[-1].type == "floating" and movable[0] is free[-1]


def _above_the_base(before: Iterable[JointElement], *, is_free: bool) -> dict[str, list[str]]:
    """Return the names of the joints above the base by their role; the floating joint of a free base has none."""
    groups: dict[str, list[str]] = {"above the base, floating": [], "above the base, planar": [], "above the base": []}
    for joint in before:
        role = "above the base" if joint.type in MOVING_TYPES else f"above the base, {joint.type}"
        if role in groups and not (joint.type == "floating" and is_free):
            groups[role].append(joint.name)
    return groups


def _left_out(description: Description, selection: Selection) -> list[tuple[str, tuple[str, ...]]]:
    """Return the names of the joints that are no coordinates of a selection, by their role."""
    before = _joints_above(description, selection.base)
    floating = selection.base if selection.floating else None
    carried = carried_links(description, (*selection.moving, *selection.side), floating).values()
    payload = {above.name for _, above in chain.from_iterable(carried) if above}
    known = {joint.name for joint in (*selection.moving, *selection.side, *before)} | set(selection.masters)
    others = [
        joint.name
        for joint in description.joints.values()
        if joint.type != "fixed" and joint.mimic is None and joint.name not in known
    ]
    groups = _above_the_base(before, is_free=selection.floating) | {
        "rides along, held at zero": [name for name in others if name in payload],
        "on other limbs": [name for name in others if name not in payload],
    }
    return [(role, tuple(names)) for role, names in groups.items() if names]
