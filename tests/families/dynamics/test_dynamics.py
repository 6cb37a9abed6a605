# SPDX-License-Identifier: MIT
"""The mass matrix: exact to the last digits wherever the base stands and however small the robot is; gravity and bias.

Values by support/exact_tree.py, which knows no composites, no link axes and no Steiner terms,
and by Pinocchio.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from stiffgen import StiffnessModel, Tool, load_chain
from stiffgen.core.symbolic.kernels import KERNELS, chain_kernels
from stiffgen.core.symbolic.steps import Map
from stiffgen.families.dynamics.kernels import MAX_UNROLLED_MASS_JOINTS
from support.chain_checks import value
from support.chains import chain_urdf
from support.exact_tree import chain_mass_matrix, tree_urdf
from support.pinocchio_oracle import PinocchioChain
from support.project import URDF, assert_close

MASS = next(kernel for kernel in KERNELS if kernel.name == "mass_matrix")
CHAINS = {  # name: types of its joints
    "turning": "rrrrr",
    "sliding": "rprrp",
    "slides first": "prrp",
    "mimics": "rrmr",
    "too long to unroll": "r" * (MAX_UNROLLED_MASS_JOINTS + 1),
}


def of_file(tmp_path: Path, text: str, q: np.ndarray) -> np.ndarray:
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    return value(load_chain(file), MASS, q=q)


def based(text: str, xyz: str, rpy: str = "0 0 0") -> str:
    """The robot on a base link that a fixed joint holds at a place in the world."""
    mount = (
        f'<link name="world"/><joint name="mount" type="fixed"><parent link="world"/><child link="l0"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint></robot>'
    )
    return text.replace("</robot>", mount)


def coordinates(types: str) -> np.ndarray:
    return np.random.default_rng(3).uniform(-3, 3, len(types) - types.count("m"))


@pytest.mark.parametrize("name", CHAINS)
def test_the_last_digits(name, tmp_path):
    types = CHAINS[name]
    text, q = chain_urdf(types), coordinates(types)
    exact = chain_mass_matrix(text, q)
    assert np.abs(of_file(tmp_path, text, q) - exact).max() < 5e-15 * np.abs(exact).max()


def test_the_last_digits_of_an_arm():
    text = URDF.read_text()
    for q in np.random.default_rng(4).uniform(-3, 3, (3, 7)):
        exact = chain_mass_matrix(text, q)
        error = np.abs(value(load_chain(URDF), MASS, q=q) - exact)
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        assert (error / scale).max() < 2e-14


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("place", ["30 0 0", "3e5 -4e5 1", "0 0 1e9"])
def test_the_base_may_stand_anywhere(name, place, tmp_path):
    """To the last bit, also turned: the first joint's placement enters no statement."""
    types = CHAINS[name]
    text, q = chain_urdf(types), coordinates(types)
    here = of_file(tmp_path, text, q)
    assert np.array_equal(of_file(tmp_path, based(text, place, "0.3 -1 2"), q), here)


@pytest.mark.parametrize("name", ["turning", "sliding", "mimics"])
@pytest.mark.parametrize("size", [1e-5, 1e-3])
def test_robots_as_light_and_small_as_one_likes(name, size, tmp_path):
    """Shrink all lengths and masses down to a bead of 1e-6 kg at 1e-5 m: no check is fooled."""

    def scaled(element: ET.Element, attribute: str, factor: float) -> None:
        old = element.get(attribute, "").split()
        element.set(attribute, " ".join(repr(float(word) * factor) for word in old))

    types = CHAINS[name]
    robot, q = ET.fromstring(chain_urdf(types)), coordinates(types)
    for element in robot.iter("origin"):
        scaled(element, "xyz", size)
    mass = 1e-6 / 1.5
    for element in robot.iter("mass"):
        scaled(element, "value", mass)
    for element in robot.iter("inertia"):
        for key in element.attrib:
            scaled(element, key, mass * size**2)
    q[[kind == "p" for kind in types if kind != "m"]] *= size
    text = ET.tostring(robot, encoding="unicode")
    exact = chain_mass_matrix(text, q)
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert (np.abs(of_file(tmp_path, text, q) - exact) / scale).max() < 1e-13


def test_which_mass_matrices_have_loops(tmp_path):
    file = tmp_path / "robot.urdf"
    for name, types in CHAINS.items():
        file.write_text(chain_urdf(types))
        loops = any(isinstance(step, Map) for step in MASS.steps(load_chain(file)))
        assert loops == (name != "turning")


FORCES = ("bias_forces", "gravity_gradient", "gravity_joint_stiffness")


def compare_with_pinocchio(chain, oracle, seed=5):
    """Fail unless all forces agree with the oracle in five random states, with gravity and without."""
    kernels = {kernel.qualified_name: kernel for kernel in chain_kernels(chain)}
    random = np.random.default_rng(seed)
    for _ in range(5):
        q, velocity = random.uniform(-2, 2, (2, chain.dof))
        gravity = random.normal(size=3) * 6
        for name, expected in oracle.forces(q, velocity, gravity).items():
            assert_close(value(chain, kernels[name], q=q, velocity=velocity, gravity=gravity), expected)
        still = oracle.forces(q, velocity, np.zeros(3))["bias_forces"]
        assert_close(value(chain, kernels["bias_forces"], q=q, velocity=velocity, gravity=np.zeros(3)), still)


@pytest.mark.parametrize("name", CHAINS)
def test_bias_forces_and_gravity_of_chains_by_pinocchio(name, tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(chain_urdf(CHAINS[name]))
    compare_with_pinocchio(load_chain(file), PinocchioChain(file.read_text(), f"l{len(CHAINS[name])}"))


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7", "med14", "med7"])
def test_bias_forces_and_gravity_of_the_arms_by_pinocchio(robot):
    file = URDF.with_name(f"{robot}.urdf")
    compare_with_pinocchio(load_chain(file), PinocchioChain(file.read_text(), "link_ee"))


def of_tree(tmp_path, **options):
    file = tmp_path / "tree.urdf"
    file.write_text(tree_urdf(3))
    chain = load_chain(file, tip=["left", "right"], **options)
    return chain, StiffnessModel(chain, kernels=("mass_matrix", "bias_forces"))


@pytest.mark.slow
def test_bias_forces_are_the_change_of_the_mass_matrix(tmp_path):
    """C(q, dq) dq from differences of M alone: dM/dt dq - d(dq^T M dq / 2)/dq; a tree, also with a locked joint."""
    for options in ({}, {"lock": {"trunk_j1": 0.7}}):
        chain, model = of_tree(tmp_path, **options)
        random = np.random.default_rng(2)
        q, velocity = random.uniform(-2, 2, (2, chain.dof))

        def slope(direction, model=model, q=q, step=1e-4):
            ahead, back = (np.asarray(model.mass_matrix(q + k * step * direction)) for k in (1, -1))
            far, behind = (np.asarray(model.mass_matrix(q + k * step * direction)) for k in (2, -2))
            return (8 * (ahead - back) - (far - behind)) / (12 * step)

        expected = slope(velocity) @ velocity
        expected -= [velocity @ slope(axis) @ velocity / 2 for axis in np.eye(chain.dof)]
        bias = np.asarray(model.bias_forces(q, velocity, np.zeros(3))).ravel()
        assert np.abs(bias - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_tool_weighs_on_the_joints():
    """Energy by hand: the arm without the tool, and the tool's mass at its place."""
    tool = Tool(mass=2.5, com=(0.1, -0.05, 0.2))
    names = "forward_kinematics", "gravity.energy"
    bare, loaded = (StiffnessModel(load_chain(URDF, **given), kernels=names) for given in ({}, {"tool": tool}))
    gravity = np.array([0.5, 1.0, -9.81])
    for q in np.random.default_rng(6).uniform(-2, 2, (3, 7)):
        pose = np.asarray(bare.forward_kinematics(q))
        weight = -tool.mass * gravity @ (pose[:3, :3] @ tool.com + pose[:3, 3])
        assert_close(loaded.gravity.energy(q, gravity), np.asarray(bare.gravity.energy(q, gravity)) + weight)


def test_no_masses_no_gravity():
    assert not hasattr(StiffnessModel(load_chain(URDF, masses=False)), "gravity")
