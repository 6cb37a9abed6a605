# SPDX-License-Identifier: MIT
"""Simulate a noisy recording of pushes against an arm with unknown task stiffness and tool.

The arm is at rest under a load (the wrench F), and a push dF is added. Its joints deflect by dq:

    (Kq(q, r, F, K) + Kp) dq = J(q, r)^T dF

K (6, 6) is the symmetric task stiffness in base axes, r (3,) the position of the tool relative to the flange [m], Kp
the known stiffness of the posture spring. The recording contains q, F, dF and dq. Every channel of F, dF and dq has
noise in proportion to its root mean square.

The search finds the most likely K and r. At the true values the residual torque,

    t = (Kq + Kp) dq - J^T dF,

is noise alone. Its covariance is S = (Kq + Kp) Vq (Kq + Kp) + J^T Vf J + Sl. Vq and Vf are the variances of the noise
on dq and dF; Sl is the contribution of the noise on F through Kq. The loss is the mean of t^T S^-1 t / 2 +
log(det S) / 2. Ordinary least squares of t would treat the noise on dq as motion and give too low a stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POSTURE = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0])
"""Joint positions about which the arm works, well away from singularities [rad]."""
POSTURE_STIFFNESS = 5.0  # N m/rad, of every joint, known
SCALE = np.sqrt([1000.0, 1000.0, 1000.0, 50.0, 50.0, 50.0])  # of an arm's stiffness: N/m and N m/rad
UPPER = np.triu_indices(6)
LOWER = np.tril_indices(6)
START = np.concatenate([np.eye(6)[LOWER], np.zeros(3)])
"""Start of the search: K = diag(SCALE^2), written K = S L L^T S with L lower triangular, and no tool."""


@dataclass(frozen=True)
class Recording:
    """Posture (N, 7) [rad], load and push (N, 6) [N, N m], deflection (N, 7) [rad]; and the truth behind it.

    ``load_covariance`` (N, 7, 7) [(N m)^2] is what the noise on F adds to S, for a tool at the flange.
    """

    q: Array
    wrench: Array
    push: Array
    deflection: Array
    task_stiffness: Array
    tool: Array
    noise: float
    load_covariance: Array

    @property
    def deflection_variance(self) -> Array:
        """Return the variance of the noise on each joint's deflection [rad^2]."""
        return np.asarray(self.noise**2 * np.mean(self.deflection**2, axis=0))

    @property
    def push_variance(self) -> Array:
        """Return the variance of the noise on each component of a push [N^2, (N m)^2]."""
        return np.asarray(self.noise**2 * np.mean(self.push**2, axis=0))


def pose_of(tool: Array) -> Array:
    """Return the tool's frame (4, 4) in the flange: moved by ``tool`` [m], not turned."""
    pose = np.eye(4)
    pose[:3, 3] = tool
    return pose


def true_stiffness(random: np.random.Generator) -> Array:
    """Return a full symmetric, positive definite task stiffness, no entry of which is near zero."""
    while True:
        coupling = np.triu(random.uniform(0.12, 0.4, (6, 6)) * random.choice([-1, 1], (6, 6)), 1)
        normal = np.eye(6) + coupling + coupling.T
        if np.linalg.eigvalsh(normal).min() > 0.2:
            size = SCALE * random.uniform(0.8, 1.2, 6)
            return np.asarray(normal * np.outer(size, size))


def record(robot: ModuleType, count: int, noise: float, *, turning: bool = True, seed: int = 1) -> Recording:
    """Simulate a recording.

    Args:
        robot: the generated robot, with a tool at run time.
        count: number of pushes.
        noise: standard deviation over the root mean square of a channel.
        turning: the pushes turn the tool, too; without, each moves it and does not turn it.
        seed: of the random numbers.

    """
    random = np.random.default_rng(seed)
    stiffness, tool = true_stiffness(random), np.array([0.04, -0.03, 0.15])
    q = POSTURE + random.uniform(-0.4, 0.4, (count, robot.DOF))
    wrench = random.normal(size=(count, 6)) * [15.0, 15.0, 15.0, 2.0, 2.0, 2.0]
    motion = random.normal(size=(count, 6)) * [0.005, 0.005, 0.005, 0.03, 0.03, 0.03]  # m, rad
    if not turning:
        motion[:, 3:] = 0
    jacobian = robot.hybrid.jacobian(q, pose_of(tool))
    joint = robot.hybrid.joint_stiffness(q, pose_of(tool), wrench, stiffness) + POSTURE_STIFFNESS * np.eye(robot.DOF)
    give = np.linalg.solve(joint, jacobian.swapaxes(1, 2))  # dq = give dF
    push = np.linalg.solve(jacobian @ give, motion[:, :, None])[:, :, 0]
    deflection = np.einsum("nij,nj->ni", give, push)

    def noisy(values: Array) -> Array:
        return np.asarray(values + noise * np.sqrt(np.mean(values**2, axis=0)) * random.normal(size=values.shape))

    load, push, deflection = noisy(wrench), noisy(push), noisy(deflection)
    variance = noise**2 * np.mean(load**2, axis=0)
    by_load = robot.hybrid.joint_stiffness(q, np.eye(4), np.eye(6)[:, None], np.zeros((6, 6))) @ deflection[:, :, None]
    load_covariance = np.einsum("k,kni,knj->nij", variance, by_load[..., 0], by_load[..., 0])
    return Recording(q, load, push, deflection, stiffness, tool, noise, load_covariance)


def residuals(robot: ModuleType, recording: Recording, entries: Array, tool: Array) -> tuple[Array, Array]:
    """Torque left over (N, 7) [N m] and its covariance (N, 7, 7), for the 21 upper entries of K and a tool."""
    stiffness = np.zeros((6, 6))
    stiffness[UPPER] = entries  # the lower triangle is not read
    joint = robot.hybrid.joint_stiffness(recording.q, pose_of(tool), recording.wrench, stiffness)
    joint += POSTURE_STIFFNESS * np.eye(robot.DOF)
    jacobian = robot.hybrid.jacobian(recording.q, pose_of(tool))
    left = np.einsum("nij,nj->ni", joint, recording.deflection) - np.einsum("nki,nk->ni", jacobian, recording.push)
    covariance = joint * recording.deflection_variance @ joint
    covariance += jacobian.swapaxes(1, 2) * recording.push_variance @ jacobian
    return left, covariance + recording.load_covariance


@dataclass(frozen=True)
class Certainty:
    """Information of a recording about K's 21 upper entries and the tool: standard deviations, singular values.

    The singular values are those of the residuals' derivative, with every parameter in units of its usual size
    and torques in units of their noise.
    """

    stiffness: Array
    tool: Array
    singular_values: Array


def certainty(robot: ModuleType, recording: Recording, stiffness: Array, tool: Array) -> Certainty:
    """Return standard deviations at a solution, from the derivative of the torque left over in units of its noise."""
    at = np.concatenate([stiffness[UPPER], tool])
    size = np.concatenate([np.outer(SCALE, SCALE)[UPPER], np.full(3, 0.1)])
    whiten = np.linalg.inv(np.linalg.cholesky(residuals(robot, recording, at[:21], at[21:])[1]))
    columns = []
    for k, step in enumerate(1e-4 * size):  # K enters linearly, the tool nearly so: differences lose nothing
        change = step * np.eye(len(at))[k]
        difference = residuals(robot, recording, (at + change)[:21], (at + change)[21:])[0]
        difference -= residuals(robot, recording, (at - change)[:21], (at - change)[21:])[0]
        columns.append(np.einsum("nij,nj->ni", whiten, difference).ravel() * size[k] / (2 * step))
    _, singular, directions = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    spread = np.sqrt(((directions / singular[:, None]) ** 2).sum(axis=0)) * size
    entries = np.zeros((6, 6))
    entries[UPPER] = spread[:21]
    return Certainty(np.triu(entries) + np.triu(entries, 1).T, spread[21:], singular)
