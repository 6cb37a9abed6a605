# SPDX-License-Identifier: MIT
"""Actuators of a compiled MuJoCo model: range of their force on each joint, reflected inertia, joints driven."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

ForceRange = tuple[float, float]


class PulledTarget(NamedTuple):
    """Tendon or joint that an actuator pulls, by its number in the model."""

    is_tendon: bool
    number: int


def actuation(mujoco: Any, model: Any) -> dict[str, Any]:
    """Return the actuators' effect on the joints.

    ``forces`` has the range of the force on each joint, None for an end without a bound. ``armatures`` has the inertia
    that the actuators reflect to it. ``driven`` has the joints of each actuator, [] where no joint is its target.
    ``laws`` names the actuators whose force depends on the state, and ``disabled`` those of a group that is disabled.
    """
    pulls: dict[PulledTarget, list[tuple[ForceRange, float]]] = {}  # forces and gears of the actuators by target
    armatures = [0.0] * int(model.njnt)
    driven, laws, disabled = [], [], []
    for k in range(len(model.actuator_trntype)):
        target = _target(mujoco, model, k)
        joints = [] if target is None else _joints(mujoco, model, target)
        name, gear = model.actuator(k).name or f"actuator{k}", float(model.actuator_gear[k][0])
        driven.append({"name": name, "joints": [joint for joint, _ in joints]})
        if not _is_plain(mujoco, model, k):
            laws.append(name)
        if is_disabled := _is_disabled(model, k):
            disabled.append(name)
        if target is None or not joints:
            continue
        force = (0.0, 0.0) if is_disabled else _force(mujoco, model, k)
        pulls.setdefault(target, []).append((force, gear))
        if not target.is_tendon:
            armatures[target.number] += gear**2 * float(model.actuator_armature[k])
    forces = _joint_forces(mujoco, model, pulls)
    return {"forces": forces, "armatures": armatures, "driven": driven, "laws": laws, "disabled": disabled}


def tendon_joints(mujoco: Any, model: Any, tendon: int) -> Iterator[tuple[int, float]]:
    """Yield joint and coefficient of a fixed tendon; -2 for a spatial one."""
    if tendon < 0:
        return
    start = int(model.tendon_adr[tendon])
    for k in range(start, start + int(model.tendon_num[tendon])):
        fixed = model.wrap_type[k] == mujoco.mjtWrap.mjWRAP_JOINT
        yield (int(model.wrap_objid[k]) if fixed else -2, float(model.wrap_prm[k]))


def _is_plain(mujoco: Any, model: Any, k: int) -> bool:
    """Return whether an actuator's force is a constant times its control, but for a bias that ``biasprm`` states."""
    biases = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    is_constant = int(model.actuator_gaintype[k]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    return is_constant and int(model.actuator_biastype[k]) in biases


def _is_disabled(model: Any, k: int) -> bool:
    """Return whether an actuator's group is one that the model disables; MuJoCo has a bit for each group to 30."""
    group = int(model.actuator_group[k])
    return 0 <= group <= 30 and bool(int(model.opt.disableactuator) >> group & 1)


def _target(mujoco: Any, model: Any, k: int) -> PulledTarget | None:
    """Return the tendon or joint that an actuator pulls; None for another transmission."""
    transmission, number = mujoco.mjtTrn(int(model.actuator_trntype[k])), int(model.actuator_trnid[k][0])
    if transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return PulledTarget(is_tendon=False, number=number)
    return PulledTarget(is_tendon=True, number=number) if transmission == mujoco.mjtTrn.mjTRN_TENDON else None


def _joints(mujoco: Any, model: Any, target: PulledTarget) -> list[tuple[int, float]]:
    """Return the hinges and slides of a target with their moments; none if it has another joint, or is spatial."""
    pairs = [(target.number, 1.0)]
    if target.is_tendon:
        pairs = list(tendon_joints(mujoco, model, target.number))
    scalar = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return pairs if all(joint >= 0 and int(model.jnt_type[joint]) in scalar for joint, _ in pairs) else []


def _force(mujoco: Any, model: Any, k: int) -> ForceRange:
    """Return the range of an actuator's force before its gear; infinite without a bound.

    The limits of the control bound the force of a motor, which is gain times control: no bias, no dynamics.
    """
    output, control = int(model.actuator_outadr[k]), int(model.actuator_ctrladr[k])
    is_motor = (
        int(model.actuator_biastype[k]) == int(mujoco.mjtBias.mjBIAS_NONE)
        and int(model.actuator_gaintype[k]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        and int(model.actuator_dyntype[k]) == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    low, high = -math.inf, math.inf
    if model.actuator_forcelimited[output]:
        low, high = map(float, model.actuator_forcerange[output])
    if is_motor and model.actuator_ctrllimited[control]:
        least, largest = map(float, model.actuator_ctrlrange[control])
        least, largest = _scaled((least, largest), float(model.actuator_gainprm[k][0]))
        low, high = max(low, least), min(high, largest)
    return low, high


def _joint_forces(
    mujoco: Any, model: Any, pulls: dict[PulledTarget, list[tuple[ForceRange, float]]]
) -> list[tuple[float | None, float | None]]:
    """Return the range (low, high) [N], [N m] of the force on each joint, from forces and gears of the actuators by
    joint or tendon.
    """
    on_joints: dict[int, ForceRange] = {}
    for target, actuators in pulls.items():
        force = _pull(model, target, actuators)
        for joint, moment in _joints(mujoco, model, target):
            on_joints[joint] = _sum(on_joints.get(joint, (0.0, 0.0)), _scaled(force, moment))
    ranges = []
    for joint in range(model.njnt):
        low, high = on_joints.get(joint, (-math.inf, math.inf))
        if model.jnt_actfrclimited[joint]:
            low, high = _within((low, high), model.jnt_actfrcrange[joint])
        ranges.append((low if math.isfinite(low) else None, high if math.isfinite(high) else None))
    return ranges


def _pull(model: Any, target: PulledTarget, actuators: list[tuple[ForceRange, float]]) -> ForceRange:
    """Return the range of the force of all actuators on a joint or tendon, from forces and gears.

    A tendon may limit the sum of the forces before the gears; the least gear then counts for all of them.
    """
    force = (0.0, 0.0)
    if target.is_tendon and model.tendon_actfrclimited[target.number]:
        for each, _ in actuators:
            force = _sum(force, each)
        least_gear = min((gear for _, gear in actuators), key=abs)
        return _scaled(_within(force, model.tendon_actfrcrange[target.number]), least_gear)
    for each, gear in actuators:
        force = _sum(force, _scaled(each, gear))
    return force


def _scaled(force: ForceRange, factor: float) -> ForceRange:
    if factor == 0:
        return 0.0, 0.0
    low, high = sorted(factor * end for end in force)
    return low, high


def _sum(a: ForceRange, b: ForceRange) -> ForceRange:
    return a[0] + b[0], a[1] + b[1]


def _within(force: ForceRange, limits: Any) -> ForceRange:
    low, high = map(float, limits)
    return min(max(force[0], low), high), max(min(force[1], high), low)
