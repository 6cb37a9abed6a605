# SPDX-License-Identifier: MIT
"""Dynamics of trees whose joints mimic each other on, off and across the path, against Pinocchio's mimic joints.

Pinocchio reads the file itself (``mimic=True``): nothing of stiffgen stands between the file and the reference.
"""

from __future__ import annotations

import itertools
import random
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffgen import load_chain
from stiffgen.core.errors import ChainError
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import chain_kernels
from support.chain_checks import value

ROBOTS = range(30)
PLACES = {"on": (True, True), "off": (False, False), "follower off": (True, False), "master off": (False, True)}
"""Couplings by name: whether master and follower are on the path to the tip."""


def numbers(source: random.Random, count: int, size: float) -> str:
    return " ".join(f"{source.uniform(-size, size):.4f}" for _ in range(count))


def tree(seed: int) -> tuple[str, str, set[str]]:
    """Return a URDF, a tip link, and the kinds of couplings in it; Pinocchio reads no follower before its master."""
    for attempt in itertools.count():
        robot = drawn_tree(seed, random.Random(seed + 1000 * attempt))
        try:
            pin.buildModelFromXML(robot[0], mimic=True)
        except ValueError:
            continue
        return robot
    raise AssertionError


def drawn_tree(seed: int, source: random.Random) -> tuple[str, str, set[str]]:
    """Return text, tip and kinds of couplings of a random tree of 5 to 9 joints, two of which may follow."""
    size = source.randint(5, 9)
    parents = [0, *(source.choice((k, source.randint(0, k))) for k in range(1, size))]
    path, link = set(), source.randint(2, size)  # joints between the tip and the base
    tip = f"l{link}"
    while link:
        path.add(link - 1)
        link = parents[link - 1]
    masters: dict[int, int] = {}
    pairs = [(a, b) for a, b in itertools.combinations(range(size), 2)]
    source.shuffle(pairs)
    wanted = list(PLACES)[seed % 4]
    # pairs of the wanted kind come first
    pairs.sort(key=lambda pair: (pair[0] in path, pair[1] in path) != PLACES[wanted])
    for master, follower in pairs:
        if len(masters) < 2 and not {master, follower} & (set(masters) | set(masters.values())):
            masters[follower] = master
    text = '<robot name="tree"><link name="l0"/>'
    for k, parent in enumerate(parents):
        mimic = f'<mimic joint="j{masters[k]}" multiplier="{source.choice((1, -1, 0.5, -2))}" ' if k in masters else ""
        mimic += f'offset="{source.choice((0, 0.3))}"/>' if mimic else ""
        text += (
            f'<link name="l{k + 1}"><inertial><origin xyz="{numbers(source, 3, 0.2)}" rpy="{numbers(source, 3, 2)}"/>'
            f'<mass value="{source.uniform(0.1, 3):.3f}"/>'
            '<inertia ixx="0.02" iyy="0.025" izz="0.015" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial></link>'
            f'<joint name="j{k}" type="{source.choice(("revolute", "revolute", "prismatic"))}">'
            f'<parent link="l{parent}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{numbers(source, 3, 0.4)}" rpy="{numbers(source, 3, 2)}"/>'
            f'<axis xyz="{source.choice(("0 0 1", "0 1 0", "0.6 0 0.8"))}"/>'
            f'<limit lower="-9" upper="9" effort="1" velocity="1"/>{mimic}</joint>'
        )
    kinds = {name for name, on in PLACES.items() if any((a in path, b in path) == on for b, a in masters.items())}
    return text + "</robot>", tip, kinds


class Oracle:
    """Pinocchio's values at one state of the chain's coordinates; all other coordinates rest at zero."""

    def __init__(self, text: str, chain: Chain, seed: int) -> None:
        """Build Pinocchio's model and draw q, dq and gravity [m/s^2]; `columns` are the coordinates in its order."""
        model = self.model = pin.buildModelFromXML(text, mimic=True)
        random_state = np.random.default_rng(seed)
        self.q, self.velocity = random_state.uniform(-2, 2, (2, chain.dof))
        self.gravity = random_state.normal(size=3) * 6
        joints = [model.joints[model.getJointId(coordinate.name)] for coordinate in chain.coordinates]
        self.columns = [joint.idx_v for joint in joints]
        self.positions, self.rates = np.zeros(model.nq), np.zeros(model.nv)
        self.positions[[joint.idx_q for joint in joints]] = self.q
        self.rates[self.columns] = self.velocity

    def values(self) -> dict[str, np.ndarray]:
        """Return Pinocchio's mass matrix, bias forces, Coriolis forces and gravity torques in the chain's
        coordinates.
        """
        model, c = self.model, self.columns
        upper = np.triu(pin.crba(model, model.createData(), self.positions))
        mass = upper + np.triu(upper, 1).T
        model.gravity.linear = self.gravity
        bias = pin.nonLinearEffects(model, model.createData(), self.positions, self.rates)
        gravity = pin.computeGeneralizedGravity(model, model.createData(), self.positions)
        return {
            "mass_matrix": mass[np.ix_(c, c)],
            "bias_forces": bias[c],
            "coriolis": (bias - gravity)[c],
            "gravity_gradient": gravity[c],
        }


def error(computed: np.ndarray, reference: np.ndarray) -> float:
    return float(np.abs(computed - reference).max() / max(1.0, np.abs(reference).max()))


@pytest.mark.parametrize("seed", ROBOTS)
def test_dynamics_with_couplings_agree_with_pinocchio(seed: int, tmp_path: Path) -> None:
    """Compare dynamics of random trees with mimic joints with Pinocchio's, and the Hessian with its differences."""
    text, tip, _ = tree(seed)
    (tmp_path / "tree.urdf").write_text(text)
    chain = load_chain(tmp_path / "tree.urdf", tip=tip)
    oracle = Oracle(text, chain, seed)
    kernels = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    state = {"q": oracle.q, "velocity": oracle.velocity, "gravity": oracle.gravity}
    computed = {
        name: value(chain, kernels[name], **state) for name in ("mass_matrix", "bias_forces", "gravity_gradient")
    }
    computed["coriolis"] = value(chain, kernels["bias_forces"], **state | {"gravity": np.zeros(3)})
    errors = {name: error(computed[name], reference) for name, reference in oracle.values().items()}
    assert max(errors.values()) < 1e-11, errors
    # The Hessian of gravity's potential, by differences of the oracle's gradient.
    step, columns = 1e-5, []
    for k in range(chain.dof):
        sides = []
        for sign in (1, -1):
            moved = Oracle(text, chain, seed)
            moved.positions[moved.columns[k]] += sign * step
            sides.append(moved.values()["gravity_gradient"])
        columns.append((sides[0] - sides[1]) / (2 * step))
    assert error(value(chain, kernels["gravity_joint_stiffness"], **state), np.array(columns).T) < 1e-7


def test_the_trees_have_couplings_of_every_kind() -> None:
    assert set().union(*(tree(seed)[2] for seed in ROBOTS)) == set(PLACES)


def finger(name: str, mass: float, axis: str, mimic: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        f'<joint name="to_{name}" type="prismatic"><parent link="palm"/><child link="{name}"/>'
        f'<axis xyz="{axis}"/>{mimic}</joint>'
    )


ARM = (
    '<robot name="gripper"><link name="base"/><link name="palm"/><joint name="arm" type="revolute">'
    '<parent link="base"/><child link="palm"/><axis xyz="0 1 0"/></joint>'
)
GRIPPER = ARM + finger("left", 0.5, "1 0 0") + finger("right", 3, "-1 0 0", '<mimic joint="to_left"/>') + "</robot>"


def test_the_other_finger_moves_its_mass_and_not_the_tip(tmp_path: Path) -> None:
    """Let a second finger follow: both masses count (0.5 + 3 kg), and the tip's Jacobian is without it."""
    file = tmp_path / "gripper.urdf"
    file.write_text(GRIPPER)
    chain = load_chain(file, tip="left")
    kernels = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    mass = value(chain, kernels["mass_matrix"], q=np.array([0.3, 0.1]))
    assert mass[1, 1] == pytest.approx(3.5, abs=1e-14)
    assert kernels["hybrid_jacobian"].scope(chain).joints == chain.joints[:2]
    assert load_chain(file, tip="left", masses=False).joints[1].name == "to_left"
    assert len(load_chain(file, tip="left", masses=False).joints) == 2


def test_a_follower_before_the_base_is_refused(tmp_path: Path) -> None:
    """Let a joint before the base follow one beyond it: refused, as its mass would be missing."""
    file = tmp_path / "gripper.urdf"
    file.write_text(
        GRIPPER.replace('<mimic joint="to_left"/>', "").replace(
            'xyz="0 1 0"/>', 'xyz="0 1 0"/><mimic joint="to_left"/>'
        )
    )
    with pytest.raises(ChainError, match=r"'arm' moves with 'to_left'.*base nearer the root"):
        load_chain(file, tip="left", base="palm")
    assert load_chain(file, tip="left", base="palm", masses=False).dof == 1
