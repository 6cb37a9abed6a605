# SPDX-License-Identifier: MIT
"""Joint stiffness of the iiwa 14 on a GPU beside GRiD 0.6 (PyPI: grid-rbd), on the same card.

GRiD generates CUDA from a URDF, too. It has no joint stiffness, but derivative and Hessian of the end effector's pose,
from which one follows for a force without moment and a translational stiffness: f . d2p/dq2 + J^T K J. The frame is
that of the last moving joint, where GRiD ends. Values agree to ``AGREE`` of the largest entry before anything is timed:
joint stiffness, and the Hessian's three rows of translation (its other three are of Euler angles). Timed are our
joint stiffness, GRiD's Hessian alone, which is what its user still has to contract, and GRiD with the contraction.

    python benchmarks/cuda_grid.py FOLDER [COUNT]        on a GPU: needs nvcc, grid-rbd and PyTorch
    python benchmarks/cuda_grid.py --reference [COUNT]   on the CPU: equal results alone, with GRiD's NumPy reference
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen

URDF = Path(__file__).resolve().parents[1] / "urdf" / "iiwa14.urdf"
TIP, JOINTS, ROUNDS = "link_7", 7, 31
AGREE = {"float64": 1e-9, "float32": 2e-4}
"""Of the largest entry; GRiD validates single precision, its double precision is an alpha feature."""
K = np.diag([900.0, 700.0, 500.0]) + 50.0
"""Translational stiffness [N/m]."""


def drawn(count: int) -> tuple[Any, Any]:
    """Return joint positions (count, 7) within the limits, and forces (count, 3)."""
    random = np.random.default_rng(1)
    coordinates = stiffgen.load_chain(URDF, tip=TIP).coordinates
    low, high = (np.array([getattr(each, side) for each in coordinates]) for side in ("lower", "upper"))
    return random.uniform(low, high, (count, JOINTS)), random.uniform(-20.0, 20.0, (count, 3))


def contracted(library: Any, gradient: Any, hessian: Any, force: Any, stiffness: Any) -> Any:
    """Return the joint stiffness (N, 7, 7) from derivative (N, 6, 7) and Hessian (N, 6, 7, 7) of the pose."""
    J = gradient[:, :3]
    return library.einsum("nk,nkij->nij", force, hessian[:, :3]) + library.einsum("nki,kl,nlj->nij", J, stiffness, J)


def compare(what: str, found: Any, expected: Any, bound: float) -> None:
    """Print the largest difference over the largest entry.

    Raises:
        SystemExit: it exceeds the bound.

    """
    away = float(abs(found - expected).max() / abs(expected).max())
    print(f"  {what}: largest difference {away:.1e} of the largest entry")
    if not away <= bound:
        raise SystemExit(f"{what}: the values disagree")


def reference(count: int) -> int:
    """Compare this generator's model with GRiD's NumPy reference, without a GPU."""
    from RBDReference import RBDReference
    from URDFParser import URDFParser

    grid = RBDReference(URDFParser().parse(str(URDF)))
    model = stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tip=TIP))
    wide = np.zeros((6, 6))
    wide[:3, :3] = K
    configurations, forces = drawn(count)
    gradient = np.array([grid.end_effector_pose_gradient(q)[0] for q in configurations])
    hessian = np.array([grid.end_effector_pose_hessian_analytic(q)[0] for q in configurations])
    ours = [
        np.array(model.hybrid.joint_stiffness(q, [*f, 0, 0, 0], wide))
        for q, f in zip(configurations, forces, strict=True)
    ]
    derivative = [np.array(model.hybrid.jacobian_transpose_derivative(q)) for q in configurations]
    rows = np.array(derivative).reshape(count, JOINTS, JOINTS, 6).transpose(0, 3, 2, 1)[:, :3]
    print(f"NumPy reference of grid-rbd {version('grid-rbd')} on the CPU, {count} configurations")
    compare("frame Hessian, translation", hessian[:, :3], rows, AGREE["float64"])
    compare("joint stiffness", contracted(np, gradient, hessian, forces, K), np.array(ours), AGREE["float64"])
    return 0


def our_kernel(folder: Path, dtype: str, options: str = "-arch=native") -> Any:
    """Generate and compile our launch functions; return the joint stiffness's."""
    scalar = {"float64": "double", "float32": "float"}[dtype]
    out = stiffgen.generate(
        URDF, tip=TIP, name="arm", output=folder / dtype, build=False, cuda=True, scalar=scalar, controller=False
    )
    library = out / "libarm.so"
    subprocess.run(
        ["nvcc", "-O3", options, "-shared", "-Xcompiler", "-fPIC", str(out / "arm.cu"), "-o", str(library)], check=True
    )
    launch = ctypes.CDLL(str(library)).arm_hybrid_joint_stiffness_cuda
    launch.argtypes = [ctypes.c_size_t, ctypes.c_size_t, *[ctypes.c_void_p] * 5]
    return launch


def times(torch: Any, calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the median seconds of each call, all called in turn."""
    measured: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(-3, ROUNDS):  # the first ones warm up
        for name, call in calls.items():
            start, stop = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            start.record()
            call()
            stop.record()
            torch.cuda.synchronize()
            if turn >= 0:
                measured[name].append(1e-3 * start.elapsed_time(stop))
    return {name: statistics.median(values) for name, values in measured.items()}


def beside(folder: Path, count: int, dtype: str) -> None:
    """Compare and time one precision.

    Raises:
        SystemExit: the values disagree, or a launch fails.

    """
    import grid_rbd
    import torch

    kind = getattr(torch, dtype)
    q, force = (torch.as_tensor(x, dtype=kind, device="cuda") for x in drawn(count))
    stiffness, wide = torch.as_tensor(K, dtype=kind, device="cuda"), torch.zeros((6, 6), dtype=kind, device="cuda")
    wide[:3, :3] = stiffness
    columns, wrench = q.T.contiguous(), torch.zeros((6, count), dtype=kind, device="cuda")
    wrench[:3] = force.T
    packed = torch.empty((JOINTS * (JOINTS + 1) // 2, count), dtype=kind, device="cuda")
    launch, stream = our_kernel(folder, dtype), torch.cuda.current_stream().cuda_stream
    grid = grid_rbd.register_robot(
        "stiffgen_iiwa14", urdf_path=str(URDF), backend="torch", dtype=dtype, max_batch_size=count,
        algorithm_list=["end_effector_pose_gradient", "end_effector_pose_hessian"], enable_mujoco_kernels=False,
    )  # fmt: skip

    def ours() -> None:
        arrays = (x.data_ptr() for x in (columns, wrench, wide, packed))
        if launch(count, count, *arrays, stream):
            raise SystemExit("our kernel cannot be launched")

    def theirs() -> Any:
        return contracted(
            torch, grid.end_effector_pose_gradient(q), grid.end_effector_pose_hessian(q), force, stiffness
        )

    ours()
    rows, cols = np.triu_indices(JOINTS)
    print(f"{torch.cuda.get_device_name()}, {count} configurations, {dtype}")
    compare("joint stiffness", theirs()[:, rows, cols].T, packed, AGREE[dtype])
    calls = {
        "our joint stiffness": ours,
        "GRiD, Hessian of the pose": lambda: grid.end_effector_pose_hessian(q),
        "GRiD, derivative and Hessian, contracted": theirs,
    }
    found = times(torch, calls)
    for name, seconds in found.items():
        print(
            f"  {name:42} {count / seconds:8.3g} configurations/s, {seconds / found['our joint stiffness']:.3g} of ours"
        )


def main(words: list[str]) -> int:
    """Compare on the CPU, or compare and time on the GPU."""
    if words[0] == "--reference":
        return reference(int(words[1]) if len(words) > 1 else 20)
    if missing := [name for name in ("grid_rbd", "torch") if find_spec(name) is None]:
        print(f"GRiD: left out: {' and '.join(missing)} not installed (pip install grid-rbd==0.6.0 torch)")
        return 0
    for dtype in AGREE:
        beside(Path(words[0]), int(words[1]) if len(words) > 1 else 1 << 16, dtype)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
