# SPDX-License-Identifier: MIT
"""Generate random robots as URDF text, valid and broken, from any source of random decisions.

The source is either Hypothesis (failures shrink) or a plain generator (long runs): see :class:`Source`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

from hypothesis import strategies as st

ANGLES = (0, math.pi / 2, -math.pi / 2, math.pi, "1.5707963", "1.57079632679", "-3.14159265359", 0.3, 2, -7)
AXES = ("1 0 0", "0 1 0", "0 0 1", "-1 0 0", "0 -1 0", "0 0 -1", "0 0 3", "0 1e-16 -1", "1 1 0", "1 -2 0.5")


class Source(Protocol):
    """Source of random decisions."""

    def integer(self, low: int, high: int) -> int: ...
    def real(self, low: float, high: float) -> float: ...
    def pick(self, values: Sequence[Any]) -> Any: ...


class Plain:
    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.integer, self.real = self.random.randint, self.random.uniform

    def pick(self, values: Sequence[Any]) -> Any:
        return self.random.choice(values)


class Drawn:
    def __init__(self, draw: Any) -> None:
        self.draw = draw

    def integer(self, low: int, high: int) -> int:
        return int(self.draw(st.integers(low, high)))

    def real(self, low: float, high: float) -> float:
        # A coarse grid: subnormal numbers and the like are no robot's, and belong to the broken files.
        return float(self.draw(st.integers(0, 4096))) / 4096 * (high - low) + low

    def pick(self, values: Sequence[Any]) -> Any:
        return self.draw(st.sampled_from(list(values)))


@dataclass
class Robot:
    """URDF text and a chain in it. ``links`` and ``joints`` hold one element each, for mutations."""

    base: str
    tip: str
    links: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)
    extras: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return "\n".join(
            ['<?xml version="1.0"?>', '<robot name="random">', *self.joints, *self.links, *self.extras]
        ) + ("\n</robot>\n")


def random_robot(source: Source, most_moving: int) -> Robot:
    """Return a chain of 1..most_moving moving joints in a tree with links before its base, beside it and beyond it."""
    path = [source.pick(("revolute", "continuous", "prismatic")) for _ in range(source.integer(1, most_moving))]
    for _ in range(source.integer(0, 3)):
        path.insert(source.integer(0, len(path)), "fixed")
    kinds = [source.pick(("fixed", "revolute", "prismatic", "planar")) for _ in range(source.integer(0, 2))]
    before = len(kinds)
    kinds += path
    after = len(kinds)
    parents = list(range(len(kinds)))  # joint k hangs below link parents[k] and carries link k + 1
    for _ in range(source.integer(0, 4)):
        parents.append(source.integer(before, len(kinds)))
        kinds.append(source.pick(("fixed", "revolute", "continuous", "prismatic", "floating", "planar")))
    names = [source.pick(("l{}", "Link {}", "gelenk_ä{}", "a/b:{}")).format(k) for k in range(len(kinds) + 1)]
    robot = Robot(base=names[before], tip=names[after])
    robot.links = [_link(source, name) for name in names]
    robot.joints = _joints(source, kinds, parents, names, before)
    for elements in (robot.links, robot.joints):
        if source.integer(0, 1):
            elements.reverse()
    if source.integer(0, 3) == 0:
        robot.extras = [
            '<gazebo reference="l0"><link name="l0"/><joint name="j0"/></gazebo>',
            '<transmission name="t"><joint name="j0"><axis xyz="0 0 0"/></joint></transmission>',
            "<!-- <joint> -->",
            "<sensor><x:y z='1'/></sensor>".replace("x:", ""),
        ]
    return robot


def _joints(source: Source, kinds: list[str], parents: list[int], names: list[str], before: int) -> list[str]:
    """Return joints of random types, origins, axes, limits and mimic relations."""
    moving = [k for k, kind in enumerate(kinds) if kind in ("revolute", "continuous", "prismatic")]
    order = moving if source.integer(0, 1) else moving[::-1]  # a follower's master comes earlier in this order
    joints = []
    for k, kind in enumerate(kinds):
        parts = [f"<parent link={quoteattr(names[parents[k]])}/>", f"<child link={quoteattr(names[k + 1])}/>"]
        parts += _origin(source)
        if k in moving:
            axis = source.pick((*AXES, None, "random"))
            if axis == "random":
                axis = f"{source.real(-1, 1)} {source.real(-1, 1)} {source.real(0.1, 1)}"
            if axis is not None:
                parts.append(f'<axis xyz="{axis}"/>')
            parts.append(source.pick((
                "", '<limit effort="1" velocity="2"/>', '<limit lower="-1" upper="2" effort="0" velocity="1e300"/>',
            )))  # fmt: skip
            # A joint before the base that shares a coordinate with one beyond it is refused.
            earlier = [other for other in order[: order.index(k)] if (other < before) == (k < before)]
            if earlier and source.integer(0, 5) == 0:
                master, multiplier = source.pick(earlier), source.pick((1, -1, 0.5, -2.25))
                parts.append(
                    f'<mimic joint="j{master}" multiplier="{multiplier}" offset="{source.pick((0, 0.3, -1))}"/>'
                )
        elif source.integer(0, 1):
            parts.append(source.pick(('<axis xyz="0 0 0"/>', '<limit lower="" upper=""/>', "<dynamics/>")))
        joints.append(f'<joint name="j{k}" type="{kind}">{"".join(parts)}</joint>')
    return joints


def _origin(source: Source) -> list[str]:
    if source.integer(0, 9) == 0:
        return []
    xyz = " ".join(str(source.pick((0, 0.1, -0.333, source.real(-1, 1)))) for _ in range(3))
    rpy = " ".join(str(source.pick((*ANGLES, source.real(-4, 4)))) for _ in range(3))
    return [f'<origin xyz="{xyz}" rpy="{rpy}"/>'] if source.integer(0, 9) else [f'<origin xyz="{xyz}"/>']


def _link(source: Source, name: str) -> str:
    """Return a link with a random inertia of a box, or none."""
    if source.integer(0, 4) == 0:
        return f"<link name={quoteattr(name)}/>"
    x, y, z = (source.real(0.01, 0.5) for _ in range(3))  # a box's half axes: any tensor made so is a body's
    c, s = math.cos(angle := source.real(-3, 3)), math.sin(angle)
    xx, yy, zz = y * y + z * z, x * x + z * z, x * x + y * y
    tensor = {
        "ixx": c * c * xx + s * s * yy, "ixy": c * s * (xx - yy), "ixz": 0,
        "iyy": s * s * xx + c * c * yy, "iyz": 0, "izz": zz,
    }  # fmt: skip
    attributes = " ".join(f'{key}="{value!r}"' for key, value in tensor.items())
    return (
        f'<link name={quoteattr(name)}><inertial>{"".join(_origin(source))}<mass value="{source.real(0, 20)}"/>'
        f'<inertia {attributes}/></inertial><visual><geometry><mesh filename="package://no/such.stl"/></geometry>'
        "</visual></link>"
    )


@st.composite
def robots(draw: Any, most_moving: int = 12) -> Robot:
    """Draw from :func:`random_robot`, as a strategy of Hypothesis."""
    return random_robot(Drawn(draw), most_moving)


BAD_WORDS = (
    "", "nan", "inf", "-inf", "1e400", "-1e400", "1e200", "1_000", "٣", "0x10", "1,5", "${pi}", "$(arg x)", "a b", "-1",
    "0", "1e-320", "1e308", "--1", "1e", "١ ٢ ٣", "0 0 0", "0 0 0 0", "\u00a01", "'", "<", "&#0;", "&x;", "&#155;",
)  # fmt: skip
JUNK = (
    "<link/>", "<joint/>", '<link name="l0"/>', '<joint name="j0" type="revolute"/>', "</robot>", "<robot>", "\x00",
    "\x1b", "<!DOCTYPE a>",
    "<!-- -- -->", "<a:b/>", "<xacro:if/>", "<?xml version='1.0'?>", "<![CDATA[", "&amp;", "\ufeff",
    "<", '<joint name="j0" type="fixed"><parent link="l1"/><child link="l0"/></joint>', "<mimic joint='j1'/>",
)  # fmt: skip


def broken_file(source: Source, most_moving: int = 4) -> bytes:
    """Return a valid robot's file with one to three mutations; it may have stayed valid."""
    text = random_robot(source, most_moving).text
    for _ in range(source.integer(1, 3)):
        text = _mutated(source, text)
    data = text.encode(source.pick(("utf-8", "utf-8", "utf-8", "utf-16", "latin-1", "utf-8-sig")), "replace")
    match source.integer(0, 5):
        case 0:
            data = data[: source.integer(0, len(data))]
        case 1:
            at = source.integer(0, len(data) - 1) if data else 0
            data = data[:at] + bytes([source.integer(0, 255)]) + data[at + 1 :]
    return data


def _mutated(source: Source, text: str) -> str:
    """Return the text with one random damage: a value, a name, a piece lost, doubled or inserted."""
    quotes = [i for i, c in enumerate(text) if c == '"']
    tags = [i for i, c in enumerate(text) if c == "<"]
    if len(quotes) < 2 or len(tags) < 2:
        return text
    at = 2 * source.integer(0, len(quotes) // 2 - 1)
    start, end = quotes[at] + 1, quotes[at + 1]
    other = 2 * source.integer(0, len(quotes) // 2 - 1)
    first, last = sorted((source.pick(tags), source.pick(tags)))
    match source.integer(0, 6):
        case 0 | 1:  # another value
            return text[:start] + str(source.pick(BAD_WORDS)) + text[end:]
        case 2:  # a value from elsewhere: wrong names, circles, duplicates
            return text[:start] + text[quotes[other] + 1 : quotes[other + 1]] + text[end:]
        case 3:  # an attribute's name lost
            return text[: start - 2] + "_" + text[start - 2 :]
        case 4:
            return text[:first] + str(source.pick(JUNK)) + text[first:]
        case 5:
            return text[:first] + text[last:]
        case _:
            return text[:last] + text[first:last] + text[last:]


@st.composite
def broken_files(draw: Any) -> bytes:
    """Draw from :func:`broken_file`, as a strategy of Hypothesis."""
    return broken_file(Drawn(draw))
