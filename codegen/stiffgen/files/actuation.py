# SPDX-License-Identifier: MIT
"""Actuators of a compiled MuJoCo model: range of their force on each joint, reflected inertia, joints driven."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

ForceRange = tuple[float, float]


def actuation(mujoco: Any, model: Any) -> dict[str, Any]:
    """Return the actuators' effect on the joints.

    ``forces`` has the range of the force on each joint, None for an end without a bound. ``armatures`` has the inertia
    that the actuators reflect to it. ``driven`` has the joints of each actuator, [] where no joint is its target.
    ``laws`` names the actuators whose force depends on the state, and ``disabled`` those of a group that is disabled.
    """
    pulls: dict[tuple[bool, int], list[tuple[ForceRange, float]]] = {}
    armatures = [0.0] * int(model.njnt)
    driven, laws, disabled = [], [], []
    for k in range(len(model.actuator_trntype)):
        target = _target(mujoco, model, k)
        joints = [] if target is None else _joints(mujoco, model, target)
        name, gear = model.actuator(k).name or f"actuator{k}", float(model.actuator_gear[k][0])
        inertia = gear**2 * float(model.actuator_armature[k])
        driven.append({"name": name, "joints": [joint for joint, _ in joints]})
        if not _is_plain(mujoco, model, k):
            laws.append(name)
        if is_disabled := _is_disabled(model, k):
            disabled.append(name)
        if target is None or not joints:
            continue
        pulls.setdefault(target, []).append(((0.0, 0.0) if is_disabled else _force(mujoco, model, k), gear))
        if not target[0]:
            armatures[target[1]] += inertia
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


def _target(mujoco: Any, model: Any, k: int) -> tuple[bool, int] | None:
    """Return whether an actuator pulls a tendon, and the tendon or joint; None for another transmission."""
    transmission, target = mujoco.mjtTrn(int(model.actuator_trntype[k])), int(model.actuator_trnid[k][0])
    if transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return False, target
    return (True, target) if transmission == mujoco.mjtTrn.mjTRN_TENDON else None


def _joints(mujoco: Any, model: Any, target: tuple[bool, int]) -> list[tuple[int, float]]:
    """Return the hinges and slides of a target with their moments; none if it has another joint, or is spatial."""
    is_tendon, number = target
    pairs = list(tendon_joints(mujoco, model, number)) if is_tendon else [(number, 1.0)]
    scalar = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return pairs if all(joint >= 0 and int(model.jnt_type[joint]) in scalar for joint, _ in pairs) else []


def _force(mujoco: Any, model: Any, k: int) -> ForceRange:
    """Return the range of an actuator's force before its gear; infinite without a bound."""
    output, control = int(model.actuator_outadr[k]), int(model.actuator_ctrladr[k])
    limits, commands = model.actuator_forcerange[output], model.actuator_ctrlrange[control]
    laws = (
        (model.actuator_biastype[k], mujoco.mjtBias.mjBIAS_NONE),
        (model.actuator_gaintype[k], mujoco.mjtGain.mjGAIN_FIXED),
        (model.actuator_dyntype[k], mujoco.mjtDyn.mjDYN_NONE),
    )
    gain = float(model.actuator_gainprm[k][0])
    force = (float(limits[0]), float(limits[1])) if model.actuator_forcelimited[output] else (-math.inf, math.inf)
    if model.actuator_ctrllimited[control] and all(int(kind) == int(motor) for kind, motor in laws):
        least, largest = _scaled((float(commands[0]), float(commands[1])), gain)
        force = max(force[0], least), min(force[1], largest)
    return force


def _joint_forces(
    mujoco: Any, model: Any, pulls: dict[tuple[bool, int], list[tuple[ForceRange, float]]]
) -> list[tuple[float | None, float | None]]:
    """Return the range (low, high) [N], [N m] of the force on each joint, from forces and gears of the actuators by
    joint or tendon.
    """
    on_joints: dict[int, ForceRange] = {}
    for target, actuators in pulls.items():
        is_tendon, number = target
        force = (0.0, 0.0)
        if is_tendon and model.tendon_actfrclimited[number]:  # the sum before the gears is limited
            for each, _ in actuators:
                force = _sum(force, each)
            gear = min((gear for _, gear in actuators), key=abs)
            force = _scaled(_within(force, model.tendon_actfrcrange[number]), gear)
        else:
            for each, gear in actuators:
                force = _sum(force, _scaled(each, gear))
        for joint, moment in _joints(mujoco, model, target):
            on_joints[joint] = _sum(on_joints.get(joint, (0.0, 0.0)), _scaled(force, moment))
    ranges = []
    for joint in range(model.njnt):
        low, high = on_joints.get(joint, (-math.inf, math.inf))
        if model.jnt_actfrclimited[joint]:
            low, high = _within((low, high), model.jnt_actfrcrange[joint])
        ranges.append((low if math.isfinite(low) else None, high if math.isfinite(high) else None))
    return ranges


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
