# SPDX-License-Identifier: MIT
"""Compute a stiffness passport: a table of quantities over postures, with what each was verified against."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.control.presets import motor_tables
from stiffgen.core.errors import OutputError, StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.chain import Chain
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
    postures = _postures(chain, options) if q is None else np.asarray(q, dtype=float)
    arms = Arms(
        mass=module.mass_matrix(postures) + np.diag(motor_tables(chain).motor_inertia),
        jacobian=module.hybrid.jacobian(postures),
        rotation=ROTATION,
    )
    gravity = module.gravity.gradient(postures, np.array(_GRAVITY))
    available = available_force(arms.jacobian, gravity, np.array(module.EFFORT))
    force = available if np.isfinite(available).all() else None
    return Passport(
        robot=robot.name,
        joints=chain.coordinate_names,
        timing=options.timing,
        q=postures,
        tip=module.forward_kinematics(postures)[:, :3, 3],
        quantities=tuple(_quantities(robot, options, arms, postures, force)),
        force=force,
        source=str(options.recording.name) if options.recording else "spread over the joints' ranges",
        unlimited=tuple(each.name for each in chain.coordinates if not np.isfinite(each.effort)),
    )


def _postures(chain: Chain, options: PassportOptions) -> FloatArray:
    """Return the postures (P, n) of the options' recording, or spread over the joints' ranges."""
    return recorded_postures(options.recording, chain) if options.recording else spread_postures(chain)


def _quantities(
    robot: GeneratedRobot, options: PassportOptions, arms: Arms, postures: FloatArray, force: FloatArray | None
) -> Iterator[Quantity]:
    """Yield the columns of a passport; ``force`` (P, 6) is the one that the motors leave, None without a bound."""
    rendered = rendered_limit(arms, options.timing)
    yield from _of_loop(arms, options.timing, rendered)
    if force is not None:
        yield from _of_force(force)
    Kq, n = arms.springs(rendered), robot.chain.dof
    if options.kc is not None:
        yield _lost_to_gears(arms, Kq, _diagonal(options.kc, n))
    if options.friction is not None:
        yield from _of_friction(arms, Kq, np.broadcast_to(np.array(options.friction), n))
    if options.kp is not None:
        yield from _of_gains(robot, options, arms, postures)


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


def _of_loop(arms: Arms, timing: LoopTiming, rendered: FloatArray) -> Iterator[Quantity]:
    """Yield the limits of the sampled loop, and what it attains at the rendered stiffness (P) [N/m]."""
    passive, stable = passive_limit(arms, timing), stable_limit(arms, timing)
    yield Quantity(
        name="rendered",
        unit="N/m",
        meaning="stiffness that the impedance controller renders in full",
        verified="the compiled controller, eight arms",
        values=rendered,
    )
    yield Quantity(
        name="passive",
        unit="N/m",
        meaning="late torques put out no work in slow motion",
        verified=f"work of slow cycles, {_CAMPAIGN}",
        values=passive,
    )
    yield Quantity(
        name="stable",
        unit="N/m",
        meaning="the sampled loop's roots are inside the unit circle",
        verified=f"energy after a push, {_CAMPAIGN}",
        values=stable,
    )
    yield Quantity(
        name="limit",
        unit="N/m",
        meaning="passive and stable",
        verified=f"both, {_CAMPAIGN}",
        values=np.minimum(passive, stable),
    )
    yield Quantity(
        name="damping",
        unit="1",
        meaning="least damping ratio of all modes at the rendered stiffness",
        verified=f"decay after a push, {_CAMPAIGN}",
        values=damping_attained(arms, rendered, timing),
    )
    yield Quantity(
        name="contact",
        unit="N/m",
        meaning="stiffest wall on which the tip does not chatter, at the rendered stiffness",
        verified=f"energy in contact, {_CAMPAIGN}",
        values=contact_limit(arms, rendered, timing),
    )
    if timing.quantum:
        yield Quantity(
            name="step torque",
            unit="N m",
            meaning="damping torque of one encoder step, at the rendered stiffness",
            verified="the compiled controller",
            values=step_torque(arms, rendered, timing),
            is_error=True,
        )


def _of_force(force: FloatArray) -> Iterator[Quantity]:
    """Yield the force that the motors leave in each direction, from (P, 6) [N]."""
    for name, values in zip(DIRECTIONS, force.T, strict=True):
        yield Quantity(
            name=f"force {name}",
            unit="N",
            meaning=f"largest force of the tip along {name}, at rest",
            verified=f"inverse dynamics, {_CAMPAIGN}",
            values=values,
        )


def _lost_to_gears(arms: Arms, Kq: FloatArray, Kc: FloatArray) -> Quantity:
    """Return the share of the springs' stiffness that gears of the stiffness Kc take [%]."""
    left = softest(arms.jacobian, in_series(Kq, Kc)) / softest(arms.jacobian, Kq)
    return Quantity(
        name="lost to gears",
        unit="%",
        meaning="share of the rendered stiffness that elastic gears take, softest direction",
        verified="energy of motors and links, solved",
        values=100.0 * (1.0 - left),
        is_error=True,
    )


def _of_friction(arms: Arms, Kq: FloatArray, friction: FloatArray) -> Iterator[Quantity]:
    """Yield what friction leaves at the rendered stiffness: the error of a tip at rest, and of its force on a wall."""
    rest, force = errors_by_friction(arms.jacobian, Kq, friction)  # [m], [N]
    yield Quantity(
        name="rest error",
        unit="mm",
        meaning="largest error along x, y or z at which friction holds the tip, at the rendered stiffness",
        verified="equilibria of spring and friction, solved",
        values=1e3 * rest,
        is_error=True,
    )
    yield Quantity(
        name="force error",
        unit="N",
        meaning="largest error of the force on a rigid wall across x, y or z by friction",
        verified="equilibria on a wall, solved",
        values=force,
        is_error=True,
    )


def _of_gains(robot: GeneratedRobot, options: PassportOptions, arms: Arms, postures: FloatArray) -> Iterator[Quantity]:
    """Yield what joint gains give: the tip's softest direction, and the force under which the arm buckles."""
    assert options.kp is not None
    Kth, behind = _diagonal(options.kp, robot.chain.dof), ""
    if options.kc is not None:
        Kth, behind = in_series(Kth, _diagonal(options.kc, robot.chain.dof)), " (behind the gears)"
    Kth = np.broadcast_to(Kth, arms.mass.shape)
    unit_forces = np.concatenate([UNITS, np.zeros((6, 3))], axis=1)  # (6, 6): wrenches along DIRECTIONS
    kinematic = robot.module.hybrid.kinematic_stiffness(postures[:, None], unit_forces)  # (P, 6, n, n)
    yield Quantity(
        name="by kp",
        unit="N/m",
        meaning=f"tip stiffness by the joint gains{behind}, softest direction, without load",
        verified="springs in the joints, solved",
        values=softest(arms.jacobian, Kth),
    )
    yield Quantity(
        name="buckling",
        unit="N",
        meaning=f"least force on the tip along x, y or z that the gains{behind} hold no longer",
        verified="curvature of the energy, by differences",
        values=buckling_force(kinematic, Kth),
    )
