# SPDX-License-Identifier: MIT
"""CasADi expressions of the joint stiffness of contacts, or springs, at all tips of a tree together, in one pass over
its joints.

Seen from one point, wrenches and task stiffnesses of several tips add up. Let S_i = (v_i, w_i) be the twist of joint i
at that point, and take a tip at p from there, with wrench (f, m) and task stiffness K at the tip. Its joint stiffness
[J_i, J_j] . F + J_i . (K + Gamma F) J_j (body form of Gamma; axes do not matter) is, with J = X S the shift to the tip,

    Kq_ij = S_i . u_j       u_j = X^T K X S_j + (0, v_j x f + w_j x m / 2 + Q w_j)       Q = p f^T - (p . f) 1

for i on the way from the base to j, else 0. X^T K X, f, m and Q add up over the tips beyond joint j, as the inertias of
composite bodies do: whatever the number of tips, one covector u_j per joint and one product per pair. The spatial form,
whose connection belongs to the point that all its columns are taken at, is the case p = 0. Springs have hybrid wrenches
and stiffnesses; their torque is tau_j = -S_j . W_j with the sum W_j of their wrenches, moments about the common point.

The point is the origin of the base link (its axes for the body representation, else those of base or world), for the
spatial representation the origin of base or world. Of a floating base's joints, u_j has the connection term of the base
in it (:func:`stiffness.base_connection`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.robot.chain import Chain, Tip
from stiffgen.symbolic import springs, stiffness
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.kinematics import (
    Configuration,
    Expressions,
    Frame,
    Section,
    constant,
    cross,
    outward_frames,
    spatial_column,
)
from stiffgen.symbolic.springs import Spring


@dataclass(frozen=True)
class _Load:
    """Load of one tip or several, which adds up: K moved to the common point, f, m at the tips, and Q."""

    K: ca.SX
    f: ca.SX
    m: ca.SX
    Q: ca.SX

    def __add__(self, other: _Load) -> _Load:
        return _Load(self.K + other.K, self.f + other.f, self.m + other.m, self.Q + other.Q)

    def covector(self, column: ca.SX) -> ca.SX:
        """Return u_j of a joint with the column S_j."""
        v, w = column[:3], column[3:]
        turning = cross(v, self.f) + cross(w, self.m) / 2 + self.Q @ w
        return ca.densify(self.K @ column + ca.vertcat(ca.SX.zeros(3), turning))

    def moment(self, point: ca.SX) -> ca.SX:
        """Return the moment of the wrenches about a point in the common frame."""
        return self.wrench[3:] - cross(point, self.f)

    @property
    def wrench(self) -> ca.SX:
        """Sum of the wrenches, moments about the common point."""
        turned = self.Q.T - self.Q  # the cross-product matrix of the sum of p x f
        return ca.vertcat(self.f, self.m + ca.vertcat(turned[2, 1], turned[0, 2], turned[1, 0]))


def columns_and_covectors(chain: Chain, *given: ca.SX, representation: Representation) -> Expressions:
    """Return columns S over covectors u (12 x number of joints) with Kq_ij = S_i . u_j for i on the way to j.

    Args:
        chain: the tree.
        given: configuration arguments, as for :meth:`Configuration.of`, one tool pose per tip; then the wrenches
            (tips, 6) and task stiffnesses (tips, 6, 6), of which the upper triangles are read.
        representation: of wrenches and task stiffnesses.

    """
    *where, wrenches, stiffnesses = given
    count = len(chain.tips)
    seen = _Seen.of(chain, where, representation)
    loads = []
    for index, (wrench, matrix) in enumerate(zip(_blocks(wrenches, count), _blocks(stiffnesses, count), strict=True)):
        K = stiffness.symmetric_from_upper(ca.reshape(matrix, 6, 6).T)
        loads.append(_load(seen.sections, chain.tips[index], index, seen.places[index], wrench, K, representation))
    totals = _beyond(chain, loads)
    stacked = ca.vertcat(ca.horzcat(*seen.columns), ca.horzcat(*_covectors(chain, seen, totals)))
    return Expressions(ca.densify(stacked), tuple(seen.sections))


def spring_terms(chain: Chain, *given: ca.SX, spring: Spring, parts: str) -> Expressions:
    """Return what ``parts`` names of the springs of one kind at all tips: entries row by row, in a column.

    Args:
        chain: the tree.
        given: as for :func:`columns_and_covectors`; then the spring's parameters, one of each per tip.
        spring: the potential.
        parts: "S" for columns S and covectors u (6 x number of joints each), "U" for the energy, "T" for the torques of
            the joints.

    """
    count, size = len(chain.tips), len(given) - len(spring.parameters)
    seen = _Seen.of(chain, given[:size], "hybrid")
    origin = Configuration.of(chain, given[:size]).base[1]
    energy, loads = ca.SX(0), list[_Load]()
    for index, tip in enumerate(chain.tips):
        own = []
        for argument, values in zip(spring.parameters, given[size:], strict=True):
            shape = argument.array(chain).shape
            block = _blocks(values, count)[index]
            own.append(ca.reshape(block, *shape[::-1]).T if len(shape) == 2 else block)
        R, p = (ca.densify(each) for each in seen.places[index])
        seen.sections.append(Section(f"tip {tip.link}: its place", {f"R{index}_tip": R, f"p{index}_tip": p}))
        U, F, K = springs.derivatives(spring, p + origin, R, own)
        energy += U
        if set(parts) - {"U"}:
            K = stiffness.symmetric_from_upper(K) if "S" in parts else ca.SX(6, 6)
            loads.append(_load(seen.sections, tip, index, (R, p), ca.densify(F), K, "hybrid"))
    made = {"U": energy}
    totals = _beyond(chain, loads) if loads else []
    if "S" in parts:
        both = seen.columns, _covectors(chain, seen, totals)
        made["S"] = ca.vertcat(*(ca.vec(ca.horzcat(*each).T) for each in both))
    if "T" in parts:
        pairs = zip(seen.columns, totals, strict=True)
        made["T"] = ca.vertcat(*(-ca.dot(S, total.wrench) if total else ca.SX(0) for S, total in pairs))
    return Expressions(ca.densify(ca.vertcat(*(made[part] for part in parts))), tuple(seen.sections))


@dataclass(frozen=True)
class _Seen:
    """Tree as seen from the common point: frames and columns of its joints, rotation and origin of its tips."""

    sections: list[Section]
    frames: list[Frame]
    columns: list[ca.SX]
    places: list[tuple[ca.SX, ca.SX]]

    @staticmethod
    def of(chain: Chain, where: Sequence[ca.SX], representation: Representation) -> _Seen:
        count = len(chain.tips)
        tools = _blocks(where[-1], count) if chain.runtime_tool else [None] * count
        configuration = Configuration.of(chain, where, seen_from_tip=representation == "body")
        base_pose = configuration.base_pose
        if base_pose is not None and representation == "hybrid":
            base_pose = ca.diagcat(base_pose[:3, :3], 1)
        r, frames = outward_frames(chain, Configuration(configuration.q, base_pose))
        columns = [spatial_column(joint, frame[1], frame[2]) for joint, frame in zip(chain.joints, frames, strict=True)]
        places = [_place(tip, frames[tip.joint], tool) for tip, tool in zip(chain.tips, tools, strict=True)]
        return _Seen(r.sections, frames, columns, places)


def _beyond(chain: Chain, loads: Sequence[_Load]) -> list[_Load | None]:
    """Return for every joint the sum of the loads beyond it, None where there is no tip.

    A joint beyond all tips shares its coordinate with a mimic joint.
    """
    beyond: list[_Load | None] = [None] * len(chain.joints)
    for tip, load in zip(chain.tips, loads, strict=True):
        beyond[tip.joint] = _added(beyond[tip.joint], load)
    for index in reversed(range(len(chain.joints))):
        total, parent = beyond[index], chain.joints[index].parent
        if total is not None and parent >= 0:
            beyond[parent] = _added(beyond[parent], total)
    return beyond


def _covectors(chain: Chain, seen: _Seen, totals: Sequence[_Load | None]) -> list[ca.SX]:
    """Return u_j of every joint."""
    covectors = [ca.SX.zeros(6)] * len(chain.joints)
    for index, total in enumerate(totals):
        if total is None:
            continue
        covectors[index] = total.covector(seen.columns[index])
        if 3 <= index < chain.base_joints:
            _, origin, axis = seen.frames[index]
            covectors[index] += ca.vertcat(ca.SX.zeros(3), cross(total.moment(origin), axis) / 2)
    return covectors


def _blocks(values: ca.SX, count: int) -> list[ca.SX]:
    """Return the blocks of an array with one a tip, as columns of entries row by row."""
    entries = ca.vec(ca.densify(values).T)
    size = entries.numel() // count
    return [entries[size * k : size * (k + 1)] for k in range(count)]


def _place(tip: Tip, frame: Frame, tool: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """Return rotation and origin of a tip, or of the tool at it."""
    rotation, origin = constant(tip.rotation), constant(tip.translation)
    if tool is not None:
        pose = ca.reshape(tool, 4, 4).T
        rotation, origin = rotation @ pose[:3, :3], origin + rotation @ pose[:3, 3]
    return frame[0] @ rotation, frame[1] + frame[0] @ origin


def _load(
    sections: list[Section],
    tip: Tip,
    index: int,
    place: tuple[ca.SX, ca.SX],
    wrench: ca.SX,
    K: ca.SX,
    representation: Representation,
) -> _Load:
    if representation == "spatial":
        return _Load(K, wrench[:3], wrench[3:], ca.SX(3, 3))
    rotation, p = (ca.densify(each) for each in place)
    named = {f"p{index}_tip": p}
    f, m = wrench[:3], wrench[3:]
    if representation == "body":
        named[f"R{index}_tip"] = rotation
        f, m = rotation @ f, rotation @ m
        turn = ca.diagcat(rotation, rotation)
        K = stiffness.symmetric_from_upper(turn @ K @ turn.T)
    name = f"tip {tip.link}"
    if not any(section.title == f"{name}: its place" for section in sections):
        sections.append(Section(f"{name}: its place", named))
    A, B = K[:3, :3], K[:3, 3:]
    moved = B - A @ ca.skew(p)
    half = ca.skew(p) @ B
    C = stiffness.symmetric_from_upper(K[3:, 3:] + ca.skew(p) @ moved + half.T)
    load = _Load(
        ca.densify(ca.vertcat(ca.horzcat(A, moved), ca.horzcat(moved.T, C))),
        ca.densify(f),
        ca.densify(m),
        ca.densify(p @ f.T - ca.dot(p, f) * ca.SX.eye(3)),
    )
    upper = {f"K{index}_{r}{c}": load.K[r, c] for r in range(6) for c in range(r, 6)}
    title = f"{name}: force f{index}, moment m{index}, stiffness K{index} and Q{index} seen from the common point"
    sections.append(Section(title, {f"f{index}_": load.f, f"m{index}_": load.m, f"Q{index}_": load.Q, **upper}))
    return load


def _added(one: _Load | None, other: _Load) -> _Load:
    return other if one is None else one + other
