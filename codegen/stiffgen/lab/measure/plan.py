# SPDX-License-Identifier: MIT
"""Plan the motion of a measurement: six frequencies, amplitudes from the wanted deviation, within limits.

The frequencies are such that no second harmonic, sum or difference of two, and no term of third order but those of one
frequency and the squares of others, falls on a frequency: linear, quadratic and most cubic terms stay apart. All fit a
whole number of times into the duration, so that twist and velocity are uncorrelated: a delay fakes no turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import symmetric
from stiffgen.lab.calibrate.calibration import tip_functions
from stiffgen.lab.measure.fit import LINEAR, StiffnessFit
from stiffgen.lab.measure.motion import rotation_vectors
from stiffgen.lab.measure.residual import analyse_residual
from stiffgen.lab.measure.rows import recorded_poses, sensor_poses

PERIODS = (10, 12, 15, 21, 28, 29)
"""Whole periods of x, y, z and of the rotations about them within the duration."""
RAMP = 1.0
"""[s] Time in which the motion grows at the start and dies away at the end."""
_GUESS = np.array([1e-3] * 3 + [1e-2] * 3)
"""Amplitudes [m, rad] from which those of a plan are scaled."""
_SAMPLES_PER_PERIOD = 40
_NEWTON_STEPS = 8
_FOLLOWED = 1e-10
"""[m, rad] error at which a posture has the sensor's pose."""


@dataclass(frozen=True)
class PlanOptions:
    """Wanted measurement.

    Attributes:
        stiffness: (6,) diagonal or (6, 6) symmetric stiffness that is expected at the sensor [N/m, N, N m].
        deviation: standard deviation of the sensor's turn about each axis that is wanted [rad].
        noise: standard deviations of the sensor's forces [N] and moments [N m].
        most_wrench: largest change of force [N] and moment [N m] that motion and stiffness may make.
        duration: of the motion without its ramps [s].
        rate: samples per second [Hz].
        has_bias: readings will have a bias that is not known.

    """

    stiffness: ArrayLike
    deviation: float = float(np.radians(0.1))
    noise: tuple[float, float] = (0.05, 0.002)
    most_wrench: tuple[float, float] = (10.0, 1.0)
    duration: float = 20.0
    rate: float = 200.0
    has_bias: bool = False


@dataclass(frozen=True)
class Plan:
    """PoseMotion to run: time (N) [s], twists (N, 6) [m, rad], q (N, n), amplitudes (6), expected deviation [rad].

    ``limit`` names what keeps the amplitudes smaller than the wanted deviation asks for; empty for nothing.
    """

    time: FloatArray
    twist: FloatArray
    q: FloatArray
    amplitude: FloatArray
    deviation: float
    limit: str

    def to_csv(self) -> str:
        """Return the trajectory file of the FRI client."""
        return rows_of(self.q)


def rows_of(q: FloatArray) -> str:
    """Return joint positions (N, n) row by row, without a header: the trajectory file of the FRI client."""
    return "".join(",".join(f"{each:.9f}" for each in row) + "\n" for row in q)


def plan_excitation(robot: GeneratedRobot, q: ArrayLike, options: PlanOptions) -> Plan:
    """Return the motion about a posture, from rest to rest.

    Raises:
        StiffgenError: an option is out of its range, or a joint would leave its range or exceed its velocity limit.

    """
    start = np.asarray(q, dtype=float)
    if start.shape != (len(robot.chain.coordinates),):
        raise StiffgenError(
            f"--plan: the posture has the shape {start.shape}, the robot {len(robot.chain.coordinates)} joints"
        )
    amplitude, deviation, limit = _amplitudes(_checked_stiffness(options), options)
    time, twist = _sines(amplitude, options)
    path = _follow(robot, start, twist)
    _check_path(robot, path, options.rate)
    return Plan(time=time, twist=twist, q=path, amplitude=amplitude, deviation=deviation, limit=limit)


def _checked_stiffness(options: PlanOptions) -> FloatArray:
    """Return the expected stiffness (6, 6); StiffgenError if an option is out of its range."""
    given = np.asarray(options.stiffness, dtype=float)
    K = symmetric("--plan: the stiffness", np.diag(given) if given.ndim == 1 else given, 6)
    if not (np.linalg.eigvalsh(K) > 0).all():
        raise StiffgenError("--plan: the stiffness must be positive definite")
    numbers = (options.deviation, *options.noise, *options.most_wrench, options.duration, options.rate)
    fewest = _SAMPLES_PER_PERIOD * max(PERIODS)
    if not all(np.isfinite(numbers)) or min(numbers) <= 0 or options.rate * options.duration < fewest:
        raise StiffgenError(
            "--plan: deviation, noise, wrench, duration and rate must be positive, with "
            f"{_SAMPLES_PER_PERIOD} samples per period or more: {fewest} in all"
        )
    return K


def _sines(amplitude: FloatArray, options: PlanOptions) -> tuple[FloatArray, FloatArray]:
    """Return time (N) [s] and twists (N, 6) [m, rad]: six sines with periods of their own, faded in and out in RAMP."""
    count = round(options.rate * (options.duration + 2 * RAMP)) + 1
    time = np.arange(count) / options.rate
    share = np.clip(np.minimum(time, time[-1] - time) / RAMP, 0.0, 1.0)
    fade = share**2 * (3 - 2 * share)  # from 0 to 1, at rest at both ends
    phase = 2 * np.pi * np.array(PERIODS) / options.duration * (time[:, None] - RAMP)
    return time, amplitude * np.sin(phase) * fade[:, None]


def expected_turn(K: FloatArray, amplitude: FloatArray, options: PlanOptions) -> float:
    """Return the largest standard deviation of the turn [rad] that a motion of these amplitudes would leave.

    The columns 1 and a_k sin of N rows have the normal matrix diag(N, N a_k^2 / 2), whose inverse the fit takes.
    """
    rows = options.rate * options.duration
    noise = np.diag(np.repeat(np.square(options.noise), 3))
    information = np.diag([1.0 / rows, *(2.0 / (rows * amplitude**2))])
    fit = StiffnessFit(
        Km=K, load=np.zeros(6), noise=noise, information=information, quadratic=False, residuals=np.zeros((0, 6)),
        growth=1.0,
    )  # fmt: skip
    turn, *_ = analyse_residual(fit, has_bias=options.has_bias).errors
    return float(turn.deviation.max())


def _amplitudes(K: FloatArray, options: PlanOptions) -> tuple[FloatArray, float, str]:
    """Return the amplitudes (6) [m], [rad], the deviation [rad] that they leave, and the limit that binds, if any.

    All amplitudes are one factor times a guess; the deviation is inversely proportional to the factor.
    """
    wanted = expected_turn(K, _GUESS, options) / options.deviation
    wrench = np.abs(K) @ _GUESS  # largest one of the guessed amplitudes [N], [N m]
    most_force, most_moment = options.most_wrench
    most = {  # the factors at which a limit is met
        f"force of {most_force:g} N": most_force / float(np.linalg.norm(wrench[:3])),
        f"moment of {most_moment:g} N m": most_moment / float(np.linalg.norm(wrench[3:])),
        f"{1000 * LINEAR[0]:g} mm": LINEAR[0] / float(np.linalg.norm(_GUESS[:3])),
        f"{1000 * LINEAR[1]:g} mrad": LINEAR[1] / float(np.linalg.norm(_GUESS[3:])),
    }
    limit = min(most, key=lambda name: most[name])
    amplitude = min(wanted, most[limit]) * _GUESS
    return amplitude, expected_turn(K, amplitude, options), limit if wanted > most[limit] else ""


def _follow(robot: GeneratedRobot, start: FloatArray, twist: FloatArray) -> FloatArray:
    """Return joint positions (N, n) whose sensor poses are the start's, moved by the twists; Gauss-Newton steps."""
    goal = sensor_poses(robot, start[None])[0] @ recorded_poses(twist, "vector")
    path = np.repeat(start[None], len(twist), axis=0)
    for _ in range(_NEWTON_STEPS):
        here = sensor_poses(robot, path)
        error = _pose_errors(here, goal)
        if np.abs(error).max() < _FOLLOWED:
            return path
        J = _sensor_jacobians(robot, path, here[:, :3, 3])
        path = path + np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-6), error)
    tip = np.asarray(tip_functions(robot).forward_kinematics(start), dtype=float)
    raise StiffgenError(
        f"--plan: the arm cannot follow the motion at this posture (left: {np.abs(error).max():.2g} of m, rad, tip at "
        f"{np.round(tip[:3, 3], 3).tolist()} m); choose one away from singular postures"
    )


def _pose_errors(here: FloatArray, goal: FloatArray) -> FloatArray:
    """Return displacements and rotation vectors (N, 6) from poses to others (N, 4, 4), in base axes."""
    R = here[:, :3, :3]
    in_own_axes = rotation_vectors(np.swapaxes(R, 1, 2) @ goal[:, :3, :3])
    return np.concatenate([goal[:, :3, 3] - here[:, :3, 3], np.einsum("nij,nj->ni", R, in_own_axes)], axis=1)


def _sensor_jacobians(robot: GeneratedRobot, path: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the hybrid Jacobians (N, 6, n) of the sensor's origins (N, 3): the tip's, with v + w x (way to them)."""
    functions: Any = tip_functions(robot)
    J = np.array(functions.hybrid.jacobian(path), dtype=float)
    tip = np.asarray(functions.forward_kinematics(path), dtype=float)[:, :3, 3]
    J[:, :3] += np.cross(J[:, 3:], (origin - tip)[:, :, None], axis=1)
    return J


def _check_path(robot: GeneratedRobot, path: FloatArray, rate: float) -> None:
    """Refuse a path (rows, n) [rad] sampled at `rate` [Hz] beyond a joint's range or velocity limit."""
    fastest = np.abs(np.diff(path, axis=0)).max(axis=0) * rate
    for k, each in enumerate(robot.chain.coordinates):
        if path[:, k].min() < each.lower or path[:, k].max() > each.upper:
            raise StiffgenError(f"--plan: joint '{each.name}' would leave its range; choose another posture")
        if fastest[k] > each.velocity:
            raise StiffgenError(
                f"--plan: joint '{each.name}' would reach {fastest[k]:.3g} rad/s of {each.velocity:.3g}; "
                "choose another posture, or a larger --deviation"
            )
