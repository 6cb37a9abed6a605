# SPDX-License-Identifier: MIT
"""The smallest robots of each kind: one joint, one coordinate, one motor, tips whose path holds one joint."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stiffgen import load_chain
from stiffgen.core.robot.chain import Chain
from support.exact_linkage import Linkage

_INERTIAL = (
    '<inertial><origin xyz="0.02 0.01 0.1" rpy="0.1 0.2 0.3"/><mass value="1.5"/>'
    '<inertia ixx="0.02" iyy="0.025" izz="0.015" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>'
)
_LIMIT = '<limit lower="-2" upper="2" effort="10" velocity="1"/>'


def part(
    parent: str, child: str, kind: str = "revolute", xyz: str = "0.05 -0.02 0.3", axis: str = "0.6 0 0.8",
    rpy: str = "0.1 0.2 0.3", more: str = "",
) -> str:  # fmt: skip
    """Return a link and the joint that leads to it, of the same name."""
    moving = "" if kind == "fixed" else f'<axis xyz="{axis}"/>{_LIMIT}'
    return (
        f'<link name="{child}">{_INERTIAL}</link><joint name="{child}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>{moving}{more}</joint>'
    )


@dataclass(frozen=True)
class Small:
    """Links and joints of a robot on the link ``base``, options of ``load_chain``, and the texts of its loops."""

    parts: str
    options: dict[str, Any]
    loops: list[str] = field(default_factory=list)
    actuated: list[str] = field(default_factory=list)

    @property
    def urdf(self) -> str:
        return f'<robot name="small"><link name="base">{_INERTIAL}</link>{self.parts}</robot>'

    @property
    def linkage(self) -> Linkage:
        """Robot with closed loops, for the oracle."""
        return Linkage(self.urdf, self.loops, self.actuated, "")

    def all_options(self) -> dict[str, Any]:
        """Return the options of ``load_chain``, those of loops included."""
        return self.options | ({"loop": self.loops, "actuated": self.actuated} if self.loops else {})

    def load(self, folder: Path) -> Chain:
        file = folder / "small.urdf"
        file.write_text(self.urdf)
        return load_chain(file, **self.all_options())


def turning_arm(last: str = "") -> Small:
    """Return an arm whose first and last joint turn without limits; ``last`` is another last joint."""
    parts = part("base", "one", "continuous", axis="0 0 1") + part("one", "two", axis="0 1 0")
    parts += last or part("two", "three", "continuous", axis="0.6 0 0.8")
    return Small(parts.replace(_LIMIT, '<limit lower="-2" upper="2" effort="60" velocity="6"/>'), {"tip": "three"})


def five_bar() -> Small:
    """Return a planar linkage of two cranks with motors, whose couplers meet in a pin above them."""
    limit = '<limit lower="-0.7" upper="0.7" effort="60" velocity="4"/>'
    flat = {"axis": "0 0 1", "rpy": "0 0 0"}
    parts = part("base", "left", xyz="0 0 0", **flat) + part("left", "left_coupler", xyz="-0.05 0.25 0", **flat)
    parts += part("base", "right", xyz="0.3 0 0", **flat) + part("right", "right_coupler", xyz="0.05 0.25 0", **flat)
    parts += part("left_coupler", "end", "fixed", "0.2 0.25 0.05")
    pins = ["left_coupler:0.2,0.2,0=right_coupler:-0.2,0.2,0"]
    return Small(parts.replace(_LIMIT, limit), {"tip": "end"}, pins, ["left", "right"])


_MIMIC = '<mimic joint="one" multiplier="-0.5" offset="0.3"/>'
TREES = {
    "one turning joint": Small(part("base", "one"), {"tip": "one"}),
    "one sliding joint": Small(part("base", "one", "prismatic"), {"tip": "one"}),
    "one coordinate of two joints": Small(part("base", "one") + part("one", "two", more=_MIMIC), {"tip": "two"}),
    "two tips on one joint": Small(
        part("base", "one") + part("one", "end", "fixed"), {"tip": ["one", "end"]}
    ),
    "two tips of one joint each": Small(
        part("base", "one") + part("base", "two", "prismatic", axis="0 0.6 0.8"), {"tip": ["one", "two"]}
    ),
    "two tips on one way": Small(
        part("base", "one") + part("one", "two", "prismatic", axis="0 0.6 0.8"), {"tip": ["one", "two"]}
    ),
    "one joint on a floating base": Small(part("base", "one"), {"tip": "one", "floating_base": True}),
}  # fmt: skip
"""Trees whose path to a tip holds one or two joints."""

_FLAT = {"axis": "0 0 1", "rpy": "0 0 0"}
_MOUNT = part("base", "mount", "fixed", "0.1 -0.2 0.3", rpy="0.4 1.1 -0.3")
_CRANK = part("mount", "crank", xyz="0 0 0", **_FLAT) + part("crank", "coupler", xyz="0.15 0 0", **_FLAT)
_TIPS = "".join(part(link, f"on_{link}", "fixed", "0.1 -0.12 0.07") for link in ("crank", "coupler", "rocker"))
_ON_EACH = {"tip": ["on_crank", "on_coupler", "on_rocker"]}
LINKAGES = {
    "two slides": Small(
        part("base", "driver", "prismatic", "0 0 0", "0.6 0 0.8", "0 0 0")
        + part("base", "driven", "prismatic", "0.1 0.2 0", "-0.6 0 -0.8", "0 0 0"),
        {"tip": "driven"}, ["driver:0.1,0.2,0=driven:0,0,0"], ["driver"],
    ),
    "four-bar": Small(
        _MOUNT + _CRANK + part("mount", "rocker", xyz="0.3 0 0", **_FLAT) + _TIPS,
        _ON_EACH, ["coupler:0.3,0.1,0=rocker:0.15,0.1,0"], ["crank"],
    ),
    "slider-crank": Small(
        _MOUNT + _CRANK + part("mount", "rocker", "prismatic", "0.05 0.02 0", "1 0 0", "0 0 0") + _TIPS,
        _ON_EACH, ["coupler:0.3,0.05,0=rocker:0.4,0.03,0"], ["crank"],
    ),
}  # fmt: skip
"""Linkages with one motor; "two slides" has one passive joint and one equation."""
