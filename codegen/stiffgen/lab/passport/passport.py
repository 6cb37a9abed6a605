# SPDX-License-Identifier: MIT
"""Compute a stiffness passport: a table of quantities over postures, with what each was verified against."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.control.presets import motor_tables
from stiffgen.core.errors import OutputError, StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.arms.series import in_series
from stiffgen.lab.passport.loop import (
    MOST_DELAY,
    Arms,
    LoopTiming,
    contact_limit,
    damping_attained,
    passive_limit,
    rendered_limit,
    stable_limit,
    step_torque,
)
from stiffgen.lab.passport.postures import recorded_postures, spread_postures
from stiffgen.lab.passport.statics import (
    DIRECTIONS,
    UNITS,
    available_force,
    buckling_force,
    errors_by_friction,
    softest,
)

ROTATION = 0.05
"""[m^2] rotational over translational stiffness of the springs: 20 N m/rad beside 400 N/m."""
_GRAVITY = (0.0, 0.0, -9.81)
"""Acceleration of free fall in base axes [m/s^2]: the base stands upright."""
_CAMPAIGN = "MuJoCo, eight arms"


@dataclass(frozen=True)
class Quantity:
    """Column of a passport: values (P), unit, meaning, and what it was verified against.

    ``is_error``: the largest value is the worst, of a share that is lost, or of a disturbance.
    """

    name: str
    unit: str
    meaning: str
    verified: str
    values: FloatArray
    is_error: bool = False

    @property
    def worst(self) -> int:
        """Posture with the smallest value, or the largest error."""
        return int(self.values.argmax() if self.is_error else self.values.argmin())


@dataclass(frozen=True)
class Passport:
    """Quantities of a robot over postures q (P, n), with the tip's positions (P, 3) [m] and the loop's timing.

    ``force`` (P, 6) [N] has the columns of DIRECTIONS; None if no effort limit bounds it. ``unlimited`` are the joints
    whose effort limit the robot's file does not state: they bound no force.
    """

    robot: str
    joints: tuple[str, ...]
    timing: LoopTiming
    q: FloatArray
    tip: FloatArray
    quantities: tuple[Quantity, ...]
    force: FloatArray | None
    source: str
    unlimited: tuple[str, ...] = ()

    def quantity(self, name: str) -> Quantity:
        """Return a quantity."""
        return next(each for each in self.quantities if each.name == name)

    def __getitem__(self, name: str) -> FloatArray:
        """Return the values of a quantity (P)."""
        return self.quantity(name).values

    def to_csv(self) -> str:
        """Return the table: a row per posture, joint positions first."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        named = [f"{each.name} [{each.unit}]" for each in self.quantities]
        writer.writerow([*self.joints, "tip x [m]", "tip y [m]", "tip z [m]", *named])
        columns = np.column_stack([self.q, self.tip, *(each.values for each in self.quantities)])
        writer.writerows([[f"{value:.6g}" for value in row] for row in columns])
        return text.getvalue()


@dataclass(frozen=True)
class PassportOptions:
    """Timing of the loop, gains kp and stiffnesses kc of elastic gears [N m/rad] (one for all, or n), postures.

    ``friction``: sliding friction of the joints [N m or N] (one for all, or n).
    """

    timing: LoopTiming = field(default_factory=LoopTiming)
    kp: tuple[float, ...] | None = None
    kc: tuple[float, ...] | None = None
    recording: Path | None = None
    friction: tuple[float, ...] | None = None


def make_passport(robot: GeneratedRobot, options: PassportOptions, q: ArrayLike | None = None) -> Passport:
    """Compute the passport of a robot.

    Args:
        robot: with one tip, a fixed base, masses, and a compiled Python module.
        options: timing, gains, recording.
        q: postures (P, n) in place of those of the options.

    Raises:
        StiffgenError: the robot or an option does not fit.
        RecordingError: the recording cannot be read.

    """
    _check(robot, options)
    chain, module = robot.chain, robot.module
    source = str(options.recording.name) if options.recording else "spread over the joints' ranges"
    if q is not None:
        postures = np.asarray(q, dtype=float)
    elif options.recording:
        postures = recorded_postures(options.recording, chain)
    else:
        postures = spread_postures(chain)
    motors, n = motor_tables(chain), chain.dof
    arms = Arms(
        module.mass_matrix(postures) + np.diag(motors.motor_inertia),
        module.hybrid.jacobian(postures),
        ROTATION,
    )
    quantities = [*_of_loop(arms, options.timing)]
    gravity = module.gravity.gradient(postures, np.array(_GRAVITY))
    available = available_force(arms.jacobian, gravity, np.array(module.EFFORT))
    force = available if np.isfinite(available).all() else None
    if force is not None:
        quantities += _of_force(force)
    rendered = next(each.values for each in quantities if each.name == "rendered")
    Kq = arms.springs(rendered)
    if options.kc is not None:
        quantities.append(_lost_to_gears(arms, Kq, _diagonal(options.kc, n)))
    if options.friction is not None:
        quantities += _of_friction(arms, Kq, np.broadcast_to(np.array(options.friction), n))
    if options.kp is not None:
        quantities += _of_gains(robot, options, arms, postures)
    tip = module.forward_kinematics(postures)[:, :3, 3]
    unlimited = tuple(each.name for each in chain.coordinates if not np.isfinite(each.effort))
    return Passport(
        robot.name, chain.coordinate_names, options.timing, postures, tip, tuple(quantities), force, source, unlimited
    )


def _check(robot: GeneratedRobot, options: PassportOptions) -> None:
    """Refuse robots and options without a passport."""
    robot.require_doubles("'stiffgen passport'")
    chain, timing = robot.chain, options.timing
    if chain.floating or chain.runtime_tool or len(chain.tips) > 1 or chain.loops:
        raise StiffgenError(
            f"{robot.folder}: a passport takes a fixed base, one tip, no tool at run time and no closed loops; "
            "generate such a folder, with another --name"
        )
    names = {kernel.qualified_name for kernel in robot.table}
    needed = {"mass_matrix", "hybrid_jacobian", "gravity_gradient", "hybrid_kinematic_stiffness"}
    if needed - names:
        raise OutputError(
            f"{robot.folder}: has no function {', '.join(sorted(needed - names))}; generate it with masses and all "
            "kernels"
        )
    if not 1.0 <= timing.rate <= 1e5:
        raise StiffgenError(f"--rate {timing.rate:g}: must lie between 1 and 100000 Hz")
    if not 0 <= timing.delay <= MOST_DELAY:
        raise StiffgenError(f"--delay {timing.delay}: must lie between 0 and {MOST_DELAY} samples")
    if not 0.0 <= timing.quantum <= 0.1:
        raise StiffgenError(f"--sensor {timing.quantum:g}: an encoder step lies between 0 and 0.1 rad or m")
    _check_joints(options, chain.dof)


def _check_joints(options: PassportOptions, n: int) -> None:
    """Refuse numbers that are not one per joint, or out of their range."""
    for flag, values in (("--kp", options.kp), ("--kc", options.kc)):
        if values is not None and (len(values) not in (1, n) or not all(0 < each < 1e12 for each in values)):
            raise StiffgenError(f"{flag}: takes one positive number, or {n} with commas [N m/rad or N/m]")
    values = options.friction
    if values is not None and (len(values) not in (1, n) or not all(0 <= each < 1e6 for each in values)):
        raise StiffgenError(f"--friction: takes one number from 0, or {n} with commas [N m or N], or a table")


def _diagonal(values: tuple[float, ...], n: int) -> FloatArray:
    return np.diag(np.broadcast_to(np.array(values, dtype=float), n))


def _of_loop(arms: Arms, timing: LoopTiming) -> tuple[Quantity, ...]:
    """Return the limits of the sampled loop, and the damping at the rendered stiffness."""
    rendered, passive, stable = (limit(arms, timing) for limit in (rendered_limit, passive_limit, stable_limit))
    attained = damping_attained(arms, rendered, timing)
    quantities = (
        Quantity("rendered", "N/m", "stiffness that the impedance controller renders in full",
                 "the compiled controller, eight arms", rendered),
        Quantity("passive", "N/m", "late torques put out no work in slow motion",
                 f"work of slow cycles, {_CAMPAIGN}", passive),
        Quantity("stable", "N/m", "the sampled loop's roots are inside the unit circle",
                 f"energy after a push, {_CAMPAIGN}", stable),
        Quantity("limit", "N/m", "passive and stable", f"both, {_CAMPAIGN}", np.minimum(passive, stable)),
        Quantity("damping", "1", "least damping ratio of all modes at the rendered stiffness",
                 f"decay after a push, {_CAMPAIGN}", attained),
        Quantity("contact", "N/m", "stiffest wall on which the tip does not chatter, at the rendered stiffness",
                 f"energy in contact, {_CAMPAIGN}", contact_limit(arms, rendered, timing)),
    )  # fmt: skip
    if not timing.quantum:
        return quantities
    step = Quantity("step torque", "N m", "damping torque of one encoder step, at the rendered stiffness",
                    "the compiled controller", step_torque(arms, rendered, timing), is_error=True)  # fmt: skip
    return (*quantities, step)


def _of_force(force: FloatArray) -> list[Quantity]:
    """Return the force that the motors leave in each direction, from (P, 6) [N]."""
    return [
        Quantity(f"force {name}", "N", f"largest force of the tip along {name}, at rest",
                 f"inverse dynamics, {_CAMPAIGN}", force[:, k])
        for k, name in enumerate(DIRECTIONS)
    ]  # fmt: skip


def _lost_to_gears(arms: Arms, Kq: FloatArray, Kc: FloatArray) -> Quantity:
    """Return the share of the springs' stiffness that gears of the stiffness Kc take [%]."""
    lost = 100.0 * (1.0 - softest(arms.jacobian, in_series(Kq, Kc)) / softest(arms.jacobian, Kq))
    meaning = "share of the rendered stiffness that elastic gears take, softest direction"
    return Quantity("lost to gears", "%", meaning, "energy of motors and links, solved", lost, is_error=True)


def _of_friction(arms: Arms, Kq: FloatArray, friction: FloatArray) -> tuple[Quantity, ...]:
    """Return what friction leaves at the rendered stiffness: the error of a tip at rest, and of its force on a wall."""
    rest, force = errors_by_friction(arms.jacobian, Kq, friction)
    return (
        Quantity("rest error", "mm", "largest error along x, y or z at which friction holds the tip, at the rendered "
                 "stiffness", "equilibria of spring and friction, solved", 1e3 * rest, is_error=True),
        Quantity("force error", "N", "largest error of the force on a rigid wall across x, y or z by friction",
                 "equilibria on a wall, solved", force, is_error=True),
    )  # fmt: skip


def _of_gains(
    robot: GeneratedRobot, options: PassportOptions, arms: Arms, postures: FloatArray
) -> tuple[Quantity, ...]:
    """Return what joint gains give: the tip's softest direction, and the force under which the arm buckles."""
    assert options.kp is not None
    Kth = _diagonal(options.kp, robot.chain.dof)
    behind = ""
    if options.kc is not None:
        Kth, behind = in_series(Kth, _diagonal(options.kc, robot.chain.dof)), " (behind the gears)"
    Kth = np.broadcast_to(Kth, arms.mass.shape)
    wrenches = np.concatenate([UNITS, np.zeros((6, 3))], axis=1)
    kinematic = robot.module.hybrid.kinematic_stiffness(postures[:, None], wrenches)
    return (
        Quantity("by kp", "N/m", f"tip stiffness by the joint gains{behind}, softest direction, without load",
                 "springs in the joints, solved", softest(arms.jacobian, Kth)),
        Quantity("buckling", "N", f"least force on the tip along x, y or z that the gains{behind} hold no longer",
                 "curvature of the energy, by differences", buckling_force(kinematic, Kth)),
    )  # fmt: skip
