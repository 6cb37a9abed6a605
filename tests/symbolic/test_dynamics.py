"""The mass matrix: exact to the last digits wherever the base stands and however small the robot is.

Values by support/exact_chain.py, which knows no composites, no link axes and no Steiner terms.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.symbolic.kernels import KERNELS
from stiffgen.symbolic.program import Map
from stiffgen.symbolic.programs import MAX_UNROLLED_MASS_JOINTS
from support.chain_checks import value
from support.chains import chain_urdf
from support.exact_chain import exact_mass_matrix
from support.project import URDF

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
    exact = exact_mass_matrix(text, q)
    assert np.abs(of_file(tmp_path, text, q) - exact).max() < 5e-15 * np.abs(exact).max()


def test_the_last_digits_of_an_arm():
    text = URDF.read_text()
    for q in np.random.default_rng(4).uniform(-3, 3, (3, 7)):
        exact = exact_mass_matrix(text, q)
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
    """All lengths times ``size``, all masses times 1e-6 / 1.5: a bead of 1e-6 kg at 1e-5 m moves a mass."""

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
    exact = exact_mass_matrix(text, q)
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert (np.abs(of_file(tmp_path, text, q) - exact) / scale).max() < 1e-13


def test_which_mass_matrices_have_loops(tmp_path):
    file = tmp_path / "robot.urdf"
    for name, types in CHAINS.items():
        file.write_text(chain_urdf(types))
        loops = any(isinstance(step, Map) for step in MASS.steps(load_chain(file)))
        assert loops == (name != "turning")
