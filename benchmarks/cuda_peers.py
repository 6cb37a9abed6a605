# SPDX-License-Identifier: MIT
"""The hybrid joint stiffness of the iiwa 14 on a GPU: our kernel beside JAX and PyTorch on the same one.

Last part of ``make bench-cuda``: ``python benchmarks/cuda_peers.py FOLDER``, whose program cuda_stiffness has been
built. float64, one task stiffness for all. Contenders are jit and vmap of forward mode, and the formula by hand on
arrays of configurations, which a framework can fuse (:mod:`benchmarks.frameworks`); of its ways to store arrays the
fastest counts. Values agree to 1e-9 of the largest entry before anything is timed. Each contender runs in a process
of its own, by the Python that GPU_PYTHON names (default: this one), and is left out where its framework sees no GPU.
"""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

if __name__ == "__main__":  # a Python of frameworks alone: the folder of this file is not on its path as a package
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.frameworks import by_hand, jax_functions, torch_functions

Array = NDArray[np.float64]
COUNT, ROUNDS, CALLS, AGREE, SECONDS = 1 << 20, 15, 5, 1e-9, 150
JOINTS, TRIANGLE = 7, 28


class Problem:
    """The arm of a folder's manifest, arguments in columns (7, N), (6, N), and results (28, M) of the first M."""

    def __init__(self, folder: Path, count: int) -> None:
        chain = json.loads((folder / "iiwa14" / "manifest.json").read_text())["chain"]
        joints = [SimpleNamespace(**joint) for joint in chain["joints"]]
        self.chain = SimpleNamespace(joints=joints, tip_translation=chain["tips"][0]["translation"])
        self.count = count
        values = np.fromfile(folder / "values.bin")
        checked = (len(values) - 36) // (JOINTS + 6 + TRIANGLE)
        ends = np.cumsum([JOINTS * checked, 6 * checked, 36])
        q, wrench, K, results = np.split(values, ends)
        upper = np.triu(K.reshape(6, 6))
        self.K: Array = upper + np.triu(upper, 1).T
        self.results = results.reshape(TRIANGLE, checked)
        repeats = (1, -(-count // checked))
        self.q, self.wrench = (np.tile(x.reshape(-1, checked), repeats)[:, :count] for x in (q, wrench))

    def check(self, found: Any) -> None:
        """Compare results (7, 7, N), or of the upper triangle (28, N), with the kernel's.

        Raises:
            SystemExit: they disagree.

        """
        known = min(self.count, self.results.shape[1])
        values = np.asarray(found)[..., :known]
        rows, columns = np.triu_indices(JOINTS)
        values = values[rows, columns] if values.ndim == 3 else values
        expected = self.results[:, :known]
        finite = ~np.isnan(expected).any(axis=0)
        away = np.abs(values[:, finite] - expected[:, finite]).max()
        if not away <= AGREE * np.abs(expected[:, finite]).max():
            raise SystemExit(f"the values disagree by {away}")


Contender = Callable[[Problem], Iterator[tuple[Callable[[], Any], Callable[[Any], None], Callable[[Any], Any]]]]
"""For each layout the call, a function that waits for its result, and one that returns the result as an array."""


def _jax(problem: Problem) -> tuple[Any, Any, Callable[[Any], None]]:
    """Import JAX with doubles; return it, its NumPy, and the function that waits.

    Raises:
        SystemExit: JAX sees no GPU.

    """
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.default_backend() != "gpu":
        raise SystemExit("JAX sees no GPU")
    return jax, jax.numpy, jax.block_until_ready


def jax_forward(problem: Problem) -> Iterator[Any]:
    """Forward mode over forward kinematics: configurations first, then last."""
    jax, jnp, wait = _jax(problem)
    stiffness, _ = jax_functions(problem.chain)
    K = jnp.asarray(problem.K)
    for axis in (0, -1):
        function = jax.jit(jax.vmap(lambda q, F: stiffness(q, F, K), in_axes=axis, out_axes=axis))
        q, F = (jnp.asarray(x if axis else np.ascontiguousarray(x.T)) for x in (problem.q, problem.wrench))
        yield (
            lambda function=function, q=q, F=F: function(q, F),
            wait,
            lambda found, axis=axis: np.moveaxis(np.asarray(found), axis, -1),
        )


def jax_by_hand(problem: Problem) -> Iterator[Any]:
    """Compile the formula on arrays of configurations, its triangle in one array or in 28."""
    jax, jnp, wait = _jax(problem)
    q, F, K = (jnp.asarray(x) for x in (problem.q, problem.wrench, problem.K))
    for gather in (tuple, jnp.stack):
        function = jax.jit(lambda q, F, gather=gather: gather(by_hand(problem.chain, jnp, list(q), list(F), K)))
        yield lambda function=function: function(q, F), wait, np.asarray


def _torch() -> Any:
    """Import PyTorch.

    Raises:
        SystemExit: PyTorch sees no GPU.

    """
    import torch

    if not torch.cuda.is_available():
        raise SystemExit("PyTorch sees no GPU")
    return torch


def torch_forward(problem: Problem) -> Iterator[Any]:
    """torch.func: vmap of jacfwd, one operation at a time."""
    torch = _torch()
    q, F = (torch.as_tensor(np.ascontiguousarray(x.T), device="cuda") for x in (problem.q, problem.wrench))
    stiffness, _ = torch_functions(problem.chain, torch.as_tensor(problem.K, device="cuda"))
    function = torch.func.vmap(stiffness)
    yield (
        lambda: function(q, F),
        lambda _: torch.cuda.synchronize(),
        lambda found: np.moveaxis(found.cpu().numpy(), 0, -1),
    )


def torch_by_hand(problem: Problem) -> Iterator[Any]:
    """torch.compile of the formula on arrays of configurations."""
    torch = _torch()
    q, F, K = (torch.as_tensor(x, device="cuda") for x in (problem.q, problem.wrench, problem.K))
    for gather in (tuple, torch.stack):
        torch.compiler.reset()
        function = torch.compile(lambda q, F, gather=gather: gather(by_hand(problem.chain, torch, list(q), list(F), K)))
        yield (
            lambda function=function: function(q, F),
            lambda _: torch.cuda.synchronize(),
            lambda found: np.stack([each.cpu().numpy() for each in found]),
        )


CONTENDERS: dict[str, tuple[str, Callable[[Problem], Iterator[Any]]]] = {
    "jax-forward": ("JAX, jit of vmap, jacfwd", jax_forward),
    "jax-by-hand": ("JAX, jit, formula by hand", jax_by_hand),
    "torch-forward": ("PyTorch, torch.func, vmap of jacfwd", torch_forward),
    "torch-by-hand": ("PyTorch, torch.compile, formula by hand", torch_by_hand),
}


def rate(problem: Problem, call: Callable[[], Any], wait: Callable[[Any], None]) -> float:
    """Return configurations per second: the median of some rounds of several calls, waited for together."""
    wait(call())
    times = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        found = None
        for _ in range(CALLS):
            found = call()
        wait(found)
        times.append((time.perf_counter() - started) / CALLS)
    return problem.count / statistics.median(times)


def contend(name: str, folder: Path, count: int) -> None:
    """Print the rate of each of a contender's ways, as soon as it is known."""
    problem = Problem(folder, count)
    for call, wait, as_array in CONTENDERS[name][1](problem):
        found = call()
        wait(found)
        problem.check(as_array(found))
        print(rate(problem, call, wait), flush=True)


def measured(name: str, folder: Path, count: int) -> tuple[list[float], str]:
    """Run a contender in a process of its own; return its rates, and what went wrong."""
    command = [os.environ.get("GPU_PYTHON", sys.executable), __file__, str(folder), str(count), name]
    environment = os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=SECONDS, check=False)
        said, why = done.stdout, (done.stderr.strip().splitlines() or ["failed"])[-1][:120] if done.returncode else ""
    except subprocess.TimeoutExpired as late:
        said, why = (late.stdout or b"").decode(), f"took more than {SECONDS} s, the time to compile included"
    return [float(line) for line in said.split()], why


def main() -> int:
    """Print the table, or one contender's rates."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else COUNT
    if len(sys.argv) > 3:
        contend(sys.argv[3], folder, count)
        return 0
    program = [str(folder / "cuda_stiffness"), str(count), str(folder / "values.bin")]
    said = subprocess.run(program, stdout=subprocess.PIPE, text=True, check=True).stdout
    ours = float(re.findall(r"kernel +(\S+) configurations/s", said)[0])
    print(f"{said.splitlines()[0]}, hybrid joint stiffness, float64, one task stiffness for all")
    print(f"  {'our kernel':45} {ours:8.3g} configurations/s")
    for name, (title, _) in CONTENDERS.items():
        rates, why = measured(name, folder, count)
        if rates:
            best = max(rates)
            print(f"  {title:45} {best:8.3g} configurations/s, our kernel {ours / best:.3g} times as many", end="")
            print(f" (of {len(rates)} ways)" if len(rates) > 1 else "")
        if why:
            print(f"  {title}: {'one way' if rates else 'left out'}: {why}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
