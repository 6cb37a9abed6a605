# SPDX-License-Identifier: MIT
"""Time the joint stiffness against what a user could take instead; write RESULTS.md and results.svg.

All C and C++ contenders run in one process on the same 4096 random inputs (iiwa14, hybrid form, dense task stiffness,
full 7x7 result), and agree before anything is timed. Contenders whose tools are missing are left out and named.
"""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import stiffgen
from stiffgen import open_robot
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.kernels import KERNELS, MAX_BATCH_JOINTS
from stiffgen.core.symbolic.measured import symmetric_part
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.poses import joint_poses, product_of_poses
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.lab.style import AXES, CORRECTED, THEME

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmarks import claims
from benchmarks import growth as joints
from benchmarks.compiled import AGREE, in_c
from benchmarks.compiled import section as compiled_section
from benchmarks.growth import SAME_FUNCTIONS, exponent, growth, growth_section
from benchmarks.springs import of_springs, springs_section
from benchmarks.throughput import section as throughput_section
from benchmarks.throughput import throughput
from benchmarks.tools import AVX2, COUNT, HERE, NATIVE, PLAIN, URDF, Row, in_turn, machine, run, timed

ROUNDS = 61
BATCH = 65536
STREAMED = (10**6, 10**7)
BOOST = "-DBOOST_MPL_LIMIT_LIST_SIZE=30 -DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"
left_out: list[str] = []
Array = NDArray[np.float64]
Calls = dict[str, Callable[[], object]]


def differentiated(chain: stiffgen.Chain) -> ca.Function:
    """Plain 4x4 kinematics, geometric Jacobian, dJ/dq by CasADi's differentiation."""
    q, F, K = ca.SX.sym("q", 7), ca.SX.sym("F", 6), ca.SX.sym("K", 6, 6)
    frames, tip = joint_poses(chain, q), product_of_poses(chain, q)
    columns = []
    for joint, frame in zip(chain.joints, frames, strict=True):
        axis = frame[:3, :3] @ ca.DM(joint.axis)
        columns.append(ca.vertcat(ca.cross(axis, tip[:3, 3] - frame[:3, 3]), axis))
    J = ca.horzcat(*columns)
    A = ca.SX(K)
    A[3:, 3:] -= ca.skew(F[3:] / 2)
    Kq = ca.jacobian(J.T @ F, q) + J.T @ A @ J
    return ca.Function("differentiated", [q, F, K], [ca.densify(Kq)], {"cse": True})


def casadi_source(function: ca.Function, folder: Path) -> list[str]:
    """Generate C; the defines that contenders/casadi.c wants."""
    here = Path.cwd()
    os.chdir(folder)
    try:
        function.generate(f"{function.name()}.c", {"with_header": False})
    finally:
        os.chdir(here)
    return [
        f'-DSOURCE="{folder / function.name()}.c"',
        f"-DFUNCTION={function.name()}",
        f"-DWORK={max(function.sz_w(), 1)}",
    ]


def libraries(chain: stiffgen.Chain, folder: Path, robot: Path) -> dict[str, Path]:
    """Build every contender; names as the table shows them."""
    closed = next(k for k in KERNELS if k.qualified_name == "hybrid_joint_stiffness")
    sources = {
        "CasADi C, differentiated": casadi_source(differentiated(chain), folder),
        "CasADi C, closed form": casadi_source(casadi_function(chain, closed), folder),
    }
    built: dict[str, Path] = {}

    def build(name: str, compiler: str, flags: str, source: str, extra: list[str]) -> None:
        if not shutil.which(compiler):
            left_out.append(f"{name}: {compiler} is not installed")
            return
        target = folder / f"lib{len(built)}.so"
        run(
            [
                compiler,
                *flags.split(),
                "-shared",
                "-fPIC",
                str(HERE / "contenders" / source),
                *extra,
                "-o",
                str(target),
                "-lm",
            ]
        )
        built[name] = target

    build("7 libm sincos", "gcc", "-O2", "seven_sincos.c", [])
    for compiler in ("gcc", "clang"):
        for flags in (NATIVE, PLAIN):
            for name, extra in sources.items():
                build(f"{name}; {compiler} {flags}", compiler, flags, "casadi.c", extra)
        for flags in (NATIVE, AVX2, PLAIN):
            build(f"stiffgen; {compiler} {flags}", compiler, flags, "own.c", [f"-I{robot}"])
    _build_pinocchio(chain, folder, build)
    return built


def _build_pinocchio(chain: stiffgen.Chain, folder: Path, build: Callable[..., None]) -> None:
    """Build the contender of Pinocchio in C++, where its headers and Eigen's are installed."""
    prefix = next((p for p in (Path(each) / "cmeel.prefix" for each in sys.path) if p.exists()), Path())
    eigen = next((p for p in (prefix / "include/eigen3", Path("/usr/include/eigen3")) if p.exists()), None)
    if not (prefix / "include/pinocchio").exists() or eigen is None:
        left_out.append("Pinocchio C++: needs the wheel 'pin' and Eigen's headers (Debian: libeigen3-dev)")
    else:
        (folder / "chain.inc").write_text(pinocchio_joints(chain))
        include = [f"-I{prefix / 'include'}", f"-I{eigen}", f"-I{folder}"]
        for flags in (NATIVE, PLAIN):
            name = f"Pinocchio C++, kinematic Hessian; g++ {flags}"
            try:
                build(name, "g++", f"-std=c++17 -DNDEBUG {BOOST} {flags}", "pinocchio.cpp", include)
            except subprocess.CalledProcessError as error:
                left_out.append(f"{name}: does not compile ({error.stderr.strip().splitlines()[-1][:80]})")


def pinocchio_joints(chain: stiffgen.Chain) -> str:
    """Return the joints for the C++ contender, since Pinocchio's URDF parser needs headers that the wheel lacks."""
    lines = []
    for joint in chain.joints:
        x, y, z = joint.axis
        kinds = {(1.0, 0.0, 0.0): "RX", (0.0, 1.0, 0.0): "RY", (0.0, 0.0, 1.0): "RZ"}
        kind = kinds.get((x, y, z))
        model = f"pin::JointModel{kind}()" if kind else f"pin::JointModelRevoluteUnaligned({x}, {y}, {z})"
        numbers = [*(x for row in joint.rotation for x in row), *joint.translation]
        lines.append(f"JOINT(({model}), {', '.join(map(repr, numbers))})")
    numbers = [*(x for row in chain.tip_rotation for x in row), *chain.tip_translation]
    return "\n".join([*lines, "TIP(" + ", ".join(map(repr, numbers)) + ")", ""])


def in_python(chain: stiffgen.Chain, robot: Path) -> tuple[list[Row], list[Row]]:
    """Rows (name, median, quartiles) for one call [us], and for a batch of BATCH [us a configuration]."""
    module = open_robot(robot).module
    size = BATCH
    samples = Samples(chain, size, seed=2)
    q, F, K = samples[Q], samples[WRENCH], symmetric_part(samples[TASK_STIFFNESS][0])
    q0, F0 = q[0].copy(), F[0].copy()
    kernel = module.hybrid.joint_stiffness
    out, left = np.empty((7, 7)), np.random.default_rng(0).normal(size=(7, 7))
    function = stiffgen.StiffnessModel(chain).hybrid.joint_stiffness
    expected = kernel(q, F, K)
    assert np.allclose(np.array(function(q0, F0, K)), expected[0], rtol=1e-11, atol=1e-9)
    J, dJ = module.hybrid.jacobian(q), module.hybrid.jacobian_transpose_derivative(q)
    correction = module.hybrid.connection_correction(F)

    def einsum(s: slice | int) -> Array:
        kinematic: Array = np.einsum("...ibk,...k->...bi", dJ[s], F[s])
        task: Array = np.einsum(
            "...ka,...kl,...lb->...ab", J[s], K + correction[s], J[s], optimize=["einsum_path", (0, 1), (0, 1)]
        )
        return kinematic + task

    assert np.allclose(einsum(slice(None)), expected, rtol=1e-10, atol=1e-8)
    single: Calls = {
        "numpy.matmul of two 7x7": lambda: np.matmul(left, left),
        "stiffgen": lambda: kernel(q0, F0, K),
        "stiffgen, out=": lambda: kernel(q0, F0, K, out=out),
        "CasADi function": lambda: function(q0, F0, K),
        "NumPy einsum, derivatives given": lambda: einsum(0),
    }
    many = np.empty((size, 7, 7))
    batch = [("stiffgen, out=", *timed(lambda: kernel(q, F, K, out=many), 9))]
    batch.append(("stiffgen", *timed(lambda: kernel(q, F, K), 9)))
    batch.append(("NumPy einsum, derivatives given", *timed(lambda: einsum(slice(None)), 5)))
    mapped = function.map(size)
    repeated = np.tile(K, size)
    batch.append(("CasADi map", *timed(lambda: mapped(q.T, F.T, repeated), 5)))
    in_pinocchio(chain, q0, F0, K, expected[0], single)
    in_jax(chain, q, F, K, expected, single, batch)
    return in_turn(single), [(name, median / size, lower / size, upper / size) for name, median, lower, upper in batch]


def in_pinocchio(chain: stiffgen.Chain, q: Array, F: Array, K: Array, expected: Array, single: Calls) -> None:
    try:
        import pinocchio as pin
    except ImportError:
        left_out.append("Pinocchio's bindings: 'pin' is not installed")
        return
    model = pin.buildModelFromUrdf(str(URDF))
    data, frame = model.createData(), model.getFrameId(chain.tip)

    def stiffness() -> np.ndarray:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.computeJointKinematicHessians(model, data)
        H = np.asarray(pin.getFrameKinematicHessian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
        A = K.copy()
        A[3:, 3:] -= pin.skew(F[3:] / 2)
        # Column-major memory that the binding labels row-major: [i, b, k] = dJ[k, b]/dq_i.
        Kq: Array = (H.ravel().reshape(7, 7, 6) @ F).T + J.T @ A @ J
        return Kq

    if not np.allclose(stiffness(), expected, rtol=1e-9, atol=1e-7):
        left_out.append("Pinocchio's bindings: the result disagrees")
        return
    single["Pinocchio's bindings, kinematic Hessian"] = stiffness


def in_jax(
    chain: stiffgen.Chain, q: Array, F: Array, K: Array, expected: Array, single: Calls, batch: list[Row]
) -> None:
    try:
        import jax
        import jax.numpy as jnp
    except ImportError:
        left_out.append("JAX is not installed")
        return
    jax.config.update("jax_enable_x64", True)

    def skew(v: Any) -> Any:
        return jnp.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    def jacobian(q: Any) -> Any:
        rotation, origin, axes, origins = jnp.eye(3), jnp.zeros(3), [], []
        for k, joint in enumerate(chain.joints):
            origin = origin + rotation @ jnp.array(joint.translation)
            cross = skew(np.array(joint.axis))
            turn = jnp.eye(3) + jnp.sin(q[k]) * cross + (1 - jnp.cos(q[k])) * (cross @ cross)
            rotation = rotation @ jnp.array(joint.rotation) @ turn
            axes.append(rotation @ jnp.array(joint.axis))
            origins.append(origin)
        tip = origin + rotation @ jnp.array(chain.tip_translation)
        columns = [jnp.concatenate([jnp.cross(a, tip - o), a]) for a, o in zip(axes, origins, strict=True)]
        return jnp.stack(columns, axis=1)

    def stiffness(q: Any, F: Any, K: Any) -> Any:
        J = jacobian(q)
        A = K.at[3:, 3:].add(-skew(F[3:] / 2))
        return jax.jacfwd(lambda x: jacobian(x).T @ F)(q) + J.T @ A @ J

    one, all_ = jax.jit(stiffness), jax.jit(jax.vmap(stiffness, in_axes=(0, 0, None)))
    if not np.allclose(all_(q, F, K), expected, rtol=1e-9, atol=1e-7):
        left_out.append("JAX: the result disagrees")
        return
    single["JAX, jit, forward mode"] = lambda: one(q[0], F[0], K).block_until_ready()
    batch.append(("JAX, vmap and jit, forward mode", *timed(lambda: all_(q, F, K).block_until_ready(), 5)))


def streaming(robot: Path) -> list[tuple[str, int, int]]:
    """Return (arrays, configurations, kB of memory that one call takes beyond its arrays)."""
    status = Path("/proc/meminfo")
    available = int(status.read_text().split("MemAvailable:")[1].split()[0]) if status.exists() else 0
    rows = []
    for count in STREAMED:
        # 14 (every other one is read) + 6 + 49 doubles a configuration
        if available < 1.2 * count * 69 * 8 / 1024:
            left_out.append(f"memory of {count} configurations: too little of it is free, or this is not Linux")
            continue
        for name, option in (("contiguous", []), ("every other element of q", ["spread"])):
            command = [sys.executable, str(HERE / "stream_memory.py"), str(robot), str(count), *option]
            rows.append((name, count, int(run(command))))
    return rows


def streamed_section(rows: list[tuple[str, int, int]]) -> list[str]:
    return [
        "## Memory of long arrays from Python",
        "",
        "Peak resident memory of the process during one call of the hybrid joint stiffness with `out=`, over what it",
        "holds before the call (arguments and result included). A copy of q would show; some 0.2 MB do not.",
        "",
        "| arrays | configurations | arguments and result, bytes | extra, bytes |",
        "|---|---|---|---|",
        *(f"| {name} | {count} | {count * 62 * 8} | {1024 * extra} |" for name, count, extra in rows),
        "",
    ]


GPU = [
    "## GPU",
    "",
    "`make bench-cuda` checks every CUDA function on a GPU, and times the joint stiffness against the memory roofline:",
    "41 doubles moved a configuration (7 of q, 6 of the wrench, 28 of the result's upper triangle), 328 bytes, and 111",
    "of its vector-Jacobian product, at the rate of a device-to-device copy in the same run. Figures of an H100:",
    "[performance.md](../docs/performance.md#cuda).",
    "",
]


def other_processors() -> list[str]:
    """Return the section of figures that were measured on other processors, as RESULTS.md has it."""
    text = (HERE / "RESULTS.md").read_text()
    start = text.index("## Other processors")
    return [*text[start : text.index("\n## ", start)].splitlines(), ""]


def table(head: str, rows: list[Row], unit: str, reference: float, named: str) -> list[str]:
    lines = [f"| {head} | {unit} | quartiles | to {named} |", "|---|---|---|---|"]
    for name, median, lower, upper in rows:
        figures = [f"{value:.0f}" if value >= 100 else f"{value:.3g}" for value in (median, lower, upper)]
        lines.append(f"| {name} | {figures[0]} | {figures[1]} to {figures[2]} | {median / reference:.2f} |")
    return [*lines, ""]


def svg(rows: list[Row], floor: float) -> str:
    height, left, scale = 22, 390, 300 / math.log10(max(r[1] for r in rows) / 10)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="820" height="{height * len(rows) + 70}" '
        'font-family="sans-serif" font-size="12" fill="currentColor">',
        THEME,
        '<text x="10" y="20" font-size="14">iiwa14 joint stiffness, hybrid: ns a configuration (logarithmic)</text>',
    ]
    for tick in (10, 30, 100, 300, 1000, 3000):
        x = left + scale * math.log10(tick / 10)
        if x < 720:
            lines.append(
                f'<path d="M{x:.0f} 32V{height * len(rows) + 40}" stroke="currentColor" stroke-opacity="0.15"/>'
            )
            lines.append(f'<text x="{x:.0f}" y="{height * len(rows) + 55}" text-anchor="middle">{tick}</text>')
    for k, (name, median, *_) in enumerate(rows):
        y = 36 + height * k
        colour = CORRECTED if name.startswith("stiffgen") else AXES[2] if "sincos" in name else AXES[1]
        width = max(scale * math.log10(median / 10), 1)
        lines.append(f'<text x="{left - 6}" y="{y + 14}" text-anchor="end">{name}</text>')
        lines.append(f'<rect x="{left}" y="{y + 2}" width="{width:.0f}" height="{height - 6}" fill="{colour}"/>')
        lines.append(f'<text x="{left + width + 4:.0f}" y="{y + 14}">{median:.0f} ({median / floor:.2f})</text>')
    return "\n".join([*lines, "</svg>", ""])


def bars(rows: list[Row], single: list[Row], batch: list[Row], grown: list[tuple[int, float, int, int]]) -> list[str]:
    ns = {name: median for name, median, *_ in rows}
    us = {name: median for name, median, *_ in single}
    own = min(ns[f"stiffgen; {c} {NATIVE}"] for c in ("gcc", "clang") if f"stiffgen; {c} {NATIVE}" in ns)
    many = min(ns[f"stiffgen batch; {c} {NATIVE}"] for c in ("gcc", "clang") if f"stiffgen batch; {c} {NATIVE}" in ns)
    avx2 = min(ns[f"stiffgen batch; {c} {AVX2}"] for c in ("gcc", "clang") if f"stiffgen batch; {c} {AVX2}" in ns)
    floor = ns["7 libm sincos"]

    def stock(name: str) -> float:
        return min(value for key, value in ns.items() if key.startswith(name))

    checks = [
        ("single call to 7 libm sincos", own / floor, 0.8),
        ("single call to CasADi C, differentiated (its best build)", own / stock("CasADi C, differentiated"), 0.3),
        ("single call to CasADi C, closed form (its best build)", own / stock("CasADi C, closed form"), 0.5),
        ("batch to 7 libm sincos, host's instruction set", many / floor, 0.3),
        ("batch to 7 libm sincos, AVX2", avx2 / floor, 0.5),
        ("one Python call to numpy.matmul", us["stiffgen"] / us["numpy.matmul of two 7x7"], 1.5),
        ("one Python call to the CasADi function", us["stiffgen"] / us["CasADi function"], 0.2),
        ("exponent of the time, 10 to 30 joints", exponent(grown, 1, joints.JOINTS[-1]), 2.1),
        (f"exponent of the machine code's size, {SAME_FUNCTIONS}", exponent(grown, 2, MAX_BATCH_JOINTS), 1.1),
    ]
    lines = ["| what | measured | bar | |", "|---|---|---|---|"]
    for name, value, bar in checks:
        lines.append(f"| {name} | {value:.2f} | {bar} | {'met' if value <= bar else '**missed**'} |")
    return [*lines, ""]


def versions() -> str:
    tools = []
    for name in ("gcc", "clang"):
        if shutil.which(name):
            tools.append(run([name, "--version"]).splitlines()[0])
    packages = [f"{p} {metadata.version(p)}" for p in ("casadi", "numpy", "pin", "jax") if _installed(p)]
    return ", ".join([*tools, f"Python {platform.python_version()}", *packages])


def _installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def main(target: Path = HERE) -> None:
    """Measure, and write RESULTS.md and results.svg into ``target``."""
    chain = stiffgen.load_chain(URDF)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        robot = stiffgen.generate(URDF, output=folder)
        built = libraries(chain, folder, robot)
        compiled = in_c(chain, folder, built, COUNT, ROUNDS)
        native = {name: path for name, path in built.items() if NATIVE in name or name.startswith("7 libm")}
        along_path = in_c(chain, folder, native, COUNT, ROUNDS, along_path=True)
        springs = of_springs(chain, folder, robot)
        single, batch = in_python(chain, robot)
        streamed = streaming(robot)
        derivatives = stiffgen.generate(URDF, output=folder, name="iiwa14_derivatives", derivatives=True)
        pinocchio = next(
            (path for title, path in built.items() if title.startswith("Pinocchio") and NATIVE in title), None
        )
        many = throughput(chain, URDF, derivatives, pinocchio, left_out)
        grown = growth(folder)
    rows, floor = compiled.rows, compiled.rows[0][1]
    found = claims.claims(along_path, single, metadata.version("pin") if _installed("pin") else "")
    lines = [
        "# Results",
        "",
        "Written by `benchmarks/run.py`; another machine gives other figures. All C contenders in one process, in",
        f"turn, on the same {COUNT} inputs (iiwa14, hybrid, dense task stiffness, full 7x7), results equal to",
        f"{AGREE:g} before timing. Medians and quartiles of {ROUNDS} rounds, one core.",
        "",
        f"* machine: {machine()}; load {os.getloadavg()[0]:.0f} at the end, C on one core before all other processes",
        f"* versions: {versions()}",
        "",
        *claims.section(found),
        "## Bars",
        "",
        *bars(rows, single, batch, grown),
        "## C and C++, ns a configuration",
        "",
        "![bar chart](results.svg)",
        "",
        *compiled_section(compiled, along_path),
        *springs_section(springs),
        "## One call from Python",
        "",
        *table("contender", single, "us", single[0][1], "matmul"),
        f"## {BATCH} configurations from Python",
        "",
        *table("contender", batch, "us a configuration", batch[0][1], "stiffgen, out="),
        *throughput_section(many),
        *streamed_section(streamed),
        *growth_section(grown),
        *other_processors(),
        *GPU,
        *(["Left out:", "", *(f"* {reason}" for reason in left_out), ""] if left_out else []),
    ]
    before = claims.stated((HERE / "RESULTS.md").read_text())
    (target / "RESULTS.md").write_text("\n".join(lines))
    chosen = [r for r in rows if PLAIN not in r[0].split(";")[-1] and AVX2 not in r[0]]
    (target / "results.svg").write_text(svg(chosen, floor))
    print((target / "RESULTS.md").read_text())
    print(json.dumps({"left out": left_out}))
    print("What pages may claim:", *found, sep="\n* ")
    if target == HERE:
        print("Renewed:", ", ".join(claims.renew(before, found)) or "nothing")


if __name__ == "__main__":
    main()
