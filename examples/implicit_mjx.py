# SPDX-License-Identifier: MIT
"""Step a spring at the tip implicitly in MJX, inside jit, for many stiffnesses at once: the limits of implicit.py.

MJX has no callbacks. Its step is taken apart instead: between the inertia and its use, h^2 P is added to M, and
-h P dq to the applied torque. Spring and tangent are the robot's C functions, called by XLA (NAME.jax, on a CPU).

    pip install -e '.[mjx]'
    python -m examples.implicit_mjx      prints the largest stable stiffnesses [N/m] (5 minutes)
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx

import stiffgen
from examples import implicit

OPTIONS: dict[str, Any] = {**implicit.OPTIONS, "derivatives": True}
COMPILER = {"xla_disable_hlo_passes": "fusion"}
"""Options of XLA: fused, each link's pose repeats those of the links before it, and a step takes ten times as long."""
WEIGHTS = {"explicit": (0.0, 0.0), "J^T K J": (1.0, 0.0), "P": (0.0, 1.0)}
"""Shares of J^T K J and of the positive tangent in the matrix of a step."""


def functions(robot: ModuleType) -> ModuleType:
    """Return the robot's functions for JAX; they need numbers of 64 bits."""
    jax.config.update("jax_enable_x64", True)
    return importlib.import_module(f"{robot.__name__}.jax")


def tangent(arm: ModuleType, q: jax.Array, spring: tuple[jax.Array, ...], weights: jax.Array) -> jax.Array:
    """Return the weighted sum of J^T K J and the positive tangent (n, n)."""
    J = arm.hybrid.jacobian(q)
    congruence = J.T @ arm.spring.task_stiffness(q, *spring) @ J
    return weights[0] * congruence + weights[1] * arm.spring.positive_tangent(q, *spring)


def step(
    arm: ModuleType, model: Any, data: Any, spring: tuple[jax.Array, ...], weights: jax.Array
) -> tuple[Any, jax.Array]:
    """Do one implicit step of arm and spring.

    Args:
        arm: the robot's functions for JAX.
        model: of MJX, with integrator Euler and dense matrices.
        data: of MJX.
        spring: arguments of the spring after q.
        weights: of the matrices (2).

    Returns:
        Data after the step, and the energy of arm and spring before it [J].

    """
    # (M + h^2 P) ddq = torque - h P dq: the spring's torque at the end of the step, to first order
    h, q, dq = model.opt.timestep, data.qpos, data.qvel
    data = mjx.fwd_position(model, data)
    M, P = data._impl.M, tangent(arm, q, spring, weights)
    energy = arm.spring.energy(q, *spring) + dq @ M @ dq / 2
    data = mjx.factor_m(model, data.tree_replace({"_impl.M": M + h * h * P}))
    data = data.replace(qfrc_applied=arm.spring.torque(q, *spring) - h * P @ dq)
    for stage in (mjx.fwd_velocity, mjx.fwd_actuation, mjx.fwd_acceleration):
        data = stage(model, data)
    has_contacts = data._impl.efc_J.size > 0
    data = mjx.solve(model, data) if has_contacts else data.replace(qacc=data.qacc_smooth)
    return mjx.euler(model, data), energy


def starting(model: Any) -> Any:
    """Return data of an arm at rest in START."""
    return mjx.make_data(model).replace(qpos=jnp.asarray(implicit.START))


def is_stable(
    arm: ModuleType, model: Any, count: jax.Array, spring: tuple[jax.Array, ...], weights: jax.Array
) -> jax.Array:
    """Return whether the energy never exceeds its first value by 5 % in some steps.

    An unstable arm stays in START: MJX would take its largest number of iterations for every arm of the batch.
    """
    first, start = arm.spring.energy(jnp.asarray(implicit.START), *spring), starting(model)

    def body(_: jax.Array, carry: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
        data, energy = step(arm, model, carry[0], spring, weights)
        stable = carry[1] & (energy <= 1.05 * first) & jnp.isfinite(data.qvel).all()
        return jax.tree.map(lambda a, b: jnp.where(stable, a, b), data, start), stable

    return jnp.asarray(jax.lax.fori_loop(0, count, body, (start, jnp.asarray(True)))[1])


def searching(robot: ModuleType, wall: bool) -> Callable[[implicit.Cell], dict[str, float]]:
    """Compile the search with a wall or without; return a function of a cell: largest stable stiffnesses [N/m] by name.

    All SEARCHED stiffnesses, tasks and matrices are simulated at once.
    """
    arm, model = functions(robot), mjx.put_model(implicit.arm(0.01, wall), impl="jax")
    many = jax.vmap(partial(is_stable, arm), (None, None, (0, 0, 0), 0))  # over springs and weights
    compiled = jax.jit(many, compiler_options=COMPILER)

    def search(cell: implicit.Cell) -> dict[str, float]:
        """Return the largest stable stiffness [N/m] of each tangent, all states at once."""
        timed = model.tree_replace({"opt.timestep": jnp.asarray(cell.step)})
        tasks = [
            task
            for stiffness in implicit.SEARCHED
            for task in implicit.tasks(robot, cell.away, cell.turn, stiffness)
        ]  # fmt: skip
        # a batch over matrices, stiffnesses and tasks, in this order from the slowest to the fastest index
        springs = (np.stack(each) for each in zip(*(task.arguments for task in tasks), strict=True))
        stacked = tuple(jnp.asarray(np.concatenate([each] * len(WEIGHTS))) for each in springs)
        weights = jnp.asarray(np.repeat(list(WEIGHTS.values()), len(tasks), axis=0))
        steps = round(implicit.SECONDS / cell.step) + 1
        stable = np.asarray(compiled(timed, steps, stacked, weights))
        in_all_tasks = stable.reshape(len(WEIGHTS), len(implicit.SEARCHED), -1).all(2)
        counts = np.cumprod(in_all_tasks, axis=1).sum(1)  # of stiffnesses that are stable up to the first that is not
        return {name: float(implicit.SEARCHED[k - 1]) if k else 0.0 for name, k in zip(WEIGHTS, counts, strict=True)}

    return search


def rows(robot: ModuleType) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table."""
    yield "deflection, step", *WEIGHTS
    searches = {wall: searching(robot, wall) for wall in (False, True)}
    for cell in implicit.CELLS:
        yield implicit.named(cell), *map(implicit.stiffness_words, searches[cell.wall](cell).values())


def main() -> None:
    """Print the table."""
    robot = stiffgen.load(implicit.URDF, **OPTIONS).module
    for row in rows(robot):
        print(" | ".join(row), flush=True)


if __name__ == "__main__":
    main()
