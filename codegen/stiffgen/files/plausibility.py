# SPDX-License-Identifier: MIT
"""Numbers of a chain that hint at a wrong unit: each gives a sentence with the number, and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiffgen.core.errors import printable
from stiffgen.core.robot.chain import Chain, Coordinate, Joint, Sensor, Tool
from stiffgen.core.robot.impossible import unit_motions

_TURNS = 4 * math.pi  # [rad]
_FASTEST = {"prismatic": 10.0, "revolute": 28.0}
"""[m/s, rad/s]; wrists of SCARA arms reach 26 rad/s."""
_SIZE = 3.0  # [m]
_SMALLEST = 0.3  # a body of this size is plausible on the shortest chain [m]
_GRAVITY = 9.81
_STATES = 100


@dataclass(frozen=True)
class Doubt:
    """Number that is probably in another unit: what it is a number of, and the sentence about it."""

    about: str
    text: str


def doubts(chain: Chain) -> Iterator[str]:
    """Yield a sentence for each number of a chain that is probably in another unit."""
    for doubt in find_doubts(chain):
        yield doubt.text


def find_doubts(chain: Chain) -> Iterator[Doubt]:
    """Yield each number of a chain that is probably in another unit."""
    for coordinate in chain.coordinates:
        yield from _about_limits(coordinate)
    if chain.tool is not None:
        for text in _about_tool(chain):
            yield Doubt("tool", text)
    if chain.sensor is not None:
        for text in _about_place("sensor", chain.sensor.option):
            yield Doubt("sensor", text)
    if chain.masses:
        for text in _about_bodies(chain):
            yield Doubt("mass", text)
        if not chain.floating:
            for text in _about_gravity(chain):
                yield Doubt("mass", text)


def doubt_about_inertia(mass: float, tensor: tuple[float, ...]) -> str:
    """Return a question if an inertia (xx, xy, xz, yy, yz, zz) is so large for its mass that its unit is doubtful."""
    largest = max(map(abs, tensor))
    radius = math.sqrt(largest / mass) if mass > 0 else 0.0
    return f"; its radius of gyration would be {radius:.3g} m: is it in kg mm^2?" if radius > _SIZE else ""


def _about_limits(coordinate: Coordinate) -> Iterator[Doubt]:
    """Yield position and velocity limits so large that they are probably in degrees or millimetres."""
    title = f"joint '{printable(coordinate.name)}'"
    slides = coordinate.type == "prismatic"
    unit = "m" if slides else "rad"
    ends = [abs(end) for end in (coordinate.lower, coordinate.upper) if math.isfinite(end)]
    if max(ends, default=0.0) > (_SIZE * 10 if slides else _TURNS):
        guess = "millimetres" if slides else "degrees"
        yield Doubt(
            "position", f"{title}: limits {coordinate.lower:g} to {coordinate.upper:g} {unit}: are these {guess}?"
        )
    if math.isfinite(coordinate.velocity) and coordinate.velocity > _FASTEST["prismatic" if slides else "revolute"]:
        guess = "mm/s" if slides else "degrees per second"
        yield Doubt("velocity", f"{title}: velocity limit {coordinate.velocity:g} {unit}/s: are these {guess}?")


def _about_tool(chain: Chain) -> Iterator[str]:
    """Yield questions about a tool whose units look wrong."""
    tool = chain.tool
    assert tool is not None
    yield from _about_place("tool", tool)
    if math.hypot(*tool.com) > _SIZE:
        yield f"tool: com {_shown(tool.com)} m is {math.hypot(*tool.com):g} m away: are these millimetres?"
    rest = sum(joint.body.mass for joint in chain.joints) - tool.mass
    if chain.masses and tool.mass > rest > 0:
        yield f"tool: its mass, {tool.mass:g} kg, is above that of the moving links, {rest:.3g} kg: are these grams?"


def _about_place(title: str, part: Tool | Sensor) -> Iterator[str]:
    if max(map(abs, part.rpy)) > 2 * math.pi:
        yield f"{title}: rpy {_shown(part.rpy)} rad is beyond a turn: are these degrees?"
    if math.hypot(*part.xyz) > _SIZE:
        yield f"{title}: xyz {_shown(part.xyz)} m is {math.hypot(*part.xyz):g} m away: are these millimetres?"


def _about_bodies(chain: Chain) -> Iterator[str]:
    """Yield the joints whose bodies have a radius of gyration beyond the length of the stretched chain."""
    reach = sum(math.hypot(*joint.translation) for joint in chain.joints)
    reach += max(math.hypot(*tip.translation) for tip in chain.tips)
    for joint in chain.joints:
        radius = _radius_of_gyration(joint)
        if radius > max(_SMALLEST, min(_SIZE, reach)):
            yield (
                f"joint '{printable(joint.name)}': its bodies have a radius of gyration of {radius:.3g} m, where the "
                f"chain reaches {reach:.3g} m: is an inertia in kg mm^2, or a length in mm?"
            )


def _radius_of_gyration(joint: Joint) -> float:
    """Return the largest radius of gyration of a joint's bodies about their centre of mass [m]."""
    mass, (x, y, z) = joint.body.mass, joint.body.moment
    if mass <= 0:
        return 0.0
    xx, xy, xz, yy, yz, zz = joint.body.tensor
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    c = np.array([x, y, z]) / mass
    about_centre = about_origin - mass * (c @ c * np.eye(3) - np.outer(c, c))
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(about_centre)[-1])) / mass)


def _about_gravity(chain: Chain) -> Iterator[str]:
    """Yield the joints whose effort limit does not carry the arm, where the base's z axis points up."""
    random = np.random.default_rng(46)
    lower, upper = np.array([each.range_within(math.pi) for each in chain.coordinates]).T
    torque = np.zeros((_STATES, len(lower)))  # of gravity [N m], [N]
    q = random.uniform(lower, upper, torque.shape)
    for joint, (rotation, motion) in zip(chain.joints, unit_motions(chain, q), strict=True):
        moment = (rotation @ np.array(joint.body.moment))[:, :, None]
        # z component of the rate of m c at unit rates of the coordinates: m v + w x (m c)
        rise = joint.body.mass * motion[:, 2] + motion[:, 3] * moment[:, 1] - motion[:, 4] * moment[:, 0]
        torque += _GRAVITY * rise
    largest = np.abs(torque).max(axis=0)
    for coordinate, needed in zip(chain.coordinates, largest, strict=True):
        if coordinate.effort < needed and not chain.loops:
            unit = "N" if coordinate.type == "prismatic" else "N m"
            yield (
                f"joint '{printable(coordinate.name)}': gravity needs up to {needed:.3g} {unit}, above the effort "
                f"limit {coordinate.effort:g} {unit}: check masses, lengths and the limit"
            )


def _shown(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
