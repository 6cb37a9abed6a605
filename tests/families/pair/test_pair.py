# SPDX-License-Identifier: MIT
"""Springs between two tips: 60 digits, MuJoCo, exchange of the tips, net wrench, orbits, cost, refusals.

``make campaign NAME=pairs`` runs the comparison with 60 digits on 200 trees and orbits.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import stiffgen
from campaigns.pairs import called, drawn, errors, kernels_of, orbit_works, relative
from stiffgen.core.emit.c import print_kernels
from stiffgen.core.errors import ChainError
from stiffgen.core.lower.variant import BATCH, SINGLE, Variant
from stiffgen.core.opened import open_robot
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_oracles, check_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.families.derivatives.check import check_derivatives
from support.exact_tree import tree_urdf
from support.project import ROOT

PANDA = ROOT / "tests" / "data" / "panda.urdf"
BOTH = "left:right"


def loaded(folder: Path, text: str, tips: tuple[str, ...] = ("left", "right"), **options: Any) -> stiffgen.Chain:
    file = folder / "robot.urdf"
    file.write_text(text)
    return stiffgen.load_chain(file, tip=tips, **options)


def two_pandas(bases: int = 2) -> str:
    """Return a stand with Pandas on it, left and right."""
    text = re.sub(r"<robot[^>]*>|</robot>|<\?xml.*?\?>|<!--.*?-->", "", PANDA.read_text(), flags=re.DOTALL)
    arms = []
    for side in ("left", "right")[:bases]:
        arm = re.sub(r'(name|link|joint)="(panda_[^"]*)"', rf'\1="{side}_\2"', text)
        stand = f'<joint name="{side}_stand" type="fixed"><parent link="stand"/><child link="{side}_panda_link0"/>'
        arms.append(f'{arm}{stand}<origin xyz="0 {0.3 if side == "left" else -0.3} 0"/></joint>')
    return f'<robot name="pandas"><link name="stand"/>{"".join(arms)}</robot>'


@pytest.mark.parametrize(
    "seed",
    [0, pytest.param(5, marks=pytest.mark.slow), *(pytest.param(seed, marks=pytest.mark.wide) for seed in (3, 10))],
)
def test_sixty_digits_exchange_and_net_wrench(seed: int, tmp_path: Path) -> None:
    """Bitwise symmetry and zeros of shared joints and base are asserted by the campaign itself."""
    found = errors(seed, tmp_path)
    assert len(found) == 14
    for what, error in found.items():
        assert error < (1e-13 if what == "net wrench" else 1e-12 if what.startswith("exchange") else 1e-11), (
            what,
            error,
        )


def test_no_work_round_orbits_with_half_turns(tmp_path: Path) -> None:
    works = list(orbit_works(3, tmp_path))
    assert max(abs(work) for work, _ in works) < 1e-9
    assert all(turned for _, turned in works)


def test_tangent_is_that_of_mujocos_torque(tmp_path: Path) -> None:
    """Compare the joint stiffness with differences of the torque through MuJoCo's Jacobians."""
    text = re.sub(r"<mimic[^>]*>", "", tree_urdf(7))
    chain = loaded(tmp_path, text)
    kernels = kernels_of(chain, BOTH)
    given = drawn(chain, kernels, 1)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, k) for k in range(model.njnt)]
    order = [names.index(each.name) for each in chain.coordinates]
    wrench = function_of_stacks(chain, kernels["pair_wrench"])

    def torque(q: np.ndarray) -> np.ndarray:
        """Return the torque (dof) [N m] of both ends' wrenches through MuJoCo's Jacobians."""
        data.qpos[order] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        F = np.asarray(
            wrench(*(np.asarray({**given, "q": q}[a.name])[None] for a in kernels["pair_wrench"].arguments))
        )[0]
        total = np.zeros(model.nv)
        for k, tip in enumerate(("left", "right")):
            parts = np.zeros((2, 3, model.nv))
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
            mujoco.mj_jac(model, data, parts[0], parts[1], data.xpos[body], body)
            total -= parts.reshape(6, -1).T @ F[6 * k : 6 * k + 6]
        return total[order]

    step, n = 1e-5, len(chain.coordinates)
    rows = [(torque(given["q"] + step * unit) - torque(given["q"] - step * unit)) / (2 * step) for unit in np.eye(n)]
    assert relative(called(chain, kernels["pair_torque"], given), torque(given["q"])) < 1e-12
    assert relative(called(chain, kernels["pair_joint_stiffness"], given), -np.array(rows)) < 1e-6


def test_the_half_way_point_serves_both_tips_alike(tmp_path: Path) -> None:
    """Tips 0.4 m apart, B 2 cm aside and turned by 0.1 rad: seen from A 16 N, seen from B -16 N, half-way nothing."""
    chain = loaded(tmp_path, tree_urdf(7), runtime_tool=True)
    kernels = kernels_of(chain, BOTH)
    given, rest, target = drawn(chain, kernels, 0), np.eye(4), np.eye(4)
    rest[0, 3], target[:2, 3] = 0.4, (0.4, 0.02)
    target[:2, :2] = [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]
    poses = [each for each in chain_kernels(chain) if each.name == "forward_kinematics"]
    links = [called(chain, pose, given | {"tool_pose": np.eye(4)}) for pose in poses]
    tools = np.stack([np.linalg.inv(links[0]), np.linalg.inv(links[1]) @ target])
    given |= {"rest": rest, "tool_poses": tools, "translation_stiffness": 800 * np.eye(3)}
    # [N] along y: stiffness times the offset that either tip sees
    from_a, from_b = 800 * target[1, 3], 800 * (np.linalg.inv(target)[1, 3])
    assert np.isclose(from_a, 16.0) and np.isclose(from_b, 16.0, rtol=0.01)  # both along +y: opposite springs
    assert abs(called(chain, kernels["pair_wrench"], given)[7]) < 0.05  # [N] along y on B


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, id="stands", marks=pytest.mark.wide),
        pytest.param({"floating_base": True, "runtime_tool": True}, id="floats, tools"),
    ],
)
@pytest.mark.slow
def test_oracles_of_verify_and_gradients(options: dict[str, Any], tmp_path: Path) -> None:
    """Run all oracles of the springs between two tips, with derivatives; the counts notice a lost check."""
    chain = loaded(tmp_path, tree_urdf(7, 6), **options)
    chosen = stiffgen.KernelOptions(pairs=BOTH, springs=("bounded",), derivatives=True)
    table = tuple(kernel for kernel in chain_kernels(chain, chosen) if kernel.span)
    assert len(table) == 48
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    checks = check_oracles(table, chosen) + check_robot(functions, chain, 3, 0, chosen, table)
    pool = argument_samples(chain, 3, 0, chosen)
    checks += check_derivatives(functions, table, chain, pool)
    assert len(checks) == 44 + 24  # values and symmetry; VJPs
    assert all(check.passed for check in checks), [check for check in checks if not check.passed]


def test_bounded_spring_keeps_its_limits(tmp_path: Path) -> None:
    """Pull two tips far apart: the bounded spring stays below 30 N, and stores less than the free one."""
    chain = loaded(tmp_path, tree_urdf(7))
    table = chain_kernels(chain, stiffgen.KernelOptions(pairs=BOTH, springs=("bounded",)))
    kernels = {kernel.qualified_name: kernel for kernel in table if kernel.span}
    far = drawn(chain, kernels, 4) | {"force_limit": np.array(30.0), "moment_limit": np.array(4.0)}
    free, limited = (called(chain, kernels[f"{group}_wrench"], far) for group in ("pair", "pair_bounded"))
    assert np.linalg.norm(free[:3]) > 60 and 5 < np.linalg.norm(limited[:3]) < 30
    energies = [called(chain, kernels[f"{group}_energy"], far) for group in ("pair", "pair_bounded")]
    assert energies[1] < energies[0]


def test_several_pairs_have_the_tips_names(tmp_path: Path) -> None:
    """Pair three tips, named by links or names: each pair has the joints between its tips only."""
    text = tree_urdf(7).replace(
        "</robot>", '<link name="mid tip"/><joint name="fixed" type="fixed"><parent link="left_2"/>'
        '<child link="mid tip"/><origin xyz="0.1 0 0"/></joint></robot>',
    )  # fmt: skip
    chain = loaded(tmp_path, text, ("left", "right", "mid tip"))
    table = chain_kernels(chain, stiffgen.KernelOptions(pairs=("left:right", "mid tip:left", "right:mid_tip")))
    groups = dict.fromkeys(kernel.group for kernel in table if kernel.span)
    assert list(groups)[:3] == ["pair_left_right", "absolute_left_right", "bimanual_left_right"]
    assert "pair_mid_tip_left" in groups and len(groups) == 9
    way = next(kernel for kernel in table if kernel.qualified_name == "pair_mid_tip_left_torque").scope(chain)
    assert [joint.name for joint in way.joints] == ["left_j3", "left_j4"]
    with pytest.raises(ChainError, match="no joint moves between"):
        two = loaded(
            tmp_path, text.replace('"fixed"><parent link="left_2"', '"fixed"><parent link="left"'), ("left", "mid tip")
        )
        chain_kernels(two, stiffgen.KernelOptions(pairs="left:mid tip"))


REFUSED = {
    "left": "is not A:B",
    "left:right:left": "is not A:B",
    "left:": "is not A:B",
    "left:wrist": "wrist is no tip",
    "left:left": "names one tip twice",
}


@pytest.mark.parametrize("word", REFUSED)
def test_refused_words(word: str, tmp_path: Path) -> None:
    chain = loaded(tmp_path, tree_urdf(7))
    with pytest.raises(ChainError, match=REFUSED[word]):
        chain_kernels(chain, stiffgen.KernelOptions(pairs=(word,)))


def test_refused_pairs(tmp_path: Path) -> None:
    chain = loaded(tmp_path, tree_urdf(7))
    with pytest.raises(ChainError, match="have a pair already"):
        chain_kernels(chain, stiffgen.KernelOptions(pairs=("left:right", "right:left")))
    one = stiffgen.load_chain(PANDA, tip="panda_hand")
    with pytest.raises(ChainError, match="the robot has one tip"):
        chain_kernels(one, stiffgen.KernelOptions(pairs="panda_hand:panda_link7"))


def test_manifest_and_module(tmp_path: Path) -> None:
    """Read the folder of a pair: the manifest keeps it, and each language has its functions."""
    chain_file = tmp_path / "robot.urdf"
    chain_file.write_text(tree_urdf(7))
    folder = stiffgen.generate(
        chain_file, tip=["left", "right"], pairs=[BOTH], kernels="pair", output=tmp_path, build=False, controller=False
    )  # fmt: skip
    opened = open_robot(folder)
    assert opened.springs.pairs == (BOTH,)
    assert {kernel.group for kernel in opened.table if kernel.span} == {"pair"}
    for file in ("tree.h", "tree.hpp", "tree_batch.c", "README.md", "__init__.pyi"):
        assert "pair" in (folder / file).read_text(), file
    assert "## Springs between two tips\n\n`tree.pair`: springs" in (folder / "README.md").read_text()
    assert "A is left, B is right" in (folder / "tree.h").read_text()
    assert "Rounding: every entry of joint_stiffness within" in (folder / "tree.h").read_text()


def _link(name: str, parent: str, place: str, axis: str = "0 0 1") -> str:
    return (
        f'<link name="{name}"/><joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>'
    )


def test_loops_between_the_tips_are_refused(tmp_path: Path) -> None:
    """Put a parallelogram between the tips: refused; one that carries both is taken."""
    bars = (
        _link("crank", "ground", "0 0 0")
        + _link("coupler", "crank", "0.2 0.1 0")
        + _link("rocker", "ground", "0.4 0 0")
    )
    hands = "".join(
        _link(name, "coupler", place, "0.6 0 0.8") for name, place in (("left", "0.3 0 0"), ("right", "0 0.2 0"))
    )
    text = f'<robot name="r"><link name="ground"/>{bars}{hands}{_link("arm", "ground", "1 0 0")}</robot>'
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    chain = stiffgen.load_chain(
        file, tip=["left", "right", "arm"], loop=["coupler:0.4,0,0=rocker:0.2,0.1,0"], actuated=["crank"]
    )
    assert len([k for k in chain_kernels(chain, stiffgen.KernelOptions(pairs=BOTH)) if k.span]) == 18
    with pytest.raises(ChainError, match="joint 'crank' between the tips belongs to the closed loop"):
        chain_kernels(chain, stiffgen.KernelOptions(pairs="left:arm"))


def operations(chain: stiffgen.Chain, variant: Variant, pairs: tuple[str, ...], names: tuple[str, ...]) -> list[int]:
    few = [name.replace("_", ".", 1) for name in names]
    code = print_kernels(chain, "robot", variant, stiffgen.KernelOptions(pairs=pairs, kernels=few))
    return [function.operations.total for kernel, function in code.kernels if kernel.qualified_name in names]


def test_cost_on_two_arms(tmp_path: Path) -> None:
    """Count instructions on two arms: at most 2.2 times two Hessians of one arm."""
    two = loaded(tmp_path, two_pandas(), ("left_panda_hand", "right_panda_hand"))
    (tmp_path / "one").mkdir()
    one = loaded(tmp_path / "one", two_pandas(1), ("left_panda_hand",))
    for variant in (SINGLE, BATCH):
        (pair,) = operations(two, variant, ("left_panda_hand:right_panda_hand",), ("pair_joint_stiffness",))
        (spring,) = operations(one, variant, (), ("spring_joint_stiffness",))
        assert 1.0 < pair / (2 * spring) < 2.2, (pair, spring)
