# SPDX-License-Identifier: MIT
"""Closed loops: functions of the motors against 60 digits, closed forms, a mimic joint, MuJoCo and their own energy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.families.derivatives.check import check_derivatives
from stiffgen.families.loops import closure
from stiffgen.families.loops.oracles import check_loops
from support.exact_linkage import STEP, ExactLinkage, linkage_errors, random_linkage

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
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.wide) for seed in (2, 3))])
def test_random_linkages_against_60_digits(seed, tmp_path):
    errors = linkage_errors(seed, tmp_path / "linkage.urdf")
    assert max(errors.values()) <= BOUND, errors


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.wide)])
def test_verify_projects_linkages_with_turned_joints(seed, tmp_path):
    """Right functions pass; one that lacks the closure's term does not."""
    linkage = random_linkage(seed)
    file = tmp_path / "linkage.urdf"
    file.write_text(linkage.urdf)
    chain = load_chain(file, **linkage.options)
    kernels = {each.qualified_name: function_of_stacks(chain, each) for each in chain_kernels(chain)}

    def failed() -> set[str]:
        return {
            each.kernel
            for each in check_loops(kernels, chain, 6, 0, KernelOptions(), chain_kernels(chain))
            if not each.passed
        }

    assert failed() == set()
    jacobian, of_tree = kernels["motors_jacobian"], kernels["hybrid_joint_stiffness"]

    def without_the_term(q, wrench, task_stiffness):
        G = jacobian(q)
        return np.swapaxes(G, 1, 2) @ of_tree(q, wrench, task_stiffness) @ G

    kernels["motors_joint_stiffness"] = without_the_term
    assert failed() == {"motors_joint_stiffness"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.wide)])
def test_gradient_of_close(seed, tmp_path):
    """Compare the gradient of `close` with 60 digits; verify finds an error of 1e-9 even near zero."""
    linkage = random_linkage(seed)
    file = tmp_path / "linkage.urdf"
    file.write_text(linkage.urdf)
    chain, options = load_chain(file, masses=False, **linkage.options), KernelOptions(derivatives=True)
    table = tuple(k for k in chain_kernels(chain, options) if k.qualified_name in ("close", "close_vjp"))
    right = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    pool = argument_samples(chain, 24, seed, options)
    motors, start, cotangent = (pool[argument] for argument in table[1].arguments)
    q = right["close"](motors, start)
    closed = int(np.flatnonzero(np.isfinite(q).all(axis=1))[0])
    exact = ExactLinkage(linkage, [c.name for c in chain.coordinates], chain.actuated, q[closed])
    at = [exact.q[k] for k in chain.actuated]
    for k, gradient in enumerate(right["close_vjp"](motors, start, cotangent)[0][closed]):
        up, down = (exact.closed([x + sign * STEP * (i == k) for i, x in enumerate(at)]) for sign in (1, -1))
        terms = [float((a - b) / (2 * STEP)) * c for a, b, c in zip(up, down, cotangent[closed], strict=True)]
        assert abs(gradient - sum(terms)) <= 1e-11 * sum(map(abs, terms))
    assert [check for check in check_derivatives(right, table, chain, pool) if not check.passed] == []

    def wrong(*given):
        gradients = right["close_vjp"](*given)
        return gradients[0] * (1 + 1e-9), gradients[1]

    (check,) = check_derivatives(right | {"close_vjp": wrong}, table, chain, pool)
    assert not check.passed


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
@pytest.mark.parametrize(
    "fault", [pytest.param(fault, marks=() if fault == "G" else pytest.mark.wide) for fault in FAULTS]
)
def test_a_wrong_sign_is_found(fault, tmp_path, monkeypatch):
    """Turn one sign of the closure: the comparison with exact linkages must show it."""
    name, wrong = FAULTS[fault]
    monkeypatch.setattr(closure.Closure, name, wrong)
    for seed in (0, 1):
        assert max(linkage_errors(seed, tmp_path / "linkage.urdf").values()) > 1e-4


def test_a_parallelogram_is_a_mimic_joint(tmp_path):
    """Compare a parallelogram with a tree whose coupler turns by minus the crank's angle."""
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
        # the coupler keeps its direction, so it turns back by the crank's angle
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
    """Return two cranks 0.3 m apart, whose rods meet at the tip."""
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
    """Compare the five-bar linkage with its closed form: energy, torque and stiffness at 40 motor positions."""
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
    return replace(chain, start=tuple(float(x) for x in start))


RODS = ((0.0, 0.05), (2.1, 0.03), (4.2, -0.04))
"""Angle of each arm of the Delta about the vertical, and height of its motor [rad, m]."""


def delta(folder: Path) -> tuple[Chain, ca.SX, ca.SX]:
    """Return a platform on three slides and three arms with rods, and its point as a function of the motors."""
    links, loops, a = [], [], ca.SX.sym("a", 3)
    for parent, name, axis in (("ground", "x", "1 0 0"), ("x", "y", "0 1 0"), ("y", "tip", "0 0 1")):
        start = "0 0 -0.6" if name == "x" else "0 0 0"
        links.append(link(name, parent, start, f'<axis xyz="{axis}"/>', "prismatic"))
    centres = []
    for k, (turn, height) in enumerate(RODS):
        c, s = math.cos(turn), math.sin(turn)
        axis = f'<axis xyz="{-s!r} {c!r} 0"/>'
        links.append(link(f"arm{k}", "ground", f"{0.2 * c!r} {0.2 * s!r} {height}", axis))
        links.append(link(f"cross{k}", f"arm{k}", f"{0.3 * c!r} {0.3 * s!r} 0", axis))
        links.append(link(f"rod{k}", f"cross{k}", "0 0 0", f'<axis xyz="{c!r} {s!r} 0"/>'))
        loops.append(f"rod{k}:0,0,-0.7=tip:{0.08 * c!r},{0.08 * s!r},0")
        reach = 0.3 * ca.cos(a[k])  # of the arm, less the platform's point
        centres.append(ca.vertcat((0.12 + reach) * c, (0.12 + reach) * s, height - 0.3 * ca.sin(a[k])))
    first, *others = centres  # spheres about the moved elbows meet in the platform's origin
    # two planes in which pairs of spheres meet, their line, and its point on the first sphere
    normals = ca.vertcat(*((2 * (each - first)).T for each in others))
    right = ca.vertcat(*(ca.sumsqr(each) - ca.sumsqr(first) for each in others))
    flat, slope = ca.solve(normals[:, :2], right), -ca.solve(normals[:, :2], normals[:, 2])
    away = ca.vertcat(flat, 0) - first
    line = ca.vertcat(slope, 1)
    A, B, C = ca.sumsqr(line), ca.dot(line, away), ca.sumsqr(away) - 0.7**2
    point = first + away + line * (-B - ca.sqrt(B**2 - A * C)) / A
    chain = load_chain(written(folder, *links), tip="tip", loop=loops, actuated=["arm0", "arm1", "arm2"])
    return chain, a, point


def test_delta_against_its_closed_form(tmp_path):
    chain, a, point = delta(tmp_path)
    assert len(chain.coordinates) == 12 and [len(loop.rows) for loop in chain.loops] == [3, 3, 3]
    starts = np.array(chain.start)[list(chain.actuated)] + np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3))
    compare_with_energy(chain, a, point, starts)


def on_circle(radius: float, angle: float) -> list[float]:
    return [radius * math.cos(angle), radius * math.sin(angle), 0.0]


@pytest.mark.slow
def test_stewart_platform_against_its_closed_form(tmp_path):
    """Compare a Stewart platform with its legs' lengths as a formula of the pose, inverted and differentiated."""
    source = np.random.default_rng(3)
    links, loops, parent = [], [], "ground"
    for k, name in enumerate(("x", "y", "z", "roll", "pitch", "tip")):
        axis = " ".join(str(int(i == k % 3)) for i in range(3))
        kind = "prismatic" if k < 3 else "revolute"
        links.append(link(name, parent, "0 0 0.5" if k == 0 else "0 0 0", f'<axis xyz="{axis}"/>', kind))
        parent = name
    x, lengths = ca.SX.sym("x", 6), []
    turn = ca.SX.eye(3)
    for k in range(3):
        unit = ca.DM.eye(3)[:, k]
        along = unit @ unit.T
        turn = turn @ (along + ca.cos(x[3 + k]) * (ca.DM.eye(3) - along) + ca.sin(x[3 + k]) * ca.skew(unit))
    for k in range(6):
        low, high = on_circle(0.5, k * 1.05), on_circle(0.25, k * 1.05 + 0.5 * (-1) ** k)
        links.append(link(f"tilt{k}", "ground", " ".join(map(repr, low)), '<axis xyz="1 0 0"/>'))
        links.append(link(f"swing{k}", f"tilt{k}", "0 0 0", '<axis xyz="0 1 0"/>'))
        links.append(link(f"leg{k}", f"swing{k}", "0 0 0", '<axis xyz="0 0 1"/>', "prismatic"))
        loops.append(f"leg{k}:0,0,0=tip:{','.join(map(repr, high))}")
        lengths.append(ca.norm_2(ca.vertcat(x[:2], x[2] + 0.5) + turn @ ca.DM(high) - ca.DM(low)))
    legs = [f"leg{k}" for k in range(6)]
    chain = load_chain(written(tmp_path, *links), tip="tip", loop=loops, actuated=legs)
    motors = functions(chain, "close", "motors_spring_torque", "motors_spring_joint_stiffness")
    given = spring(1, np.array([0.0, 0.1, 0.5]))
    model = functions(chain, "spring_energy", "spring_torque", "spring_joint_stiffness")
    of_pose = ca.Function("l", [x], [ca.vertcat(*lengths), ca.jacobian(ca.vertcat(*lengths), x)])
    weights = ca.SX.sym("w", 6)
    bending = ca.Function("b", [x, weights], [ca.hessian(ca.dot(weights, ca.vertcat(*lengths)), x)[0]])
    names = [each.name for each in chain.coordinates]
    pose = [names.index(each) for each in ("x", "y", "z", "roll", "pitch", "tip")]
    for _ in range(3):
        place = source.uniform(-0.1, 0.1, 6)
        length, J = map(np.array, of_pose(place))
        start = np.array(chain.start)
        start[pose] = place
        # x(l) inverts the legs' lengths l(x): forces J^-T dU/dx, stiffness J^-T (H - sum f d2l/dx2) J^-1.
        q = motors.close(length, chain.start).ravel()
        assert np.abs(q[pose] - place).max() < 1e-11
        gradient = -model.spring_torque(q, *given).ravel()[pose]
        forces = np.linalg.solve(J.T, gradient)
        inner = model.spring_joint_stiffness(q, *given)[np.ix_(pose, pose)] - np.array(bending(place, forces))
        inverse = np.linalg.inv(J)
        stiffness = inverse.T @ inner @ inverse
        assert np.abs(motors.motors_spring_torque(q, *given).ravel() + forces).max() <= 1e-12 * np.abs(forces).max()
        found = motors.motors_spring_joint_stiffness(q, *given)
        assert np.abs(found - stiffness).max() <= 1e-12 * np.abs(stiffness).max()


def test_torque_does_no_work_on_a_closed_orbit(tmp_path):
    """Move the motors round a circle of 0.3 rad in 256 steps: the spring does no work up to rounding."""
    chain = five_bar(tmp_path)
    motors = functions(chain, "close", "motors_spring_torque", "motors_spring_joint_stiffness")
    q = motors.close([2.0, 1.0], [2.0, -1.2, 1.0, 0.9]).ravel()
    given, work, nodes = spring(1, np.array([0.15, 0.4, 0.0])), 0.0, 256
    for t in np.arange(nodes) * 2 * np.pi / nodes:
        a = np.array([2.0 + 0.3 * np.cos(t), 1.0 + 0.3 * np.sin(t)])
        rate = 0.3 * np.array([-np.sin(t), np.cos(t)])
        q = motors.close(a, q).ravel()
        work += float(motors.motors_spring_torque(q, *given).ravel() @ rate) * 2 * np.pi / nodes
    assert abs(work) <= 1e-10


FOUR_BAR = """<mujoco><compiler angle="radian"/>
<option gravity="1 -9 0.5" tolerance="1e-15" iterations="200"/><worldbody>
<body name="crank"><joint name="crank" axis="0 0 1"/><inertial pos="0.07 0.01 0" mass="1" diaginertia=".01 .01 .012"/>
 <body name="coupler" pos="0.15 0 0"><joint name="coupler" axis="0 0 1"/>
  <inertial pos="0.1 0.05 0" mass="1.5" diaginertia=".01 .01 .02"/></body></body>
<body name="rocker" pos="0.3 0 0"><joint name="rocker" axis="0 0 1"/>
 <inertial pos="0.1 0 0" mass="0.7" diaginertia=".01 .01 .01"/></body></worldbody>
<equality><connect site1="a" site2="b" solref="-1e6 -1e3" solimp="0.99999 0.99999 0.001 0.5 2"/></equality>
<actuator><motor joint="crank"/></actuator></mujoco>"""


def test_motion_against_mujoco_with_a_stiff_constraint(tmp_path):
    """Accelerations under gravity, and from their change with the configuration the stiffness of gravity."""
    mujoco = pytest.importorskip("mujoco")
    text = FOUR_BAR.replace("</body></body>", '<site name="a" pos="0.35 0 0"/></body></body>', 1)
    text = text.replace("</body></worldbody>", '<site name="b" pos="0.25 0 0"/></body></worldbody>')
    file = tmp_path / "bars.xml"
    file.write_text(text)
    chain = load_chain(file, tip="coupler", close_loops=True)
    names = ("mass_matrix", "bias_forces", "jacobian", "gravity_joint_stiffness", "gravity_gradient")
    motors, gravity = functions(chain, "close", *(f"motors_{name}" for name in names)), np.array([1, -9, 0.5])
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    order = [model.joint(each.name).qposadr[0] for each in chain.coordinates]

    def acceleration(a: float, rate: float) -> float:
        q = motors.close(a, chain.start).ravel()
        data.qpos[order], data.qvel[order] = q, (motors.motors_jacobian(q) @ [rate]).ravel()
        mujoco.mj_forward(model, data)
        return float(data.qacc[order[chain.actuated[0]]])

    for a, rate in ((0.5, 0.0), (0.9, 1.5), (1.3, -2.0)):  # crank [rad], [rad/s]
        q = motors.close(a, chain.start).ravel()
        mass = motors.motors_mass_matrix(q).item()
        expected = -motors.motors_bias_forces(q, [rate], gravity).item() / mass
        assert abs(acceleration(a, rate) - expected) <= 1e-4 * abs(expected)
        h = 1e-3
        # torque of gravity at rest on either side; its slope is minus the stiffness
        forces = [motors.motors_mass_matrix(motors.close(a + d, q)).item() * acceleration(a + d, 0.0) for d in (h, -h)]
        stiffness = motors.motors_gravity_joint_stiffness(q, gravity).item()
        assert abs((forces[1] - forces[0]) / (2 * h) - stiffness) <= 1e-4 * abs(stiffness)
