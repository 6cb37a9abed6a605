"""The mass matrix: exact to the last digits wherever the base stands and however small the robot is.

The oracle evaluates M = sum over links of J_k^T I_k J_k with 50 digits, from the numbers in the file: no composites,
no link axes, no Steiner terms.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import mpmath
import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.symbolic.kernels import KERNELS
from stiffgen.symbolic.program import Map
from stiffgen.symbolic.programs import MAX_UNROLLED_MASS_JOINTS
from support.chain_checks import value
from support.chains import chain_urdf
from support.project import URDF

mp = mpmath.mp.clone()
mp.dps = 50
MASS = next(kernel for kernel in KERNELS if kernel.name == "mass_matrix")
CHAINS = {  # name: types of its joints
    "turning": "rrrrr",
    "sliding": "rprrp",
    "slides first": "prrp",
    "mimics": "rrmr",
    "too long to unroll": "r" * (MAX_UNROLLED_MASS_JOINTS + 1),
}


def numbers(text: str | None, default: str) -> list[mpmath.mpf]:
    return [mp.mpf(word) for word in (text or default).split()]


def cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turn(axis, angle) -> mpmath.matrix:
    K = mp.matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return mp.eye(3) + mp.sin(angle) * K + (1 - mp.cos(angle)) * K * K


def origin(element: ET.Element) -> tuple[mpmath.matrix, mpmath.matrix]:
    found = element.find("origin")
    given = {} if found is None else found.attrib
    roll, pitch, yaw = numbers(given.get("rpy"), "0 0 0")
    rotation = turn((0, 0, 1), yaw) * turn((0, 1, 0), pitch) * turn((1, 0, 0), roll)
    return rotation, mp.matrix(numbers(given.get("xyz"), "0 0 0"))


def exact_mass_matrix(text: str, q: np.ndarray) -> np.ndarray:
    """Of a serial chain whose joints stand in order; a mimic joint follows the first one."""
    robot = ET.fromstring(text)
    links = {link.get("name"): link for link in robot.findall("link")}
    rotation, place, columns, coordinate = mp.eye(3), mp.matrix([0, 0, 0]), [], 0
    mass_matrix = mp.zeros(len(q))
    for joint in robot.findall("joint"):
        own_rotation, own_place = origin(joint)
        place, rotation = place + rotation * own_place, rotation * own_rotation
        if joint.get("type") != "fixed":
            mimic, at, multiplier, offset = joint.find("mimic"), coordinate, mp.mpf(1), mp.mpf(0)
            if mimic is None:
                coordinate += 1
            else:
                at, multiplier, offset = 0, mp.mpf(mimic.get("multiplier")), mp.mpf(mimic.get("offset"))
            position = multiplier * mp.mpf(float(q[at])) + offset
            axis = mp.matrix(numbers(joint.find("axis").get("xyz"), ""))
            axis /= mp.norm(axis)
            if joint.get("type") == "prismatic":
                place = place + rotation * axis * position
            else:
                rotation = rotation * turn(axis, position)
            columns.append((at, multiplier * (rotation * axis), joint.get("type") == "prismatic", place))
        inertial = links[joint.find("child").get("link")].find("inertial")
        if inertial is None:
            continue
        mass, i = mp.mpf(inertial.find("mass").get("value")), inertial.find("inertia").attrib
        xx, xy, xz, yy, yz, zz = (mp.mpf(i[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        com_rotation, com = origin(inertial)
        axes = rotation * com_rotation
        tensor = axes * mp.matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) * axes.T
        center = place + rotation * com
        jacobians = [(a, z if slides else cross(z, center - p), 0 * z if slides else z) for a, z, slides, p in columns]
        for a, v, w in jacobians:
            for b, other_v, other_w in jacobians:
                mass_matrix[a, b] += mass * (v.T * other_v)[0] + (w.T * tensor * other_w)[0]
    return np.array([[float(mass_matrix[r, c]) for c in range(len(q))] for r in range(len(q))])


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
