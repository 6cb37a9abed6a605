# SPDX-License-Identifier: MIT
"""CasADi expressions of the joint stiffness of contacts or springs at all tips of a tree, in one pass over the joints.

Wrenches and task stiffnesses of several tips add up once they refer to one common point. Let S_i = (v_i, w_i) be the
twist of joint i at the common point. Let p be the position of a tip relative to that point, and (f, m) and K the wrench
and task stiffness at the tip. The joint stiffness of one tip is [J_i, J_j] . F + J_i . (K + Gamma F) J_j (body form of
Gamma; the choice of axes does not matter). With the shift J = X S from the common point to the tip it becomes

    Kq_ij = S_i . u_j       u_j = X^T K X S_j + (0, v_j x f + w_j x m / 2 + Q w_j)       Q = p f^T - (p . f) 1

for i on the way from the base to j, else 0. X^T K X, f, m and Q add up over the tips beyond joint j, like the inertias
of composite bodies. The cost is one covector u_j per joint and one product per pair, independent of the number of tips.

The spatial form is the case p = 0, since all its columns and its connection refer to the common point. Springs have
hybrid wrenches and stiffnesses; their torque is tau_j = -S_j . W_j, where W_j is the sum of the wrenches beyond joint
j, with moments about the common point.

Common point and axes:

* body: origin and axes of the base link;
* hybrid: origin of the base link, axes of the base or, on a floating base, the world;
* spatial: origin and axes of the base or, on a floating base, the world.

For the joints of a floating base, u_j includes the connection term of the base (:func:`stiffness.base_connection`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic import stiffness
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kinematics import (
    Configuration,
    Expressions,
    Frame,
    Section,
    constant,
    cross,
    outward_frames,
    spatial_column,
)
from stiffgen.families.springs import springs
from stiffgen.families.springs.springs import Spring


@dataclass(frozen=True)
class _Load:
    """Load of one or several tips, added up: K at the common point, f and m at the tips, and Q."""

    K: ca.SX
    f: ca.SX
    m: ca.SX
    Q: ca.SX

    def __add__(self, other: _Load) -> _Load:
        return _Load(self.K + other.K, self.f + other.f, self.m + other.m, self.Q + other.Q)

    def covector(self, column: ca.SX) -> ca.SX:
        """Return the covector u_j (6) of the joint j whose column is S_j: Kq_ij = S_i . u_j."""
        v, w = column[:3], column[3:]
        angular = cross(v, self.f) + cross(w, self.m) / 2 + self.Q @ w
        return ca.densify(self.K @ column + ca.vertcat(ca.SX.zeros(3), angular))

    def moment(self, point: ca.SX) -> ca.SX:
        """Return the moment of the wrenches about a point in the common frame."""
        return self.wrench[3:] - cross(point, self.f)

    @property
    def wrench(self) -> ca.SX:
        """Sum of the wrenches, with moments about the common point: Q^T - Q = f p^T - p f^T = [p x f]."""
        cross_matrix = self.Q.T - self.Q
        moment_of_forces = ca.vertcat(cross_matrix[2, 1], cross_matrix[0, 2], cross_matrix[1, 0])
        return ca.vertcat(self.f, self.m + moment_of_forces)


def columns_and_covectors(chain: Chain, *arguments: ca.SX, representation: Representation) -> Expressions:
    """Return columns S above covectors u (12 x number of joints), where Kq_ij = S_i . u_j for i on the way to j.

    Args:
        chain: tree.
        arguments: configuration arguments (:meth:`Configuration.of`) with one tool pose per tip, then wrenches
            (tips, 6) and task stiffnesses (tips, 6, 6). Only the upper triangles of the stiffnesses are read.
        representation: representation of wrenches and task stiffnesses.

    """
    *configuration, wrenches, stiffnesses = arguments
    count = len(chain.tips)
    tree = _TipTree.of(chain, configuration, representation)
    wrench_of, stiffness_of = _per_tip(wrenches, count), _per_tip(stiffnesses, count)
    loads = []
    for index, tip in enumerate(chain.tips):
        K = stiffness.symmetric_from_upper(ca.reshape(stiffness_of[index], 6, 6).T)
        loads.append(_load(tree.sections, tip, index, tree.poses[index], wrench_of[index], K, representation))
    totals = _beyond(chain, loads)
    stacked = ca.vertcat(ca.horzcat(*tree.columns), ca.horzcat(*_covectors(chain, tree, totals)))
    return Expressions(ca.densify(stacked), tuple(tree.sections))


def columns_of_loads(chain: Chain, *arguments: ca.SX, representation: Representation, jacobians: bool) -> Expressions:
    """Return columns S and covectors u of loads without task stiffness: row-major, stacked.

    ``arguments`` are those of :func:`columns_and_covectors` without the stiffnesses. With ``jacobians``, those of all
    tips follow; they have the coordinates of the chain as columns, and six rows per tip. A load keeps its components
    along geodesics of its tip: a spatial wrench is moved there (``columns_and_covectors`` does not).
    """
    *configuration, wrenches = arguments
    tree = _TipTree.of(chain, configuration, representation)
    wrench_of, no_stiffness = _per_tip(wrenches, len(chain.tips)), ca.SX(6, 6)
    loads = []
    for index, tip in enumerate(chain.tips):
        wrench, of_load = wrench_of[index], representation
        if representation == "spatial":  # one load, whatever representation states it: that of the tip
            (_, p), force, moment = tree.poses[index], wrench[:3], wrench[3:]
            wrench, of_load = ca.vertcat(force, moment - cross(p, force)), "hybrid"
        loads.append(_load(tree.sections, tip, index, tree.poses[index], wrench, no_stiffness, of_load))
    matrices = [ca.horzcat(*tree.columns), ca.horzcat(*_covectors(chain, tree, _beyond(chain, loads)))]
    if jacobians:
        matrices += [_jacobian(chain, tree, index, representation) for index in range(len(chain.tips))]
    stacked = ca.vertcat(*(ca.vec(ca.densify(each).T) for each in matrices))
    return Expressions(stacked, tuple(tree.sections))


def _jacobian(chain: Chain, tree: _TipTree, index: int, representation: Representation) -> ca.SX:
    """Return the Jacobian of a tip: columns S moved to the tip and turned to its axes."""
    rotation, point = tree.poses[index]
    result, number = ca.SX(6, chain.dof), chain.tips[index].joint
    while number >= 0:
        joint, column = chain.joints[number], tree.columns[number]
        if representation != "spatial":
            column = ca.vertcat(column[:3] + cross(column[3:], point), column[3:])
        if representation == "body":
            column = ca.vertcat(rotation.T @ column[:3], rotation.T @ column[3:])
        result[:, joint.coordinate] += joint.multiplier * column
        number = joint.parent
    return ca.densify(result)


def spring_terms(chain: Chain, *arguments: ca.SX, spring: Spring, parts: str) -> Expressions:
    """Return the quantities that ``parts`` selects, for springs of one kind at all tips: row-major, stacked.

    Args:
        chain: tree.
        arguments: configuration arguments (:meth:`Configuration.of`) with one tool pose per tip, then the parameters
            of the spring, with one value per tip.
        spring: potential at every tip.
        parts: "S" selects the columns S and covectors u (6 x number of joints each), "U" the energy, "T" the torques
            of the joints.

    """
    count = len(arguments) - len(spring.parameters)
    configuration, parameters = arguments[:count], arguments[count:]
    tree = _TipTree.of(chain, configuration, "hybrid")
    _, origin = Configuration.of(chain, configuration).base  # of the base link, the common point
    energy, loads = ca.SX(0), list[_Load]()
    for index, tip in enumerate(chain.tips):  # each tip's spring, then its load on the joints before it
        R, p = (ca.densify(each) for each in tree.poses[index])
        tree.sections.append(Section(f"pose of tip {tip.link}", {f"R{index}_tip": R, f"p{index}_tip": p}))
        of_tip = _parameters_of_tip(chain, spring, parameters, index)
        quantities = springs.derivatives(spring, p + origin, R, of_tip).of_tip(index)
        tree.sections.extend(quantities.sections)
        energy += quantities.V
        if set(parts) - {"U"}:
            K = stiffness.symmetric_from_upper(quantities.K) if "S" in parts else ca.SX(6, 6)
            loads.append(_load(tree.sections, tip, index, (R, p), ca.densify(quantities.F), K, "hybrid"))
    results = {"U": energy}
    totals = _beyond(chain, loads) if loads else []
    if "S" in parts:
        both = tree.columns, _covectors(chain, tree, totals)
        results["S"] = ca.vertcat(*(ca.vec(ca.horzcat(*each).T) for each in both))
    if "T" in parts:
        pairs = zip(tree.columns, totals, strict=True)
        results["T"] = ca.vertcat(*(-ca.dot(S, total.wrench) if total else ca.SX(0) for S, total in pairs))
    return Expressions(ca.densify(ca.vertcat(*(results[part] for part in parts))), tuple(tree.sections))


def _parameters_of_tip(chain: Chain, spring: Spring, values: Sequence[ca.SX], index: int) -> list[ca.SX]:
    """Return the spring's parameters of one tip, in their shapes, from arrays with one value per tip."""
    parameters = []
    for argument, of_all in zip(spring.parameters, values, strict=True):
        entries, shape = _per_tip(of_all, len(chain.tips))[index], argument.array(chain).shape
        parameters.append(ca.reshape(entries, *shape[::-1]).T if len(shape) == 2 else entries)
    return parameters


@dataclass(frozen=True)
class _TipTree:
    """Frames and columns of the joints, and poses (rotation, origin) of the tips, relative to the common point."""

    sections: list[Section]
    frames: list[Frame]
    columns: list[ca.SX]
    poses: list[tuple[ca.SX, ca.SX]]

    @staticmethod
    def of(chain: Chain, arguments: Sequence[ca.SX], representation: Representation) -> _TipTree:
        """Return the tree at configuration arguments; the representation decides the common point."""
        count = len(chain.tips)
        tools = _per_tip(arguments[-1], count) if chain.runtime_tool else [None] * count
        configuration = Configuration.of(chain, arguments, seen_from_tip=representation == "body")
        base_pose = configuration.base_pose
        if base_pose is not None and representation == "hybrid":
            base_pose = ca.diagcat(base_pose[:3, :3], 1)  # axes of the world, origin of the base link
        r, frames = outward_frames(chain, Configuration(configuration.q, base_pose))
        columns = [spatial_column(joint, frame[1], frame[2]) for joint, frame in zip(chain.joints, frames, strict=True)]
        poses = [_tip_pose(tip, frames[tip.joint], tool) for tip, tool in zip(chain.tips, tools, strict=True)]
        return _TipTree(r.sections, frames, columns, poses)


def _beyond(chain: Chain, loads: Sequence[_Load]) -> list[_Load | None]:
    """Return the sum of the loads beyond every joint, None for a joint beyond all tips.

    A joint beyond all tips is in the chain because it shares its coordinate with a mimic joint.
    """
    beyond: list[_Load | None] = [None] * len(chain.joints)
    for tip, load in zip(chain.tips, loads, strict=True):
        beyond[tip.joint] = _added(beyond[tip.joint], load)
    for index in reversed(range(len(chain.joints))):
        total, parent = beyond[index], chain.joints[index].parent
        if total is not None and parent >= 0:
            beyond[parent] = _added(beyond[parent], total)
    return beyond


def _covectors(chain: Chain, tree: _TipTree, totals: Sequence[_Load | None]) -> list[ca.SX]:
    """Return u_j of every joint."""
    covectors = [ca.SX.zeros(6)] * len(chain.joints)
    for index, total in enumerate(totals):
        if total is None:
            continue
        covectors[index] = total.covector(tree.columns[index])
        if 3 <= index < chain.base_joints:  # the base's rotations: connection term of the base
            _, origin, axis = tree.frames[index]
            covectors[index] += ca.vertcat(ca.SX.zeros(3), cross(total.moment(origin), axis) / 2)
    return covectors


def _per_tip(values: ca.SX, count: int) -> list[ca.SX]:
    """Return the values of an array with one value per tip, each as a column of row-major entries."""
    entries = ca.vec(ca.densify(values).T)
    size = entries.numel() // count
    return [entries[size * k : size * (k + 1)] for k in range(count)]


def _tip_pose(tip: Tip, frame: Frame, tool: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """Return rotation and origin of a tip, or of the tool mounted there."""
    rotation, origin = constant(tip.rotation), constant(tip.translation)
    if tool is not None:
        pose = ca.reshape(tool, 4, 4).T
        rotation, origin = rotation @ pose[:3, :3], origin + rotation @ pose[:3, 3]
    return frame[0] @ rotation, frame[1] + frame[0] @ origin


def _load(
    sections: list[Section],
    tip: Tip,
    index: int,
    pose: tuple[ca.SX, ca.SX],
    wrench: ca.SX,
    K: ca.SX,
    representation: Representation,
) -> _Load:
    """Return the load of one tip at the common point, and add its sections.

    ``wrench`` and ``K`` are those of the representation, ``pose`` (rotation, origin) is relative to the common point.
    """
    if representation == "spatial":
        return _Load(K, wrench[:3], wrench[3:], ca.SX(3, 3))
    rotation, p = (ca.densify(each) for each in pose)
    values = {f"p{index}_tip": p}
    f, m = wrench[:3], wrench[3:]
    if representation == "body":  # to the base's axes
        values[f"R{index}_tip"] = rotation
        f, m = rotation @ f, rotation @ m
        turn = ca.diagcat(rotation, rotation)
        K = stiffness.symmetric_from_upper(turn @ K @ turn.T)
    title = f"pose of tip {tip.link}"
    if not any(section.title == title for section in sections):
        sections.append(Section(title, values))
    load = _Load(
        K=ca.densify(_at_common_point(K, p)),
        f=ca.densify(f),
        m=ca.densify(m),
        Q=ca.densify(p @ f.T - ca.dot(p, f) * ca.SX.eye(3)),
    )
    upper = {f"K{index}_{r}{c}": load.K[r, c] for r in range(6) for c in range(r, 6)}
    title = f"load of tip {tip.link}: force f{index}, moment m{index}; stiffness K{index} and Q{index} at common point"
    sections.append(Section(title, {f"f{index}_": load.f, f"m{index}_": load.m, f"Q{index}_": load.Q, **upper}))
    return load


def _at_common_point(K: ca.SX, p: ca.SX) -> ca.SX:
    """Return X^T K X with X = [1, -[p]; 0, 1], block by block: the stiffness K of a tip at p, at the common point."""
    K11, K12, K22 = K[:3, :3], K[:3, 3:], K[3:, 3:]
    coupling = K12 - K11 @ ca.skew(p)
    rotational = stiffness.symmetric_from_upper(K22 + ca.skew(p) @ coupling + (ca.skew(p) @ K12).T)
    return ca.vertcat(ca.horzcat(K11, coupling), ca.horzcat(coupling.T, rotational))


def _added(one: _Load | None, other: _Load) -> _Load:
    return other if one is None else one + other
