# SPDX-License-Identifier: MIT
"""Elements of a URDF beside its kinematics: rotors of motors, which are used, and what the functions leave out."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping

from lxml import etree

from stiffgen.core.errors import counted, listed, printable
from stiffgen.core.robot.description import LARGEST, MOVING_TYPES

_LEFT_OUT = {"damping": "damping", "friction": "dry friction"}
_SOFT = ("soft_lower_limit", "soft_upper_limit")


def left_out(joints: Mapping[str, etree._Element], unread: Collection[str] = ()) -> Iterator[str]:
    """Yield what joints have and the functions do not contain: damping, friction, soft limits, ``unread`` limits."""
    moving = {name: joint for name, joint in joints.items() if joint.get("type") in MOVING_TYPES}
    for attribute, meaning in _LEFT_OUT.items():
        names = [name for name, joint in moving.items() if _number(joint.find("dynamics"), attribute)]
        if names:
            yield f"{_having(names)} {meaning}, which the functions do not contain: {listed(names, 8)}"
    for attribute in unread:
        limits = ((name, joint.find("limit")) for name, joint in moving.items())
        names = [name for name, limit in limits if limit is not None and limit.get(attribute) is not None]
        if names:
            yield f"{_having(names)} a limit of {attribute}, not read before URDF 1.2: {listed(names, 8)}"
    for name, joint in moving.items():
        yield from _soft_limits(name, joint.find("safety_controller"), joint.find("limit"))


def _soft_limits(name: str, soft: etree._Element | None, hard: etree._Element | None) -> Iterator[str]:
    """Yield a remark about soft limits that are not the limits themselves."""
    if soft is not None and any(soft.get(key) is not None for key in _SOFT):
        lower, upper = (_number(soft, key) for key in _SOFT)
        if hard is not None and (lower, upper) == (_number(hard, "lower"), _number(hard, "upper")):
            return
        yield (
            f"joint '{printable(name)}': soft limits {lower:g} to {upper:g} (safety_controller) are not used; set "
            "<limit>, or lower_limit and upper_limit of the controller's configuration"
        )


def rotor_inertias(robot: etree._Element, joints: Mapping[str, etree._Element]) -> tuple[dict[str, float], list[str]]:
    """Return the rotors' inertias, reflected to their joints, of Drake's elements in joints or transmissions.

    A rotor_inertia J [kg m^2] with a gear_ratio N (default 1) is J N^2 at the joint [kg m^2 or kg].

    Returns:
        Inertias by joint, and remarks: which are used, and which cannot be.

    """
    found: dict[str, float] = {}
    remarks: list[str] = []
    for rotor in robot.iter():
        if not _is_called(rotor, "rotor_inertia"):
            continue
        owner = rotor.getparent()
        gear = next((each for each in owner if _is_called(each, "gear_ratio")), None)
        words = rotor.get("value"), "1" if gear is None else gear.get("value")  # J [kg m^2] and N as text
        names = [name for name in _joints_of(owner) if name in joints]
        reflected = _reflected(*words)
        if reflected == 0:
            continue
        if reflected is None or not names:
            where = printable(f"{owner.tag} '{owner.get('name', '')}'")
            value = printable(f"{words[0]} with gear ratio {words[1]}")
            fault = "is not a number of at least 0" if reflected is None else "belongs to no single joint"
            remarks.append(f"{where}: the rotor inertia {value} {fault}, and is not used; correct it")
            continue
        found[names[0]] = found.get(names[0], 0.0) + reflected
    if found:
        shown = [f"{name} ({value:g} {_unit(joints[name])})" for name, value in found.items()]
        remarks.insert(0, f"{_having(found)} rotors, used as motor inertia: {listed(shown, 8)}")
    return found, remarks


def _having(joints: Collection[str]) -> str:
    return counted(len(joints), "joint has", "joints have")


def _reflected(inertia: str | None, ratio: str | None) -> float | None:
    """Return a rotor's inertia at its joint; None if the two are not usable numbers."""
    try:
        value = float(inertia or "") * float(ratio or "") ** 2
    except (ValueError, OverflowError):
        return None
    return value if 0 <= value <= LARGEST else None


def _unit(joint: etree._Element) -> str:
    return "kg" if joint.get("type") == "prismatic" else "kg m^2"


def _joints_of(owner: etree._Element) -> list[str]:
    """Return the joints that a rotor drives: the joint that holds it, or those of its transmission."""
    if owner.tag == "joint" and owner.getparent() is not None and owner.getparent().tag == "robot":
        return [owner.get("name", "")]
    transmission = owner.getparent() if owner.tag == "actuator" else owner
    if transmission is None or transmission.tag != "transmission":
        return []
    names = [joint.get("name", "") for joint in transmission.findall("joint")]
    return names if len(names) == 1 else []


def _is_called(element: etree._Element, name: str) -> bool:
    """Return whether an element has a name behind any prefix, with or without its namespace."""
    tag = str(element.tag)
    return tag.endswith((f":{name}", f"}}{name}"))


def _number(element: etree._Element | None, attribute: str) -> float:
    """Return an attribute as a number; 0 where there is none."""
    try:
        value = float(element.get(attribute, "0")) if element is not None else 0.0
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0
