# SPDX-License-Identifier: MIT
"""Contacts and springs at all tips in one pass over the tree, against the sum of the tips' own functions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import stiffgen
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.result import as_results
from stiffgen.families.contacts import expressions as contacts
from support.exact_tree import as_array, exponential, mp, tree_urdf
from support.project import ROOT, assert_close

SPRINGS = KernelOptions(springs=("coupled", "quaternion"))
DATA = ROOT / "tests" / "data"
ROBOTS = {
    "tree": ("left", "right"),
    "solo12": ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"),
    "dual_arm": ("left hand", "right-hand"),
}


def random_pose(random: np.random.Generator) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = as_array(exponential(mp.matrix(random.normal(size=3).tolist())))
    pose[:3, 3] = random.normal(size=3)
    return pose


FURTHER = ("tree", "tools"), *((robot, base) for robot in ("solo12", "dual_arm") for base in ("stands", "tools"))
"""Wide: the tree stands and floats, and each robot with a base that floats stays, the two arms with tools."""
SETTINGS = [
    pytest.param((robot, base), id=f"{robot}-{base}", marks=pytest.mark.wide if (robot, base) in FURTHER else ())
    for robot in ROBOTS
    for base in ("floats", "stands", "tools")
]


@pytest.fixture(scope="module", params=SETTINGS)
def setting(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Kernels of a tree with sliding and mimic joints, a quadruped, two arms; the base floats, stands, and with tools
    at run time.
    """
    robot, kind = request.param
    if robot == "tree":
        file = tmp_path_factory.mktemp("contacts") / "tree.urdf"
        file.write_text(tree_urdf(7))
    else:
        file = DATA / f"{robot}.urdf"
    options = {"floats": {"floating_base": True}, "stands": {}, "tools": {"runtime_tool": True}}[kind]
    if kind == "floats" and robot == "dual_arm":
        options = {"floating_base": True, "runtime_tool": True}
    chain = stiffgen.load_chain(file, tip=ROBOTS[robot], **options)
    kernels = {(k.group, k.name): k for k in chain_kernels(chain, SPRINGS) if k.by_tips}
    return SimpleNamespace(chain=chain, kernels=kernels)


def arguments(chain: stiffgen.Chain, kernel: Kernel, random: np.random.Generator) -> list[np.ndarray]:
    """Return random arguments of a kernel; forces and stiffnesses have the size 100."""
    given = []
    for argument in kernel.arguments:
        shape = argument.array(chain).shape
        if argument.name == "base_pose":
            given.append(random_pose(random))
        elif argument.name in ("tool_poses", "equilibria"):
            given.append(np.vstack([random_pose(random) for _ in range(shape[0])]))
        else:
            values = random.normal(size=shape) * (1 if argument.name == "q" else 100)
            given.append(values.reshape(-1, shape[-1]) if len(shape) > 2 else values)
    return given


OF_SPRINGS = (
    ("spring", "energy"), ("spring", "torque"), ("spring", "joint_stiffness"), ("spring", "linearization"),
    ("spring_coupled", "joint_stiffness"), ("spring_quaternion", "linearization"),
)  # fmt: skip


@pytest.mark.parametrize(("group", "name"), [*((rep, "joint_stiffness") for rep in REPRESENTATIONS), *OF_SPRINGS])
def test_one_pass_is_the_sum_over_the_tips(setting: SimpleNamespace, group: str, name: str) -> None:
    """Compare the total in one pass with the sum over tips, each verified elsewhere."""
    chain, kernel = setting.chain, setting.kernels[group, f"{name}_total"]
    assert kernel.by_tips is not None
    one_pass, by_tips = (casadi_function(chain, each) for each in (kernel, replace(kernel, program=kernel.by_tips)))
    random = np.random.default_rng(3)
    for _ in range(5):
        given = arguments(chain, kernel, random)
        for value, expected in zip(as_results(one_pass(*given)), as_results(by_tips(*given)), strict=True):
            found = np.asarray(value)
            assert_close(found, np.asarray(expected))
            if found.shape[0] == found.shape[1]:
                assert np.array_equal(found, found.T)


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_symmetric_parts_of_task_stiffnesses_are_used(setting: SimpleNamespace, rep: str) -> None:
    """Move entries between the triangles, keeping their mean: the result keeps its bits."""
    chain, kernel = setting.chain, setting.kernels[rep, "joint_stiffness_total"]
    function = casadi_function(chain, kernel)
    given = arguments(chain, kernel, np.random.default_rng(5))
    K = np.triu(given[-1].reshape(-1, 6, 6), 1)
    turned = np.swapaxes(K, 1, 2)
    symmetric, moved = K + turned, 4 * K - 2 * turned
    found, expected = (np.asarray(function(*given[:-1], each.reshape(-1, 6))) for each in (moved, symmetric))
    assert np.array_equal(found, expected)


def test_the_work_does_not_grow_with_the_tips(tmp_path: Path) -> None:
    """Count the operations of four tips on one chain: little more than of one."""

    def operations(tips: int) -> int:
        """Return the CasADi instructions of the total joint stiffness of a chain with that many tips."""
        names = [f"l{k}" for k in (20, 19, 18, 17)[:tips]]
        links = "".join(f'<link name="l{k}"/>' for k in range(21))
        joints = "".join(
            f'<joint name="j{k}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 {0.1 * k}"/><axis xyz="0 0 1"/></joint>'
            for k in range(20)
        )
        file = tmp_path / "robot.urdf"
        file.write_text(f'<robot name="r">{links}{joints}</robot>')
        chain = stiffgen.load_chain(file, tip=names, masses=False)
        kernel = next(k for k in chain_kernels(chain) if k.by_tips and k.group == "hybrid")
        return int(casadi_function(chain, kernel).n_instructions())

    one_more = operations(3) - operations(2)
    assert one_more < 0.1 * operations(2)


def test_a_sign_of_the_load_is_seen(setting: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Break each term of the covector once: the comparison sees it."""
    chain, kernel = setting.chain, setting.kernels["hybrid", "joint_stiffness_total"]
    given = arguments(chain, kernel, np.random.default_rng(6))
    right = np.asarray(casadi_function(chain, kernel)(*given))
    made = contacts._Load
    for part in ("K", "f", "m", "Q"):

        def broken(K, f, m, Q, part=part):
            values = {"K": K, "f": f, "m": m, "Q": Q}
            values[part] = -values[part]
            return made(**values)

        load = contacts._load

        def flipped(*args, load=load, broken=broken):
            one = load(*args)
            return broken(one.K, one.f, one.m, one.Q)

        with monkeypatch.context() as patch:
            patch.setattr(contacts, "_load", flipped)
            wrong = np.asarray(casadi_function(chain, kernel)(*given))
        assert np.abs(wrong - right).max() > 1e-6 * np.abs(right).max()
