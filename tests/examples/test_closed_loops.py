# SPDX-License-Identifier: MIT
"""The examples of closed loops: closed forms, geometry with 40 digits, the page's numbers, the committed figures."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from mpmath import mp, mpf

import stiffgen
from examples import closed_loops as example
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.verify.kernels.references import References
from stiffgen.families.manipulability.oracles import manipulability
from support.project import ROOT, assert_close

LEG = ROOT / "tests" / "data" / "cassie_leg.xml"
"""From the package example-robot-data."""
WEIGHT = 31 * 9.81
"""Weight of Cassie [N]."""
FIVE_BAR = [
    ("left", "ground", "0 0 0", "0 0 1"),
    ("left_rod", "left", "0.2 0 0", "0 0 1"),
    ("tip", "left_rod", "0.35 0 0", ""),
    ("right", "ground", "0.3 0 0", "0 0 1"),
    ("right_rod", "right", "0.2 0 0", "0 0 1"),
]
ARMS = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
"""Angles of the Delta's arms about the vertical [rad]; motors at 0.2 m, arms of 0.3 m, rods of 0.7 m, joints at 0.08 m
on the platform."""


class Loaded(NamedTuple):
    """A robot, the wrench on its tip [N, N m], the task stiffness there [N/m, N m/rad], and where the motors start."""

    robot: stiffgen.StiffnessModel
    wrench: np.ndarray
    task: np.ndarray
    start: np.ndarray


def leg() -> Loaded:
    """Return the leg, whose foot bears the weight; motors: knee, heel spring and crank."""
    motors = ["knee", "heel_spring", "crank"]
    chain = stiffgen.load_chain(LEG, tip="sole", masses=False, close_loops=True, actuated=motors)
    robot = stiffgen.StiffnessModel(chain)
    return Loaded(robot, np.array([0, 0, WEIGHT, 0, 0, 0]), np.zeros((6, 6)), np.array(chain.start))


def five_bar() -> Loaded:
    """Return a five-bar in a vertical plane, y upwards: a payload of 3 kg and a spring of 400 N/m.

    The start is the branch with the tip above the motors.
    """
    loop = ["left_rod:0.35,0,0=right_rod:0.35,0,0"]
    robot = example.model(FIVE_BAR, "tip", loop, ["left", "right"])
    left, right = five_bar_motors(np.array([0.15]), 0.4)[0]
    rods = np.angle([0.15 + 0.4j - 0.2 * np.exp(1j * left), -0.15 + 0.4j - 0.2 * np.exp(1j * right)]) - [left, right]
    start = np.array([left, rods[0], right, rods[1]])
    return Loaded(robot, np.array([0, -3 * 9.81, 0, 0, 0, 0]), np.diag([400.0, 400, 400, 0, 0, 0]), start)


def delta() -> Loaded:
    """Return a Delta: its platform moves on three slides without a motor, each rod has two hinges at its arm."""
    links = [("x", "ground", "0 0 -0.6", "1 0 0"), ("y", "x", "0 0 0", "0 1 0"), ("tip", "y", "0 0 0", "0 0 1")]
    loops = []
    for k, angle in enumerate(ARMS):
        c, s = math.cos(angle), math.sin(angle)
        across = f"{-s!r} {c!r} 0"
        links.append((f"arm{k}", "ground", f"{0.2 * c!r} {0.2 * s!r} 0", across))
        links.append((f"swing{k}", f"arm{k}", f"{0.3 * c!r} {0.3 * s!r} 0", across))
        links.append((f"rod{k}", f"swing{k}", "0 0 0", f"{c!r} {s!r} 0"))
        loops.append(f"rod{k}:0,0,-0.7=tip:{0.08 * c!r},{0.08 * s!r},0")
    robot = example.model(links, "tip", loops, ["arm0", "arm1", "arm2"], sliding=("x", "y", "tip"))
    spring, start = np.diag([500.0, 500, 500, 0, 0, 0]), np.array(robot.chain.start)
    return Loaded(robot, np.array([0, 0, -4 * 9.81, 0, 0, 0]), spring, start)


def five_bar_motors(x: np.ndarray, y: float) -> np.ndarray:
    """Return the motors' angles at tips (x, y), elbows outwards."""
    angles = []
    for base, side in ((0.0, 1), (0.3, -1)):
        away = x - base + 1j * y
        inner = np.arccos((0.2**2 + np.abs(away) ** 2 - 0.35**2) / (0.4 * np.abs(away)))
        angles.append(np.angle(away) + side * inner)
    return np.stack(angles, axis=1)


@pytest.mark.slow
def test_stiffness_is_the_change_of_the_torque_as_the_motors_turn() -> None:
    """Compare the stiffness of a constant wrench with differences of -G^T J^T F over the motors."""
    robot, start = example.ankle(), np.array([-0.5, -0.4])
    q = np.array(robot.close(start, robot.chain.start)).ravel()
    stiffness = np.array(robot.motors.joint_stiffness(q, example.LOAD, np.zeros((6, 6))))
    for k in range(2):
        step = 1e-6 * np.eye(2)[k]
        ends = [robot.motors.torque(robot.close(start + s * step, q), example.LOAD) for s in (1, -1)]
        change = np.array(ends[0] - ends[1]).ravel() / 2e-6
        np.testing.assert_allclose(-change, stiffness[k], rtol=1e-7, atol=1e-7)


@pytest.mark.slow
def test_numbers_of_the_page() -> None:
    angles, whole, without = example.ankle_results()
    assert angles[0] == -0.6
    assert (round(whole[0], 2), round(without[0], 2)) == (10.35, 15.49)
    assert abs(whole[12] / without[12] - 1) < 1e-3
    assert round(example.four_bar_results()[1][0], 1) == -4.1


def compare_with_energy(loaded: Loaded, starts: np.ndarray, point: ca.SX, a: ca.SX) -> None:
    """Compare with the Hessian of U = F . p + (p - p0) . K (p - p0) / 2 at p = p0, where p(a) is a closed form."""
    F, K, rest = loaded.wrench[:3], loaded.task[:3, :3], ca.SX.sym("p0", 3)
    energy = ca.dot(F, point) + ca.bilin(K, point - rest, point - rest) / 2
    exact = ca.Function("exact", [a, rest], [ca.hessian(energy, a)[0], point])
    q, robot = loaded.start, loaded.robot
    for motors in starts:
        q = np.array(robot.close(motors, q)).ravel()
        place = np.array(robot.forward_kinematics(q))[:3, 3]
        hessian, reached = map(np.array, exact(motors, place))
        np.testing.assert_allclose(place, reached.ravel(), atol=1e-12)
        stiffness = np.array(robot.motors.joint_stiffness(q, loaded.wrench, loaded.task))
        np.testing.assert_allclose(stiffness, hessian, rtol=0, atol=1e-11 * np.abs(hessian).max())


def test_five_bar_against_the_intersection_of_two_circles() -> None:
    """Compare the five-bar linkage (links of 0.2 and 0.35 m) with plane geometry: energy, torque and stiffness."""
    a = ca.SX.sym("a", 2)
    left = 0.2 * ca.vertcat(ca.cos(a[0]), ca.sin(a[0]))
    # from elbow to elbow; the motors are 0.3 m apart
    across = ca.vertcat(0.3, 0) + 0.2 * ca.vertcat(ca.cos(a[1]), ca.sin(a[1])) - left
    height = ca.sqrt(0.35**2 / ca.sumsqr(across) - 0.25)  # of the tip above the middle, in lengths of across
    point = ca.vertcat(left + across / 2 + height * ca.vertcat(-across[1], across[0]), 0)
    x = np.linspace(-0.05, 0.35, 9)
    motors = five_bar_motors(x, 0.4)
    compare_with_energy(five_bar(), motors, point, a)
    on_line = np.array([ca.Function("p", [a], [point])(each) for each in motors])[:, :2, 0]
    np.testing.assert_allclose(on_line, np.stack([x, np.full_like(x, 0.4)], axis=1), atol=1e-12)


@pytest.mark.slow
def test_delta_against_the_intersection_of_three_spheres() -> None:
    """Compare the delta robot (arms 0.3 m, rods 0.7 m) with the point that is 0.7 m from its three elbows."""
    a = ca.SX.sym("a", 3)
    reach = 0.12 + 0.3 * ca.cos(a)
    centres = [
        ca.vertcat(reach[k] * np.cos(turn), reach[k] * np.sin(turn), -0.3 * ca.sin(a[k])) for k, turn in enumerate(ARMS)
    ]
    normals = ca.vertcat(*((2 * (centre - centres[0])).T for centre in centres[1:]))
    right = ca.vertcat(*(ca.sumsqr(centre) - ca.sumsqr(centres[0]) for centre in centres[1:]))
    flat, slope = ca.solve(normals[:, :2], right), -ca.solve(normals[:, :2], normals[:, 2])
    line, away = ca.vertcat(slope, 1), ca.vertcat(flat, 0) - centres[0]
    A, B, C = ca.sumsqr(line), ca.dot(line, away), ca.sumsqr(away) - 0.7**2
    point = centres[0] + away - line * (B + ca.sqrt(B**2 - A * C)) / A
    equal = np.stack(3 * [np.linspace(-0.9, 1.0, 5)], axis=1)
    compare_with_energy(delta(), np.concatenate([equal, equal * [0.5, 1.0, 0.8]]), point, a)


def leg_geometry() -> Callable[..., list[mp.matrix]]:
    """Return a function of joint angles: sole and the ends of both rods, with 40 digits, from the MJCF file alone."""
    world = ElementTree.parse(LEG).getroot().find("worldbody")

    def vector(element: ElementTree.Element, name: str, default: str) -> mp.matrix:
        return mp.matrix([mpf(x) for x in element.get(name, default).split()])

    def turned(axis: mp.matrix, angle: mpf) -> mp.matrix:
        x, y, z = axis / mp.norm(axis)
        cross = mp.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return mp.eye(3) + mp.sin(angle) * cross + (1 - mp.cos(angle)) * cross * cross

    def point(at: dict[str, mpf], body: str, place: mp.matrix) -> mp.matrix:
        path = [each for each in world.iter("body") if any(inner.get("name") == body for inner in each.iter("body"))]
        for each in reversed(path):
            for joint in reversed(each.findall("joint")):
                place = turned(vector(joint, "axis", "0 -1 0"), at.get(joint.get("name"), mpf(0))) * place
            place = vector(each, "pos", "0 0 0") + place
        return place

    sites = {site.get("name"): vector(site, "pos", "") for site in world.iter("site")}
    anchors = [vector(each, "anchor", "") for each in ElementTree.parse(LEG).iter("connect")]
    zero: dict[str, mpf] = {}
    rods = [("achilles_rod", "heel", anchors[0]), ("plantar_rod", "foot", anchors[1])]
    fixed = []  # the far end of each rod in the body that it holds
    for rod, body, anchor in rods:
        away = point(zero, rod, anchor) - point(zero, body, mp.zeros(3, 1))
        fixed.append((rod, body, away, mp.norm(anchor)))

    def gaps(**at: mpf) -> list[mpf]:
        """Return the sole, and by how much each rod is too long."""
        ends = [
            mp.norm(point(at, body, away) - point(at, rod, mp.zeros(3, 1))) - length
            for rod, body, away, length in fixed
        ]
        return [point(at, "foot", sites["sole"]), *ends]

    return gaps


@pytest.mark.wide(instead="test_delta_against_the_intersection_of_three_spheres")
def test_leg_against_rods_of_constant_length() -> None:
    """Tarsus and foot follow from the rods' lengths with 40 digits; U = F . p is differentiated twice."""
    pytest.importorskip("mujoco")
    loaded, step = leg(), mpf(10) ** -10
    robot, names = loaded.robot, [each.name for each in loaded.robot.chain.coordinates]
    motors = [names[k] for k in robot.chain.actuated]
    with mp.workdps(40):
        geometry = leg_geometry()
        for knee in (0.1, -1.0, -2.0):
            start = np.array([{"knee": knee, "heel_spring": 0.1, "crank": -1.34}[name] for name in motors])  # [rad]
            q = np.array(robot.close(start, robot.chain.start)).ravel()
            near = [float(q[names.index(name)]) for name in ("tarsus", "foot")]

            def energy(*moved: mpf, start: np.ndarray = start, near: list[float] = near) -> mpf:
                at = {name: mpf(x) + d for name, x, d in zip(motors, start, moved, strict=True)}
                tarsus = mp.findroot(lambda x: geometry(**at, tarsus=x)[1], near[0])
                foot = mp.findroot(lambda x: geometry(**at, tarsus=tarsus, foot=x)[2], near[1])
                return loaded.wrench[2] * geometry(**at, tarsus=tarsus, foot=foot)[0][2]

            stiffness = np.array(robot.motors.joint_stiffness(q, loaded.wrench, loaded.task))
            for i, j in ((0, 0), (0, 1), (1, 1), (0, 2)):  # second differences of the energy
                total = mpf(0)
                for one, other in product((1, -1), repeat=2):
                    moved = [one * step * (k == i) + other * step * (k == j) for k in range(3)]
                    total += one * other * energy(*moved)
                assert abs(float(total / (4 * step**2)) - stiffness[i, j]) < 1e-9 * np.abs(stiffness).max()


@pytest.mark.slow
def test_each_sine_of_a_stiffness_is_computed_once(tmp_path: Path) -> None:
    """Tip and loops share pitch and roll; the comment in C counts a sine and a cosine of each of 8 joints."""
    text = "".join(
        f'<link name="{name}"/><joint name="{name}" type="{"continuous" if axis else "fixed"}">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}"/><axis xyz="{axis or "0 0 1"}"/></joint>'
        for name, parent, xyz, axis in example.ANKLE
    )
    file = tmp_path / "ankle.urdf"
    file.write_text(f'<robot name="ankle"><link name="shank"/>{text}</robot>')
    folder = stiffgen.generate(
        file, output=tmp_path, tip="sole", masses=False, loop=example.ANKLE_LOOPS, actuated=["left", "right"],
        controller=False, build=False,
    )  # fmt: skip
    code = (folder / "ankle.c").read_text()
    for name in ("torque", "joint_stiffness", "spring_torque", "spring_joint_stiffness"):
        comment = code[: code.index(f"\nvoid ankle_motors_{name}(")].rpartition("/*")[2]
        assert re.findall(r"(\d+) sines and cosines", comment) == ["16"], name


def test_joints_beside_the_way_to_the_tip_do_not_count() -> None:
    """Verify an ankle with rods and cranks. Before, the loops' joints counted as the tip's."""
    kernels = example.ankle()
    references = References(kernels.chain, 3, 5)
    expected = references.of(manipulability)
    assert expected.measure.min() > 0.5
    for k, q in enumerate(references.samples[Q]):
        assert_close(np.array(kernels.manipulability(q)).ravel(), expected.measure[k : k + 1])
        assert_close(np.array(kernels.manipulability_gradient(q)).ravel(), expected.gradient[k])
