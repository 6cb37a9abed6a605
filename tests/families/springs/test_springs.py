# SPDX-License-Identifier: MIT
"""Springs against 60-digit derivatives of their energies, at random poses, near the equilibrium and at the edge.

tests/campaigns/springs_digits.py runs the same over thousands of poses.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import stiffgen
from campaigns.spring_orbits import orders, table
from stiffgen.cli import main
from stiffgen.core.symbolic.choices import KINDS
from stiffgen.core.verify.verify import verify
from support.project import ROOT, URDF
from support.spring_digits import CASES, FEW, ROBOTS, by_casadi, pose_errors, robot_errors, urdf_of

BOUND = 1e-11


@pytest.mark.parametrize(
    ("case", "count"),
    [*((case, 6) for case in CASES), ("small", 10), pytest.param("small", 60, marks=pytest.mark.wide)],
)
def test_wrench_and_hessian_at_poses_of_doubles(case, count):
    """The spring alone, its pose given: right to the last digits of F and K themselves, however small they are.

    Small angles are those among which a series takes the place of the closed form.
    """
    for spring, errors in pose_errors(FEW, case, count, seed=3).items():
        assert max(errors.values()) <= BOUND, (spring, errors)


IN_CI = ("six axes", "random"), *(("slides and mimics", case) for case in CASES)


@pytest.mark.parametrize(
    ("robot", "case"),
    [
        pytest.param(robot, case, marks=() if (robot, case) in IN_CI else pytest.mark.wide)
        for robot in ROBOTS
        for case in CASES
    ],
)
def test_kernels_along_the_kinematics(robot, case, tmp_path):
    """Torque and tangent from q: beyond 1e-11 of the result, what rounding the pose costs (16 roundings)."""
    urdf = urdf_of(robot, tmp_path)
    relative, allowed = robot_errors(urdf, by_casadi(stiffgen.load_chain(urdf)), FEW[:1], case, count=2, seed=5)
    for spring, errors in allowed.items():
        assert max(errors.values()) <= 1, (spring, errors)
        if case != "near":
            assert max(relative[spring].values()) <= BOUND, (spring, relative[spring])


@pytest.mark.slow
def test_no_work_round_closed_orbits():
    """Zero for every spring, far from zero for the laws in common use; and not by grace of the quadrature."""
    work = table(count=3, seed=4)
    springs = {name: largest for name, (_, largest) in work.items() if name.endswith("spring")}
    others = {name: median for name, (median, _) in work.items() if name not in springs}
    assert len(springs) == 5
    assert max(springs.values()) <= 1e-10
    assert len(others) == 5
    assert min(others.values()) > 1e-3
    falling = [max(each.values()) for each in orders((1, 3, 6, 12)).values()]
    assert falling[0] > 1e-3
    assert falling[0] > 10 * falling[1] > 1e3 * falling[2]
    assert falling[3] < 1e-10


@pytest.mark.wide(instead="test_no_work_round_closed_orbits")
def test_the_page_has_todays_work():
    """docs/theory.md against the script: the springs' zeros in size, all else in its two digits."""
    page = (ROOT / "docs" / "theory.md").read_text()
    rows = [
        line.strip("|").split(" | ") for line in page.split("| torque | median")[1].split("\n\n")[0].splitlines()[2:]
    ]
    work = table()
    springs, laws = ({name: work[name] for name in work if name.endswith("spring") == ours} for ours in (True, False))
    (_, *zeros), *others = rows
    assert len(springs) == 5
    assert max(map(float, zeros)) <= 1e-10
    assert max(map(max, springs.values())) <= 1e-10
    for (_, *numbers), (name, found) in zip(others, laws.items(), strict=True):
        assert [float(each) for each in numbers] == [float(f"{each:.1e}") for each in found], name


U = ca.SX.sym("elsewhere")


def scaled(p, R, parameters):
    return parameters.gain * ca.dot(p - parameters.centre, p - parameters.centre) / 2 + ca.trace(R)


scaled.parameters = {"gain": (), "centre": (3,)}


def refusal(function, message):
    with pytest.raises(stiffgen.PotentialError, match=message):
        stiffgen.StiffnessModel(stiffgen.load_chain(URDF), potentials=[function])


def named(function, **parameters):
    function.__name__ = "mine"
    function.parameters = parameters
    return function


def test_a_potential_of_ones_own():
    """Generate a user's potential: wrench in closed form, torque and stiffness by differences (step 1e-5 rad)."""
    model = stiffgen.StiffnessModel(stiffgen.load_chain(URDF), potentials=[scaled])
    q, centre = np.linspace(-1, 1, 7), np.array([0.1, 0.2, 0.3])
    away = np.array(model.forward_kinematics(q))[:3, 3] - centre
    assert np.allclose(np.array(model.scaled.wrench(q, 7.0, centre)).ravel()[:3], 7 * away, rtol=1e-14)
    U, torque, tangent = (np.array(each) for each in model.scaled.linearization(q, 7.0, centre))
    step = 1e-5
    for i in range(7):
        shift = step * np.eye(7)[i]
        energies = [float(model.scaled.energy(q + s, 7.0, centre)) for s in (shift, -shift)]
        torques = [np.array(model.scaled.torque(q + s, 7.0, centre)).ravel() for s in (shift, -shift)]
        assert np.isclose(-torque[i, 0], (energies[0] - energies[1]) / (2 * step), atol=1e-8)
        assert np.allclose(-tangent[i], (torques[0] - torques[1]) / (2 * step), atol=1e-8)
    assert U.item() == float(model.scaled.energy(q, 7.0, centre))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (named(lambda p, R, parameters: p), "must be a scalar, not of shape \\(3, 1\\)"),
        (named(lambda p, R, parameters: ca.floor(p[0])), "is not twice differentiable \\('?floor'?\\)"),
        (named(lambda p, R, parameters: ca.floor(p[0]) ** 2), "is not twice differentiable"),
        (named(lambda p, R, parameters: p[0] * U), "symbols that it was not given \\('?elsewhere'?\\)"),
        (
            named(lambda p, R, parameters: p[0] * parameters.gain),
            "'gain', which it does not declare",
        ),
        (named(lambda p, R: p[0]), "fails on CasADi's SX \\(TypeError"),
        (named(lambda p, R, parameters: "x"), "returns str"),
        (named(lambda p, R, parameters: p[0], größe=(3,)), "a parameter cannot be called 'größe'"),
        (named(lambda p, R, parameters: p[0], _a=(3,)), "a parameter cannot be called '_a'"),
        (named(lambda p, R, parameters: p[0], a__b=(3,)), "a parameter cannot be called 'a__b'"),
        (named(lambda p, R, parameters: p[0], gain=(1, 2, 3)), "the shape of parameter 'gain'"),
        (named(lambda p, R, parameters: p[0], gain="x"), "the shape of parameter 'gain'"),
        (
            named(lambda p, R, parameters: p[0], **{f"gain{k}": () for k in range(28)}),
            "declares 28 parameters, more than",
        ),
    ],
)
def test_potentials_refused(function, message):
    """Define potentials that cannot be generated: refused with the reason."""
    refusal(function, message)


def test_potentials_of_files(tmp_path, capsys):
    """Name files without a usable potential: exit code 2, the reason, and no folder."""
    file = tmp_path / "mine.py"
    for text, where, message in (
        ("x = 1", "well", "has no function 'well'"),
        ("import nothing_of_this_name", "well", "fails when it is run (ModuleNotFoundError"),
        ("def spring(p, R, parameters):\n    return p[0]", "spring", "the name is taken"),
        ("def well(p, R, parameters):\n    return p", "well", "must be a scalar"),
    ):
        file.write_text(text)
        command = ["generate", str(URDF), "--output", str(tmp_path), "--no-build", "--potential", f"{file}:{where}"]
        assert main(command) == 2
        assert message in capsys.readouterr().err
    for wrong in ("mine.py", f"{tmp_path}/absent.py:well"):
        assert main(["generate", str(URDF), "--output", str(tmp_path), "--no-build", "--potential", wrong]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.py"]


@pytest.mark.wide(
    instead="tests/families/springs/test_potentials.py::test_potentials_have_the_values_of_their_energies"
)
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
def test_a_folder_with_everything_verifies(tmp_path):
    """Compiled, with choices, libm and sines in the potential; the manifest says what is in it."""
    file = tmp_path / "mine.py"
    file.write_text(
        "import casadi as ca\n\n\ndef well(p, R, parameters):\n"
        "    away = p - parameters.centre\n"
        "    rise = ca.fmax(0, away[2] - 0.1) ** 3 + ca.sin(away[0]) + ca.exp(-ca.dot(away, away))\n"
        "    return parameters.stiffness * rise + ca.if_else(p[0] < 0, p[0] ** 4, p[0] ** 3)\n\n\n"
        'well.parameters = {"centre": (3,), "stiffness": ()}\n'
    )
    kinds = [word for kind in KINDS[1:] for word in ("--spring", kind)]
    parts = ("translation_axes=tip", "rotation_axes=base", "centre=0.1,-0.2,0.3")
    axes = [word for part in parts for word in ("--placement", part)]
    command = ["generate", str(URDF), "--output", str(tmp_path), "--name", "arm", "--potential", f"{file}:well"]
    assert main([*command, *kinds, *axes]) == 0
    failed = [check for check in verify(tmp_path / "arm", count=5, trust_potentials=True) if not check.passed]
    assert failed == []
    robot = stiffgen.open_robot(tmp_path / "arm").module
    with np.errstate(invalid="ignore", over="ignore"):  # exp of NaN may raise either flag
        nan = robot.well.linearization(np.full(7, np.nan), np.zeros(3), 1.0)
    assert all(np.isnan(each).all() for each in nan)
    H = robot.forward_kinematics(np.linspace(-1, 1, 7))
    for group in (robot.spring_rotation_vector, robot.spring_quaternion):
        for spoiled in range(3):
            given = [H.copy(), 100 * np.eye(3), 10 * np.eye(3)]
            given[spoiled][0, 1] = np.inf
            with np.errstate(invalid="ignore"):
                energy, torque, tangent = group.linearization(np.zeros(7), *given)
            assert np.isnan(energy)
            assert np.isnan(torque).any()
            assert np.isnan(tangent).any()
