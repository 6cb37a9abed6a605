# SPDX-License-Identifier: MIT
"""Closed loops: functions of the motors against 60 digits, closed forms, a mimic joint, MuJoCo and their own energy."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.robot.chain import Chain
from stiffgen.symbolic import closure
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.model import casadi_function
from support.exact_linkage import linkage_errors

BOUND = 1e-11
UP = '<axis xyz="0 0 1"/>'


def functions(chain: Chain, *names: str) -> SimpleNamespace:
    """Return some kernels as functions of NumPy arrays, by qualified name."""
    found = {k.qualified_name: casadi_function(chain, k) for k in chain_kernels(chain) if k.qualified_name in names}

    def call(function: ca.Function):
        return lambda *given: np.array(function(*given))

    return SimpleNamespace(**{name: call(function) for name, function in found.items()})


def link(name: str, parent: str, xyz: str, axis: str = UP, kind: str = "revolute", more: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.1 0.02 0.01"/><mass value="0.7"/>'
        '<inertia ixx="0.02" iyy="0.025" izz="0.03" ixy="0.001" ixz="0.002" iyz="0.001"/></inertial></link>'
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}"/>{axis}'
        f'<limit lower="-3" upper="3" effort="9" velocity="1"/>{more}</joint>'
    )


def written(folder: Path, *links: str) -> Path:
    file = folder / "linkage.urdf"
    file.write_text(f'<robot name="linkage"><link name="ground"/>{"".join(links)}</robot>')
    return file


def spring(seed: int, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return equilibrium and stiffnesses of a spring at a point."""
    source = np.random.default_rng(seed)
    roots = source.normal(size=(2, 3, 3))
    rest = np.eye(4)
    rest[:3, 3] = near + source.normal(size=3) * 0.1
    return rest, 300 * (roots[0] @ roots[0].T + np.eye(3)), 20 * (roots[1] @ roots[1].T + np.eye(3))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_random_linkages_against_60_digits(seed, tmp_path):
    errors = linkage_errors(seed, tmp_path / "linkage.urdf")
    assert max(errors.values()) <= BOUND, errors


def wrong_motion(self):
    motors = list(self.motors)
    G = right_motion(self)
    for k in range(self.n):
        if k not in motors:
            G[k, :] = -G[k, :]
    return G


right_motion = closure.Closure.motion
FAULTS = {
    "G": ("motion", wrong_motion),
    "lambda": ("multipliers", lambda self, g, right=closure.Closure.multipliers: -right(self, g)),
    "constraint term": ("stiffness", lambda self, m, right=closure.Closure.stiffness: -right(self, m)),
    "no constraint term": ("stiffness", lambda self, m: ca.SX(self.n, self.n)),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_sign_is_found(fault, tmp_path, monkeypatch):
    name, wrong = FAULTS[fault]
    monkeypatch.setattr(closure.Closure, name, wrong)
    for seed in (0, 1, 2):
        assert max(linkage_errors(seed, tmp_path / "linkage.urdf").values()) > 1e-4


def test_a_parallelogram_is_a_mimic_joint(tmp_path):
    """The coupler of a parallelogram turns by minus the crank's angle."""
    crank = link("crank", "ground", "0 0 0")
    tool = link("tool", "coupler", "0.3 0.1 0.2", '<axis xyz="0.6 0 0.8"/>')
    file = written(tmp_path, crank, link("coupler", "crank", "0.2 0.1 0"), link("rocker", "ground", "0.4 0 0"), tool)
    loop = ["coupler:0.4,0,0=rocker:0.2,0.1,0"]
    closed = load_chain(file, tip="tool", loop=loop, actuated=["crank"])
    assert [closed.coordinates[k].name for k in closed.actuated] == ["crank", "tool"]
    mimic = '<mimic joint="crank" multiplier="{}"/>'
    follower = link("coupler", "crank", "0.2 0.1 0", more=mimic.format(-1))
    rocker = link("rocker", "ground", "0.4 0 0", more=mimic.format(1))
    tree = load_chain(written(tmp_path, crank, follower, rocker, tool), tip="tool")
    names = ("spring_torque", "spring_joint_stiffness", "mass_matrix", "bias_forces")
    motors = functions(closed, "close", *(f"motors_{name}" for name in names))
    joints = functions(tree, *names)
    source = np.random.default_rng(1)
    for _ in range(20):
        a, velocity, gravity = source.uniform(0.3, 1.3, 2), source.normal(size=2), source.normal(size=3)
        order = {"crank": a[0], "coupler": -a[0], "tool": a[1], "rocker": a[0]}
        q = np.array([order[each.name] for each in closed.coordinates])
        assert np.abs(motors.close(a, q + 0.1).ravel() - q).max() <= 2e-15
        given = spring(3, np.array([0.4, 0.2, 0.1]))
        pairs = (
            (motors.motors_spring_torque(q, *given), joints.spring_torque(a, *given)),
            (motors.motors_spring_joint_stiffness(q, *given), joints.spring_joint_stiffness(a, *given)),
            (motors.motors_mass_matrix(q), joints.mass_matrix(a)),
            (motors.motors_bias_forces(q, velocity, gravity), joints.bias_forces(a, velocity, gravity)),
        )
        for value, reference in pairs:
            assert np.abs(value - reference).max() <= 1e-14 * np.abs(reference).max()


def five_bar(folder: Path) -> Chain:
    """Two cranks at a distance of 0.3 m with rods that meet in the point of the tip."""
    links = [link("left", "ground", "0 0 0"), link("left_rod", "left", "0.2 0 0")]
    links += [link("right", "ground", "0.3 0 0"), link("right_rod", "right", "0.25 0 0")]
    links += ['<link name="tip"/><joint name="end" type="fixed"><parent link="left_rod"/><child link="tip"/>'
              '<origin xyz="0.35 0 0"/></joint>']  # fmt: skip
    options = {"tip": "tip", "loop": ["left_rod:0.35,0,0=right_rod:0.3,0,0"], "actuated": ["left", "right"]}
    return load_chain(written(folder, *links), **options)


def five_bar_point() -> tuple[ca.SX, ca.SX]:
    """Return the motors' angles and the point: the upper intersection of two circles about the rods' joints."""
    a = ca.SX.sym("a", 2)
    left = 0.2 * ca.vertcat(ca.cos(a[0]), ca.sin(a[0]))
    right = ca.vertcat(0.3, 0) + 0.25 * ca.vertcat(ca.cos(a[1]), ca.sin(a[1]))
    across = right - left
    squared = ca.sumsqr(across)
    along = (0.35**2 - 0.3**2 + squared) / (2 * squared)
    height = ca.sqrt(0.35**2 / squared - along**2)
    point = left + along * across + height * ca.vertcat(-across[1], across[0])
    return a, ca.vertcat(point, 0)


def compare_with_energy(chain: Chain, a: ca.SX, point: ca.SX, starts: np.ndarray, bound: float = 1e-12) -> None:
    """Compare torque and stiffness of a translational spring with the derivatives of U(point(a))."""
    motors = functions(chain, "close", "motors_spring_torque", "motors_spring_joint_stiffness", "motors_condition")
    rest, Kt, Ko = ca.SX.sym("p", 3), ca.SX.sym("K", 3, 3), np.zeros((3, 3))
    hessian, gradient = ca.hessian((point - rest).T @ Kt @ (point - rest) / 2, a)
    exact = ca.Function("exact", [a, rest, Kt], [gradient, hessian, point])
    compared = 0
    for k, motor in enumerate(starts):
        q = motors.close(motor, chain.start).ravel()
        if not np.isfinite(q).all() or motors.motors_condition(q) > 50:
            continue
        place, stiffness, _ = spring(k, np.array(exact(motor, np.zeros(3), np.eye(3))[2]).ravel())
        gradient_of, hessian_of, _ = map(np.array, exact(motor, place[:3, 3], stiffness))
        torque = motors.motors_spring_torque(q, place, stiffness, Ko)
        tangent = motors.motors_spring_joint_stiffness(q, place, stiffness, Ko)
        assert np.abs(torque + gradient_of).max() <= bound * np.abs(gradient_of).max()
        assert np.abs(tangent - hessian_of).max() <= bound * np.abs(hessian_of).max()
        compared += 1
    assert compared >= len(starts) // 2


def test_five_bar_against_its_closed_form(tmp_path):
    chain = five_bar(tmp_path)
    a, point = five_bar_point()
    upper = functions(chain, "close", "forward_kinematics")
    source = np.random.default_rng(0)
    starts = np.array([2.0, 1.0]) + source.uniform(-0.4, 0.4, (40, 2))
    closed = ca.Function("p", [a], [point])
    start = upper.close(starts[0], [2.0, -1.2, 1.0, 0.9]).ravel()
    assert np.abs(upper.forward_kinematics(start)[:3, 3] - np.array(closed(starts[0])).ravel()).max() < 1e-12
    compare_with_energy(with_start(chain, start), a, point, starts)


def with_start(chain: Chain, start: np.ndarray) -> Chain:
    from dataclasses import replace

    return replace(chain, start=tuple(float(x) for x in start))
