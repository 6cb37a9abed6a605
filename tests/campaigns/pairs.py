# SPDX-License-Identifier: MIT
"""Compare springs between two tips with 60 digits on random trees, and sum up their work round closed orbits.

    python tests/campaigns/pairs.py [--trees 200] [--orbits 200]

Trees have 0 to 3 joints that carry both tips, sliding and mimic joints; every second one floats, every third has tools
at run time. The table has the largest deviation of each quantity, relative to its largest entry: from 60 digits, after
an exchange of the tips, and of the net wrench on an object that both tips hold. An orbit is a closed curve of all
joints; most orbits turn the tips by more than half a turn against each other.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.samples import Samples
from support.exact_pair import TIPS, exact_pair, pair_tree

NAMES = ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness")
WORDS = (":".join(TIPS), ":".join(reversed(TIPS)))
Array = np.ndarray


def tree(seed: int, folder: Path) -> tuple[str, Chain]:
    """Return the text of a random tree and its chain."""
    text, file = pair_tree(seed), folder / "tree.urdf"
    file.write_text(text)
    return text, stiffgen.load_chain(file, tip=TIPS, floating_base=seed % 2 == 1, runtime_tool=seed % 3 == 2)


def kernels_of(chain: Chain, word: str) -> dict[str, Kernel]:
    """Return the kernels of a pair by qualified name."""
    table = chain_kernels(chain, stiffgen.KernelOptions(pairs=(word,)))
    return {kernel.qualified_name: kernel for kernel in table if kernel.span}


def drawn(chain: Chain, kernels: dict[str, Kernel], seed: int) -> dict[str, Array]:
    """Return one state: the arguments of all kernels by name."""
    samples = Samples(chain, 1, seed)
    arguments = {argument.name: argument for kernel in kernels.values() for argument in kernel.arguments}
    return {name: samples[argument][0] for name, argument in arguments.items()}


def called(chain: Chain, kernel: Kernel, given: dict[str, Array]) -> Array:
    """Return the only result of a kernel in one state."""
    stacks = [np.asarray(given[argument.name])[None] for argument in kernel.arguments]
    value: Array = np.asarray(function_of_stacks(chain, kernel)(*stacks))[0]
    return value


def relative(found: Array, expected: Array) -> float:
    """Return the largest deviation, relative to the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def exchanged(given: dict[str, Array]) -> dict[str, Array]:
    """Return the arguments of the same spring with the tips exchanged."""
    E0, rest = given["rest"][:3, :3], np.linalg.inv(given["rest"])
    rest[:3, :3], rest[:3, 3] = E0.T, -E0.T @ given["rest"][:3, 3]
    turned = {name: E0.T @ given[name] @ E0 for name in ("translation_stiffness", "rotation_stiffness")}
    tools = {"tool_poses": given["tool_poses"][::-1]} if "tool_poses" in given else {}
    return given | {"rest": rest} | turned | tools


def net_wrench(chain: Chain, given: dict[str, Array], wrench: Array) -> float:
    """Return the net wrench of both tips about tip A, relative to the wrench: force, and moment over the arm."""
    points = []
    for k, tip in enumerate(chain.tips):
        pose = next(each for each in chain_kernels(chain) if each.tip == tip and each.name == "forward_kinematics")
        tool = {"tool_pose": given["tool_poses"][k]} if chain.runtime_tool else {}
        points.append(called(chain, pose, given | tool)[:3, 3])
    (fa, ma, fb, mb), arm = np.split(wrench, 4), points[1] - points[0]
    size = max(1.0, np.linalg.norm(arm)) * np.abs(wrench).max()
    return float(max(np.abs(fa + fb).max(), np.abs(ma + mb + np.cross(arm, fb)).max()) / size)


def errors(seed: int, folder: Path) -> dict[str, float]:
    """Return the deviations of one tree by their names."""
    text, chain = tree(seed, folder)
    kernels = kernels_of(chain, WORDS[0])
    given, found = drawn(chain, kernels, seed), dict[str, float]()
    groups = ("pair", ("absolute", "bimanual")[seed % 2])
    values: dict[str, Array] = {}
    exact = exact_pair(text, chain, groups, given)
    for group in groups:
        for name in NAMES:
            values[f"{group}.{name}"] = value = called(chain, kernels[f"{group}_{name}"], given)
            found[f"{group}.{name}"] = relative(value, exact[f"{group}_{name}"])
        K = values[f"{group}.joint_stiffness"]
        task = values[f"{group}.task_stiffness"]
        assert np.array_equal(K, K.T) and np.array_equal(task, task.T)
    carrying = {joint.coordinate for joint in chain.joints} - on_the_way(kernels["pair_torque"], chain)
    assert not values["pair.torque"][list(carrying)].any() and not values["pair.joint_stiffness"][list(carrying)].any()
    other, back = kernels_of(chain, WORDS[1]), exchanged(given)
    for name in ("energy", "torque", "joint_stiffness"):
        found[f"exchange of tips: {name}"] = relative(
            called(chain, other[f"pair_{name}"], back), values[f"pair.{name}"]
        )
    found["net wrench"] = net_wrench(chain, given, values["pair.wrench"])
    return found


def on_the_way(kernel: Kernel, chain: Chain) -> set[int]:
    """Return the velocity coordinates between the tips."""
    return {joint.coordinate for joint in kernel.scope(chain).joints}


def orbit_works(count: int, folder: Path, nodes: int = 512) -> Iterator[tuple[float, bool]]:
    """Yield the work [J] of the torque round closed orbits, and whether the tips make a half turn on the way."""
    random = np.random.default_rng(1)
    for seed in range(count):
        _, chain = tree(4 * seed, folder) if seed % 3 != 2 else tree(4 * seed + 2, folder)
        kernels = kernels_of(chain, WORDS[0])
        given = drawn(chain, kernels, seed)
        t = 2 * np.pi * np.arange(nodes)[:, None] / nodes
        waves = random.normal(size=(2, 2, len(chain.coordinates))) * np.array([2.0, 0.6])[:, None, None]
        q = given["q"] + sum(np.cos(k * t) * waves[k - 1, 0] + np.sin(k * t) * waves[k - 1, 1] for k in (1, 2))
        rate = sum(k * (np.cos(k * t) * waves[k - 1, 1] - np.sin(k * t) * waves[k - 1, 0]) for k in (1, 2))
        torque = kernels["pair_torque"]
        stacks = [q if each.is_q else np.tile(given[each.name], (nodes, *([1] * given[each.name].ndim)))
                  for each in torque.arguments]  # fmt: skip
        torques = np.asarray(function_of_stacks(chain, torque)(*stacks))[:, chain.base_coordinates :]
        yield float(2 * np.pi / nodes * (torques * rate).sum()), largest_turn(chain, given, q) > 0.99 * np.pi


def largest_turn(chain: Chain, given: dict[str, Array], q: Array) -> float:
    """Return the largest angle [rad] between the tips, less the rest rotation, along joint positions."""
    poses = [each for each in chain_kernels(chain) if each.name == "forward_kinematics"]
    A, B = (np.asarray(function_of_stacks(chain, each)(*_of_pose(each, given, q, k)))[:, :3, :3]
            for k, each in enumerate(poses))  # fmt: skip
    turns = np.swapaxes(A, 1, 2) @ B @ given["rest"][:3, :3].T
    return float(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)).max())


def _of_pose(kernel: Kernel, given: dict[str, Array], q: Array, tip: int) -> list[Array]:
    named = given | ({"tool_pose": given["tool_poses"][tip]} if "tool_poses" in given else {})
    return [q if each.is_q else np.tile(named[each.name], (len(q), 1, 1)) for each in kernel.arguments]


def main() -> None:
    """Print the largest deviations and the work."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trees", type=int, default=200)
    parser.add_argument("--orbits", type=int, default=200)
    options = parser.parse_args()
    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(options.trees):
            for what, error in errors(seed, folder).items():
                worst[what] = max(worst.get(what, 0.0), error)
        works = list(orbit_works(options.orbits, folder))
    print(f"| {options.trees} trees | largest relative deviation |\n|---|---|")
    for what, error in worst.items():
        print(f"| {what} | {error:.1e} |")
    half = sum(turned for _, turned in works)
    largest = max((abs(work) for work, _ in works), default=0.0)
    print(f"\nwork round {len(works)} orbits, {half} of them through a half turn: at most {largest:.1e} J")
    exchange = max(error for what, error in worst.items() if what.startswith("exchange"))
    digits = max(error for what, error in worst.items() if "." in what)
    assert digits < 1e-11 and exchange < 1e-12 and worst["net wrench"] < 1e-13 and largest < 1e-9


if __name__ == "__main__":
    main()
