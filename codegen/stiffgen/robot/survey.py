# SPDX-License-Identifier: MIT
"""Survey of the chain to a tip, for ``stiffgen inspect``: its coordinates, and the joints that it leaves out."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stiffgen.errors import DescriptionError, StiffgenError, listed
from stiffgen.robot.chain import ChainOptions
from stiffgen.robot.description import MOVING_TYPES, Description, JointElement
from stiffgen.robot.selection import Selection, carried_links, select


@dataclass(frozen=True)
class TipSurvey:
    """Tip, base of the longest chain to it, and joints that are the chain's coordinates (q).

    ``left_out`` names the robot's other joints by what becomes of them. ``hindrance`` says what refuses the chain, or
    its mass matrix alone (then there are ``coordinates``). If ``floating``, a floating joint of the file holds the
    base, and the six coordinates of its twist come before q.
    """

    tip: str
    base: str
    coordinates: tuple[str, ...] = ()
    left_out: tuple[tuple[str, tuple[str, ...]], ...] = ()
    hindrance: str = ""
    floating: bool = False


def survey_tip(description: Description, tip: str, base: str | None = None) -> TipSurvey:
    """Return the survey of the chain to a tip from ``base``, by default from the link nearest the root.

    Raises:
        ChainError: no such tip or base.

    """
    for link, names in ((tip, description.links), (base, description.links)):
        if link is not None and link not in names:
            select(description, ChainOptions(tip=tip, base=base))  # says it
    above = _joints_above(description, tip)
    floats = False
    if base is None:
        held = [joint for joint in above if joint.type != "fixed"]
        free = [joint for joint in held if joint.type not in MOVING_TYPES]
        base = free[-1].child if free else description.root
        # What `generate` takes where no base is named: a floating joint with nothing that moves before it.
        floats = bool(free) and free[-1].type == "floating" and held[0] is free[-1]
    options, hindrance = ChainOptions(tip=tip, base=None if floats else base), ""
    try:
        selection = select(description, options)
    except DescriptionError as error:
        try:
            selection = select(description, replace(options, masses=False))
        except StiffgenError:
            return TipSurvey(tip, base, hindrance=f"refused: {listed(error.problems, 2)}")
        hindrance = f"only with --no-masses: {listed(error.problems, 2)}"
    except StiffgenError as error:
        still = not any(joint.type in MOVING_TYPES for joint in above)
        said = "no moving joint" if still else str(error).removeprefix(f"{description.file}: ")
        return TipSurvey(tip, base, hindrance=said)
    left_out = tuple(_left_out(description, selection))
    return TipSurvey(tip, base, selection.masters, left_out, hindrance, selection.floating)


def _joints_above(description: Description, link: str) -> list[JointElement]:
    above, parents = [], description.parent_joint
    while link in parents:
        above.append(parents[link])
        link = parents[link].parent
    return above[::-1]


def _left_out(description: Description, selection: Selection) -> list[tuple[str, tuple[str, ...]]]:
    before = _joints_above(description, selection.base)
    floating = selection.base if selection.floating else None
    carried = carried_links(description, (*selection.moving, *selection.side), floating).values()
    riding = {above.name for links in carried for _, above in links if above}
    own = {joint.name for joint in (*selection.moving, *selection.side, *before)} | set(selection.masters)
    others = [
        joint.name
        for joint in description.joints.values()
        if joint.type != "fixed" and joint.mimic is None and joint.name not in own
    ]
    groups = {
        "above the base, floating": [joint.name for joint in before if joint.type == "floating" and not floating],
        "above the base, planar": [joint.name for joint in before if joint.type == "planar"],
        "above the base": [joint.name for joint in before if joint.type in MOVING_TYPES],
        "rides along, held at zero": [name for name in others if name in riding],
        "on other limbs": [name for name in others if name not in riding],
    }
    return [(what, tuple(names)) for what, names in groups.items() if names]
