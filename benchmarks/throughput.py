# SPDX-License-Identifier: MIT
"""Configurations a second on all cores: joint stiffness, Hessian, and their products, beside what else computes them.

Part of ``make bench`` (run.py). float64, iiwa14, hybrid form, one task stiffness for all. Values agree to 1e-9 of the
largest entry before anything is timed. PyTorch's wheel is too large for the environment of the other programs: where
TORCH_PYTHON names a Python that has it, its rows come from there, and say how many threads it took.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import stiffgen
from benchmarks.frameworks import jax_functions, torch_functions
from stiffgen import open_robot
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.measured import symmetric_part
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples

Array = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
COUNT, BLOCK, ROUNDS = 131072, 4096, 9
FEWER = 16
"""Contenders of a thousandth of the speed get so many times fewer configurations."""
AGREE = 1e-9
WHAT = ("joint stiffness", "its product (vjp)", "Hessian dJ/dq", "its product (vjp)", "joint stiffness, upper triangle")
Rates = tuple[str, list[float | None]]
"""Contender, and configurations a second of each of WHAT, of the first ones at least; None where it has none."""


def rate(call: Callable[[], object], count: int, rounds: int = ROUNDS) -> float:
    """Return configurations per second of the fastest round: other programs can only slow a round down."""
    call()
    fastest = np.inf
    for _ in range(rounds):
        started = time.perf_counter()
        call()
        fastest = min(fastest, time.perf_counter() - started)
    return float(count / fastest)


def in_blocks(work: Callable[[slice], object], count: int, pool: ThreadPoolExecutor) -> None:
    """Run the work on blocks of configurations by a pool of threads, as docs/performance.md does."""
    for _ in pool.map(work, [slice(start, start + BLOCK) for start in range(0, count, BLOCK)]):
        pass


def agree(found: Any, expected: Array) -> bool:
    """Whether values are those of stiffgen."""
    return bool(np.abs(np.asarray(found) - expected).max() <= AGREE * np.abs(expected).max())


class Problem:
    """Arguments, cotangents and what stiffgen gives for them."""

    def __init__(self, chain: stiffgen.Chain, folder: Path) -> None:
        self.chain, self.folder = chain, folder
        module: Any = open_robot(folder).module
        self.robot, self.packed = module.hybrid, module.packed
        samples = Samples(chain, COUNT, seed=3)
        self.q, self.wrench, self.task_stiffness = (
            samples[Q],
            samples[WRENCH],
            symmetric_part(samples[TASK_STIFFNESS][0]),
        )
        self.tip: Array = module.forward_kinematics(self.q)[:, :3, 3]
        random = np.random.default_rng(3)
        self.stiffness_cotangent = random.normal(size=(COUNT, 7, 7))
        self.hessian_cotangent = random.normal(size=(COUNT, 7, 7, 6))

    def calls(self, part: slice) -> tuple[Callable[..., Any], ...]:
        """Run what WHAT names on a part of the configurations."""
        q, F, K, robot = self.q[part], self.wrench[part], self.task_stiffness, self.robot
        return (
            lambda **out: robot.joint_stiffness(q, F, K, **out),
            lambda **out: robot.joint_stiffness_vjp(q, F, K, self.stiffness_cotangent[part], **out),
            lambda **out: robot.jacobian_transpose_derivative(q, **out),
            lambda **out: robot.jacobian_transpose_derivative_vjp(q, self.hessian_cotangent[part], **out),
            lambda **out: self.packed.hybrid_joint_stiffness(q, F, K, **out),
        )

    def expected(self, part: slice) -> list[list[Array]]:
        """Results of each."""
        results = [call() for call in self.calls(part)]
        return [list(each) if isinstance(each, tuple) else [each] for each in results]


def of_stiffgen(problem: Problem) -> list[Rates]:
    """With one thread and with one for each core."""
    cores, rows = os.cpu_count() or 1, []
    for threads in dict.fromkeys((1, 2, cores)) if cores > 1 else (1,):
        rates: list[float | None] = []
        with ThreadPoolExecutor(threads) as pool:
            for k, results in enumerate(problem.expected(slice(1))):
                outs = tuple(np.empty((COUNT, *each.shape[1:])) for each in results)

                def work(part: slice, k: int = k, outs: tuple[Array, ...] = outs) -> None:
                    problem.calls(part)[k](out=tuple(each[part] for each in outs))

                rates.append(rate(partial(in_blocks, work, COUNT, pool), COUNT))
        rows.append((f"stiffgen, {threads} thread{'s' if threads > 1 else ''}", rates))
    return rows


def of_pinocchio(problem: Problem, library: Path | None) -> list[Rates]:
    """Return the kinematic Hessian in C++, one Data per thread; ``library`` is contenders/pinocchio.cpp, compiled."""
    if library is None:
        return []
    loaded, cores = ctypes.CDLL(str(library)), os.cpu_count() or 1
    loaded.setup()
    out = np.empty((COUNT, 7, 7, 6))

    def pointer(array: Array) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    def work(part: slice) -> None:
        loaded.hessians(ctypes.c_size_t(len(problem.q[part])), pointer(problem.q[part]), pointer(out[part]))

    with ThreadPoolExecutor(cores) as pool:
        measured = rate(lambda: in_blocks(work, COUNT, pool), COUNT)
    if not agree(out[:64], problem.expected(slice(64))[2][0]):
        raise SystemExit("Pinocchio's Hessian disagrees")
    return [(f"Pinocchio C++, kinematic Hessian, {cores} threads", [None, None, measured, None])]


def of_jax(problem: Problem) -> list[Rates]:
    """jax.vmap and jit of forward mode; products by reverse mode over it. XLA takes as many threads as it likes."""
    try:
        import jax
        import jax.numpy as jnp
    except ImportError:
        return []
    jax.config.update("jax_enable_x64", True)
    stiffness, hessian = jax_functions(problem.chain)
    K = jnp.asarray(problem.task_stiffness)
    functions = (
        jax.vmap(lambda q, F, _: stiffness(q, F, K)),
        jax.vmap(lambda q, F, C: jax.vjp(stiffness, q, F, K)[1](C)[:2]),
        jax.vmap(lambda q, _, __: hessian(q)),
        jax.vmap(lambda q, _, C: jax.vjp(hessian, q)[1](C)),
    )
    part = slice(COUNT // FEWER)
    q, F = jnp.asarray(problem.q[part]), jnp.asarray(problem.wrench[part])
    cotangents = jnp.asarray(problem.stiffness_cotangent[part]), jnp.asarray(problem.hessian_cotangent[part])
    expected, rates = problem.expected(part), []

    def finished(function: Callable[..., Any], C: Any) -> None:
        jax.block_until_ready(function(q, F, C))

    for k, function in enumerate(functions):
        compiled, C = jax.jit(function), cotangents[k // 2]
        found = compiled(q, F, C)
        first = found[0] if isinstance(found, tuple) else found
        if not agree(first, expected[k][0]):
            raise SystemExit(f"JAX: {WHAT[k]} disagrees")
        rates.append(rate(partial(finished, compiled, C), len(problem.q[part]), 5))
    return [("JAX, vmap and jit, float64, its own threads", list(rates))]


def of_torch(problem: Problem) -> list[Rates]:
    """torch.func: vmap of jacfwd, and reverse mode over it. In this process; see :func:`torch_elsewhere`."""
    import torch

    stiffness, hessian = torch_functions(problem.chain, torch.as_tensor(problem.task_stiffness))

    functions = (
        torch.func.vmap(lambda q, F, _: stiffness(q, F)),
        torch.func.vmap(lambda q, F, C: torch.func.vjp(stiffness, q, F)[1](C)),
        torch.func.vmap(lambda q, _, __: hessian(q)),
        torch.func.vmap(lambda q, _, C: torch.func.vjp(hessian, q)[1](C)),
    )
    part = slice(COUNT // FEWER)
    q, F = torch.as_tensor(problem.q[part]), torch.as_tensor(problem.wrench[part])
    cotangents = torch.as_tensor(problem.stiffness_cotangent[part]), torch.as_tensor(problem.hessian_cotangent[part])
    expected, rates = problem.expected(part), []
    for k, function in enumerate(functions):
        C = cotangents[k // 2]
        found = function(q, F, C)
        first = found[0] if isinstance(found, tuple) else found
        if not agree(first.numpy(), expected[k][0]):
            raise SystemExit(f"PyTorch: {WHAT[k]} disagrees")
        rates.append(rate(partial(function, q, F, C), len(problem.q[part]), 3))
    return [(f"PyTorch {torch.__version__}, torch.func, {torch.get_num_threads()} threads", list(rates))]


def torch_elsewhere(folder: Path, left_out: list[str]) -> list[Rates]:
    """PyTorch's rows, by the Python that TORCH_PYTHON names."""
    python = os.environ.get("TORCH_PYTHON")
    if not python:
        left_out.append("PyTorch: TORCH_PYTHON names no Python that has it")
        return []
    paths = os.pathsep.join([*sys.path[1:], str(HERE.parent), str(HERE.parent / "codegen")])
    done = subprocess.run(
        [python, "-m", "benchmarks.throughput", str(folder)], cwd=HERE.parent, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": paths}, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        left_out.append(f"PyTorch: {(done.stderr.strip().splitlines() or ['failed'])[-1][:120]}")
        return []
    return [(str(name), list(rates)) for name, rates in json.loads(done.stdout.splitlines()[-1])]


def of_mujoco(problem: Problem, urdf: Path) -> list[Rates]:
    """mj_jacDot gives dJ/dt for one joint velocity: seven calls are a Hessian. From Python, whose calls count."""
    try:
        import mujoco
    except ImportError:
        return []
    model = mujoco.MjModel.from_xml_path(str(urdf))
    data, body = (
        mujoco.MjData(model),
        mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, problem.chain.joints[-1].child),
    )
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    count = COUNT // (16 * FEWER)

    def hessian(q: Array, point: Array, out: Array) -> None:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for i in range(7):
            data.qvel[:] = 0
            data.qvel[i] = 1
            mujoco.mj_comVel(model, data)
            mujoco.mj_jacDot(model, data, linear, angular, point, body)
            out[i, :, :3], out[i, :, 3:] = linear.T, angular.T

    out = np.empty((count, 7, 7, 6))

    def work() -> None:
        for k in range(count):
            hessian(problem.q[k], problem.tip[k], out[k])

    measured = rate(work, count, 3)
    if not agree(out, problem.expected(slice(count))[2][0]):
        return [("MuJoCo mj_jacDot: disagrees, not counted", [None] * 4)]
    return [("MuJoCo, 7 mj_jacDot from Python, 1 thread", [None, None, measured, None])]


def section(rows: Sequence[Rates]) -> list[str]:
    """Return the section of RESULTS.md."""
    return [
        "## Configurations a second",
        "",
        f"float64, iiwa14, hybrid form, one task stiffness for all, {COUNT} configurations in memory, results",
        "written out; values equal before timing; the fastest of some rounds. Threads as in",
        "[performance.md](../docs/performance.md#all-cores-and-more-than-one-machine). A product is the",
        "gradient of a weighted sum of all results by all arguments",
        f"(JAX, PyTorch: without that by the task stiffness). JAX and PyTorch on {COUNT // FEWER} configurations.",
        "GPU: `make bench-cuda`.",
        "",
        f"| contender | {' | '.join(WHAT)} |",
        "|---" * (1 + len(WHAT)) + "|",
        *(
            f"| {name} | {' | '.join('-' if each is None else f'{each:.3g}' for each, _ in zip_longest(rates, WHAT))} |"
            for name, rates in rows
        ),
        "",
    ]


def throughput(
    chain: stiffgen.Chain, urdf: Path, folder: Path, pinocchio: Path | None, left_out: list[str]
) -> list[Rates]:
    """All rows.

    Args:
        chain: the iiwa 14.
        urdf: its file.
        folder: generated from it, with derivatives.
        pinocchio: the C++ contender's library; None where it could not be built.
        left_out: gets a line for every contender that is missing.

    """
    problem = Problem(chain, folder)
    rows = [*of_stiffgen(problem), *of_pinocchio(problem, pinocchio)]
    for name, found in (("JAX", of_jax(problem)), ("MuJoCo", of_mujoco(problem, urdf))):
        rows += found
        if not found:
            left_out.append(f"{name}, configurations a second: not installed")
    return [*rows, *torch_elsewhere(folder, left_out)]


if __name__ == "__main__":
    opened = open_robot(Path(sys.argv[1]))
    print(json.dumps(of_torch(Problem(opened.chain, opened.folder))))
