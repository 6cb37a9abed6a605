# SPDX-License-Identifier: MIT
"""Draw random states and arguments for the comparison of kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from stiffgen.robot.chain import Chain
from stiffgen.robot.geometry import FloatArray
from stiffgen.symbolic.arguments import Argument, configuration_arguments
from stiffgen.symbolic.joint_potentials import JOINT_POTENTIALS
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.potentials import SpringOptions


@dataclass(frozen=True)
class Samples:
    """Random states: q within the limits, wrenches, symmetric and general task stiffness, and potential data."""

    # More than twelve fields: one for each argument of a kernel, found by its name.
    q: FloatArray
    wrench: FloatArray
    task_stiffness: FloatArray
    general_stiffness: FloatArray
    tool_pose: FloatArray
    equilibrium: FloatArray
    translation_stiffness: FloatArray
    rotation_stiffness: FloatArray
    stiffness: FloatArray
    posture: FloatArray
    posture_stiffness: FloatArray
    lower: FloatArray
    upper: FloatArray
    zone: FloatArray
    limit_stiffness: FloatArray
    velocity: FloatArray
    gravity: FloatArray
    base_pose: FloatArray
    force_limit: FloatArray
    moment_limit: FloatArray
    direction: FloatArray
    chain: Chain

    @staticmethod
    def draw(chain: Chain, count: int, seed: int) -> Samples:
        """Draw configurations uniformly (unbounded joints: one turn, one metre), wrenches of tens of N and some N m."""
        random = np.random.default_rng(seed)
        reach = [math.pi if c.type != "prismatic" else 1.0 for c in chain.coordinates]
        lower = [max(c.lower, -r) for c, r in zip(chain.coordinates, reach, strict=True)]
        upper = [min(c.upper, r) for c, r in zip(chain.coordinates, reach, strict=True)]
        # Limits entirely beyond the reach: sample at the nearer limit.
        upper = [max(a, b) for a, b in zip(lower, upper, strict=True)]
        general = random.normal(size=(count, 6, 6)) * 100 + np.diag([700.0, 700, 800, 30, 30, 30])
        q = random.uniform(lower, upper, (count, len(chain.coordinates)))
        if chain.loops:  # the loops' functions have singularities; near the closed configuration there are none
            q = np.array(chain.start) + random.uniform(-0.15, 0.15, q.shape)
        # Each joint in turn is at or beyond its lower and its upper limit; sometimes none of them is.
        joints = np.random.default_rng([seed, 1])
        turn = (np.arange(count)[:, None] + np.arange(q.shape[1])) % 2 == 0
        odd = np.arange(count)[:, None] % 4 == 3
        at_lower = np.where(odd, joints.random(q.shape) < 0.5, turn)
        at_upper = np.where(odd, joints.random(q.shape) < 0.5, ~turn)
        near, away = joints.uniform(-0.2, 0.15, (2, *q.shape)), joints.uniform(0.5, 1.5, (2, *q.shape))
        return Samples(
            q=q,
            wrench=random.normal(size=(count, 6)) * np.array([30.0, 30, 30, 10, 10, 10]),
            task_stiffness=(general + general.transpose(0, 2, 1)) / 2,
            general_stiffness=general,
            tool_pose=_random_poses(random, count),
            equilibrium=_random_poses(random, count),
            translation_stiffness=_random_positive(random, count, 3, 300.0),
            rotation_stiffness=_random_positive(random, count, 3, 20.0),
            stiffness=_random_positive(random, count, 6, 30.0),
            posture=joints.uniform(-2.0, 2.0, q.shape),
            posture_stiffness=joints.uniform(0.5, 20.0, q.shape),
            lower=q - np.where(at_lower, near[0], away[0]),
            upper=q + np.where(at_upper, near[1], away[1]),
            zone=joints.uniform(0.2, 0.4, count),
            limit_stiffness=joints.uniform(50.0, 500.0, q.shape),
            velocity=joints.normal(size=(count, chain.dof)),
            gravity=joints.normal(size=(count, 3)) * 6.0,
            base_pose=_random_poses(np.random.default_rng([seed, 2]), count),
            force_limit=np.random.default_rng([seed, 3]).uniform(20.0, 100.0, count),
            moment_limit=np.random.default_rng([seed, 4]).uniform(5.0, 20.0, count),
            direction=np.random.default_rng([seed, 6]).normal(size=(count, chain.dof)),
            chain=chain,
        )

    def at(self, q: FloatArray) -> Samples:
        """Return the samples with other joint positions."""
        return replace(self, q=q)

    @property
    def configuration(self) -> tuple[str, ...]:
        """Names of the configuration arguments."""
        chain = self.chain
        given = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
        return tuple(argument.name for argument in given)

    def q_of_motors(self, seed: int) -> tuple[FloatArray, FloatArray]:
        """Return positions of the motors near the chain's closed configuration, and that configuration."""
        start = np.tile(self.chain.start, (len(self.q), 1))
        random = np.random.default_rng([seed, 5])
        return start[:, self.chain.actuated] + random.uniform(
            -0.15, 0.15, (len(start), len(self.chain.actuated))
        ), start

    def of(self, argument: Argument, seed: int) -> FloatArray:
        """Return the values of a kernel's argument; parameters of a user's potential are drawn."""
        if argument.name in ("actuated", "start"):
            return self.q_of_motors(seed)[argument.name == "start"]
        known = getattr(self, argument.name, None)
        if known is not None and len(known.shape) == 1 + len(argument.shape):
            sizes = zip(argument.shape, known.shape[1:], strict=True)
            if all(extent in ("n", "q", size) for extent, size in sizes):
                values: FloatArray = known
                return values
        return _random_parameter(argument, len(self.q), seed, self.chain)

    def of_tips(self, argument: str) -> FloatArray:
        """Return the values of an argument for all tips: each tip takes those of another sample."""
        return np.stack([np.roll(self[argument], k, axis=0) for k in range(len(self.chain.tips))], axis=1)

    def per_tip(self, argument: Argument) -> FloatArray:
        """Return the values of a kernel's argument, which may hold one value per tip."""
        singular = {"wrenches": "wrench", "tool_poses": "tool_pose"}
        return self.of_tips(singular[argument.name]) if argument.name in singular else self[argument.name]

    def __getitem__(self, argument: str) -> FloatArray:
        """Return the values of a kernel's argument by its name."""
        values: FloatArray = getattr(self, argument)
        return values


def _random_poses(random: np.random.Generator, count: int) -> FloatArray:
    """Draw orientations from random quaternions, and positions of some decimetres."""
    w, x, y, z = (lambda quaternion: quaternion / np.linalg.norm(quaternion, axis=0))(random.normal(size=(4, count)))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    poses = np.zeros((count, 4, 4))
    poses[:, :3, :3] = np.array(rows).transpose(2, 0, 1)
    poses[:, :3, 3] = random.normal(size=(count, 3)) * 0.2
    poses[:, 3, 3] = 1
    return poses


def _random_parameter(argument: Argument, count: int, seed: int, chain: Chain) -> FloatArray:
    """Draw values of about 1: of both signs for cotangents, positive for parameters of a user's potential."""
    extents = argument.array(chain).shape
    if argument.per_configuration:
        cotangents: FloatArray = np.random.default_rng([seed, *argument.name.encode()]).normal(size=(count, *extents))
        return cotangents
    return np.random.default_rng(seed + 77).uniform(0.2, 2.0, (count, *extents))


def _random_positive(random: np.random.Generator, count: int, size: int, scale: float) -> FloatArray:
    """Draw full symmetric positive definite matrices."""
    roots = random.normal(size=(count, size, size))
    matrices: FloatArray = scale * (roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(size))
    return matrices


def joint_potential_arguments(samples: Samples) -> dict[str, tuple[FloatArray, ...]]:
    """Return the arguments of the joint potentials' kernels, by group."""
    return {
        potential.name: (samples.q, *(samples[argument.name] for argument in potential.parameters))
        for potential in JOINT_POTENTIALS
    }


def argument_samples(
    chain: Chain, count: int, seed: int, options: SpringOptions | None = None
) -> dict[Argument, FloatArray]:
    """Draw a stack of ``count`` random values for every argument that kernels take."""
    drawn = [Samples.draw(chain, count, seed + index) for index in range(len(chain.tips))]
    names = [tip.name for tip in chain.tips]
    pool = {}
    for kernel in chain_kernels(replace(chain, tips=chain.tips[:1]), options):
        for k, argument in enumerate(kernel.arguments):
            each = [samples.of(argument, seed + index + k) for index, samples in enumerate(drawn)]
            pool[argument] = each[0]
            if argument.plural:
                pool[argument.of_all_tips(names)] = np.stack(each, axis=1)
    for kernel in chain_kernels(chain, options):
        for argument in kernel.arguments:
            if argument.per_configuration and argument not in pool:  # cotangents, of what is summed over the tips, too
                pool[argument] = drawn[0].of(argument, seed)
    return pool
