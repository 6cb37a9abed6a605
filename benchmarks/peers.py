# SPDX-License-Identifier: MIT
"""Nearest calls of other libraries, equal results first, in one process and in turn; the least of many rounds.

    python -m benchmarks.peers [--rounds 400] [--robots DIR]

Prints the tables of docs/performance.md. Pinocchio needs the wheel ``pin`` and Eigen's headers; Talos needs the robots
of example-robot-data (``--robots``: its folder ``robots``); adam, frax and Drake need their wheels. What is missing is
named below the tables.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

import stiffgen
from benchmarks.run import BOOST
from benchmarks.tools import COUNT, HERE, NATIVE, URDF, least, pinned, run
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions

DATA = HERE.parent / "tests" / "data"
GROUPS = ("dynamics", "gravity", "hybrid")
left_out: list[str] = []
notes: list[str] = []


@dataclass(frozen=True)
class Robot:
    """Robot of the comparison: file, tip links, and links whose impossible inertia is used as given."""

    title: str
    urdf: Path
    tips: list[str]
    accept_inertia: tuple[str, ...] = ()


def robots(folder: Path | None) -> Iterator[Robot]:
    """Yield the robots whose files are there."""
    yield Robot("iiwa 14", URDF, ["link_ee"])
    yield Robot("UR5", DATA / "ur5.urdf", ["tool0"])
    yield Robot("Solo 12", DATA / "solo12.urdf", ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"])
    if folder is None:
        left_out.append("Talos: --robots is not given")
        return
    ends = ["left_sole_link", "right_sole_link", "gripper_left_base_link", "gripper_right_base_link"]
    accepted = "gripper_left_motor_single_link", "gripper_right_motor_single_link"
    yield Robot("Talos", folder / "talos_data" / "robots" / "talos_reduced.urdf", ends, accepted)


def _numbers(*parts: object) -> str:
    return "{" + ", ".join(repr(float(x)) for x in np.concatenate([np.ravel(np.asarray(p)) for p in parts])) + "}"


def robot_c(chain: Chain, name: str) -> str:
    """Return C with the robot's numbers for Pinocchio, and calls of our functions."""
    first = f"{chain.tips[0].name}_" if len(chain.tips) > 1 else ""
    lines = [f'#include "{name}.h"', "struct Joint { int parent, sliding; double axis[3], pose[12], body[10]; };"]
    lines += ["struct Tip { int joint; double pose[12]; };"]
    lines += [
        f"const int joint_count = {len(chain.joints)}, tip_count = {len(chain.tips)};",
        "const struct Joint joints[] = {",
    ]
    for joint in chain.joints:
        body = _numbers([joint.body.mass], joint.body.moment, joint.body.tensor)
        place = _numbers(joint.rotation, joint.translation)
        lines.append(f"{{{joint.parent}, {int(joint.prismatic)}, {_numbers(joint.axis)}, {place}, {body}}},")
    lines += ["};", "const struct Tip tips_of_robot[] = {"]
    lines += [f"{{{tip.joint}, {_numbers(tip.rotation, tip.translation)}}}," for tip in chain.tips]
    calls = {
        "static_torque": ("static_torque_derivatives", ("q", "wrenches", "gravity")),
        "gravity": ("gravity_joint_stiffness", ("q", "gravity")),
        "hessian": (f"{first}hybrid_jacobian_transpose_derivative", ("q",)),
    }
    lines.append("};")
    for own, (function, given) in calls.items():
        arguments = ", ".join(f"const double *{each}" for each in given)
        call = f"{name}_{function}({', '.join(given)}, result);"
        lines.append(f"void own_{own}({arguments}, double *result) {{ {call} }}")
    return "\n".join([*lines, ""])


def compiled_pinocchio(scratch: Path) -> Path:
    """Compile contenders/peers.cpp, once for all robots."""
    prefix = Path(next(p for p in map(Path, sys.path) if (p / "cmeel.prefix").exists())) / "cmeel.prefix"
    eigen = next(p for p in (prefix / "include/eigen3", Path("/usr/include/eigen3")) if p.exists())
    flags = ["-std=c++17", "-DNDEBUG", *BOOST.split(), *NATIVE.split(), f"-I{prefix / 'include'}", f"-I{eigen}"]
    run(["g++", *flags, "-c", str(HERE / "contenders" / "peers.cpp"), "-o", str(scratch / "peers.o")])
    return scratch / "peers.o"


def in_cpp(robot: Robot, pinocchio: Path, scratch: Path, rounds: int) -> list[tuple[str, float]]:
    """Return name and nanoseconds of each contender of contenders/peers.cpp."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tips, accepted = robot.tips, robot.accept_inertia
        chain = stiffgen.load_chain(robot.urdf, tip=tips, accept_inertia=accepted)
        springs = KernelOptions(kernels=GROUPS, batches=False)
        folder = stiffgen.generate(
            robot.urdf, tip=tips, accept_inertia=accepted, name="peer", output=scratch / robot.urdf.stem, build=False,
            **vars(springs),
        )  # fmt: skip
    notes.extend(f"{robot.title}: inertia of '{each.link}' as given, though {each.fault}" for each in chain.accepted)
    if chain.coupled:
        raise SystemExit(f"{robot.title}: has mimic joints, which the contender does not know")
    (folder / "robot.c").write_text(robot_c(chain, "peer"))
    program = folder / "peers"
    sources = [str(folder / name) for name in ("peer.c", "robot.c")]
    objects = [str(folder / name) for name in ("peer.o", "robot.o")]
    for source, target in zip(sources, objects, strict=True):
        run(["gcc", "-std=gnu99", *NATIVE.split(), "-w", "-c", source, "-o", target])
    run(["g++", str(pinocchio), *objects, "-o", str(program), "-lm"])
    lines = run(pinned([str(program), str(rounds)])).splitlines()
    return [(name, float(ns)) for name, ns in (line.split("\t") for line in lines)]


def pinocchio_table(folder: Path | None, scratch: Path, rounds: int) -> None:
    """Print our call, Pinocchio's and the ratio for every robot."""
    print("| robot | call of Pinocchio | ns | ours | ns | ratio |\n|---|---|---|---|---|---|")
    pinocchio = compiled_pinocchio(scratch)
    for robot in robots(folder):
        found = in_cpp(robot, pinocchio, scratch, rounds)
        for (theirs, slow), (ours, fast) in zip(found[::2], found[1::2], strict=True):
            print(
                f"| {robot.title} | `{theirs}` | {slow:.0f} | `{ours}` | {fast:.0f} | {fast / slow:.2f} |", flush=True
            )


def _agree(what: str, found: object, expected: object) -> None:
    found, expected = np.asarray(found), np.asarray(expected)
    if np.abs(found - expected).max() > 1e-9 * np.abs(expected).max():
        raise SystemExit(f"{what} disagrees")


def batch_table(scratch: Path, rounds: int) -> None:
    """Print batches of Jacobians and mass matrices, and of a torque in operational space, of the iiwa 14."""
    folder = stiffgen.generate(URDF, name="batch", output=scratch, kernels=GROUPS)
    robot = stiffgen.open_robot(folder).module
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (COUNT, 7))
    q[:, [3, 5]] = np.abs(q[:, [3, 5]]) / 2 + 0.5  # away from singularities, which magnify rounding
    J, M = np.empty((COUNT, 6, 7)), np.empty((COUNT, 7, 7))
    calls: dict[str, Callable[[], object]] = {
        "J, stiffgen, one thread": lambda: robot.hybrid.jacobian(q, out=J),
        "M, stiffgen, one thread": lambda: robot.mass_matrix(q, out=M),
    }
    for library in (_adam, _frax):
        try:
            found = library(q)
        except (ImportError, AttributeError) as error:
            left_out.append(f"{library.__name__[1:]}: {error}")
            continue
        for name, (call, expected) in found.items():
            own = robot.hybrid.jacobian(q) if name.startswith("J") else robot.mass_matrix(q)
            _agree(name, expected(call()), own)
            calls[name] = call
    calls["torque in operational space, stiffgen and C, one thread"] = _operational_space(robot, folder, q, scratch)
    print(f"\n| batch of {COUNT} configurations, iiwa 14 | ms | to ours |\n|---|---|---|")
    best = least(calls, rounds)
    for name, seconds in best.items():
        own = best.get(f"{name[0]}, stiffgen, one thread", seconds)
        print(f"| {name} | {1e3 * seconds:.2f} | {seconds / own:.1f} |")


_Found = dict[str, tuple[Callable[[], object], Callable[[object], np.ndarray]]]


def _adam(q: np.ndarray) -> _Found:
    """Return adam's batches, jitted; it counts the base's six coordinates first, for a fixed pose of the base."""
    jax = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    robot = importlib.import_module("adam.jax").KinDynComputations(
        str(URDF), [c.name for c in stiffgen.load_chain(URDF).coordinates]
    )
    base, many = jax.numpy.tile(jax.numpy.eye(4), (len(q), 1, 1)), jax.numpy.asarray(q)
    J = jax.jit(lambda base, q: robot.jacobian("link_ee", base, q)[:, :, 6:])
    M = jax.jit(lambda base, q: robot.mass_matrix(base, q)[:, 6:, 6:])
    return {
        "J, adam (JAX, jit, batch)": (lambda: J(base, many).block_until_ready(), np.asarray),
        "M, adam (JAX, jit, batch)": (lambda: M(base, many).block_until_ready(), np.asarray),
    }


def _frax(q: np.ndarray) -> _Found:
    """Return frax's batches, jitted."""
    jax = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    robot = importlib.import_module("frax").Robot(str(URDF))
    many = jax.numpy.asarray(q)
    M = jax.jit(jax.vmap(robot.mass_matrix))
    return {"M, frax (JAX, jit, vmap)": (lambda: M(many).block_until_ready(), np.asarray)}


def _operational_space(robot: ModuleType, folder: Path, q: np.ndarray, scratch: Path) -> Callable[[], object]:
    """Return the call of contenders/operational_space.c, which agrees with NumPy."""
    library = scratch / "operational_space.so"
    sources = [str(HERE / "contenders" / "operational_space.c"), str(folder / "batch_batch.c"), str(folder / "batch.c")]
    run(["gcc", *NATIVE.split(), "-shared", "-fPIC", f"-I{folder}", *sources, "-o", str(library), "-lm"])
    random = np.random.default_rng(2)
    dq, error, gains = random.normal(size=(COUNT, 7)), random.normal(size=(COUNT, 6)) * 0.05, np.array([100.0, 20.0])
    torque = np.empty((COUNT, 7))
    pointers = [each.ctypes.data_as(ctypes.c_void_p) for each in (q, dq, error, gains, torque)]
    function = ctypes.CDLL(str(library)).operational_space
    function(ctypes.c_size_t(COUNT), *pointers)
    J, M = robot.hybrid.jacobian(q), robot.mass_matrix(q)
    softness = J @ np.linalg.solve(M, J.swapaxes(1, 2))
    wanted = gains[0] * error[..., None] - gains[1] * (J @ dq[..., None])
    _agree("operational space", torque, (J.swapaxes(1, 2) @ np.linalg.solve(softness, wanted))[..., 0])
    return lambda: function(ctypes.c_size_t(COUNT), *pointers)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=400)
    parser.add_argument("--robots", type=Path, help="folder robots of example-robot-data")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        pinocchio_table(options.robots, Path(name), options.rounds)
        batch_table(Path(name), options.rounds)
    for each in notes:
        print(f"\nNote: {each}.")
    for each in left_out:
        print(f"\nLeft out: {each}.")
    print(f"\nLoad of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.")


if __name__ == "__main__":
    main()
