# SPDX-License-Identifier: MIT
"""The optimal control example: its formulas against independent ones, and the whole program with few knots."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import stiffgen
from examples.optimal_control import problem
from examples.optimal_control.__main__ import feasible, figure, softest
from stiffgen.core.robot.chain import Tool
from support.pictures import difference
from support.project import ROOT, URDF


@pytest.fixture(scope="module")
def graph():
    return stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tool=Tool(xyz=(0.0, 0.0, 0.24))))


@pytest.fixture(scope="module")
def as_numpy(graph):
    """Return what the example takes of the NumPy module, by CasADi, without compiling."""

    def forward_kinematics(q):
        return np.array([np.array(graph.forward_kinematics(each)) for each in np.atleast_2d(q)])

    def joint_stiffness(q, wrench, task_stiffness):
        many = np.broadcast_to(task_stiffness, (len(q), 6, 6))
        rows = zip(q, wrench, many, strict=True)
        return np.array([np.array(graph.hybrid.joint_stiffness(*row)) for row in rows])

    coordinates = graph.chain.coordinates
    return SimpleNamespace(
        forward_kinematics=forward_kinematics,
        hybrid=SimpleNamespace(joint_stiffness=joint_stiffness),
        LOWER=np.array([each.lower for each in coordinates]),
        UPPER=np.array([each.upper for each in coordinates]),
    )


@pytest.mark.slow
def test_solution_with_few_knots(graph, as_numpy):
    """Solve with few knots and exact Hessians: tool in place, positive definite, nearer than the constant."""
    task = problem.bowl_task(as_numpy, 3)
    found = problem.solve(graph, as_numpy, task, exact_hessian=True)
    assert feasible(as_numpy, task, found)
    before = problem.distance(problem.joint_stiffness(as_numpy, task, task.recorded, problem.PAPER_STIFFNESS))
    stiffness = problem.joint_stiffness(as_numpy, task, found.q, found.task_stiffness)
    after = problem.distance(stiffness)
    assert np.all(after < before / 10)
    # The cost is what its formula says, term by term.
    W = problem.WANTED
    direct = sum((each[i, j] - W[i, j]) ** 2 / (W[i, i] * W[j, j]) for each in stiffness for i, j in np.ndindex(7, 7))
    assert found.cost > direct
    assert direct == pytest.approx(after.sum(), rel=1e-12)
    floor = problem.FLOOR * np.diag(problem.SCALE**2)
    assert np.linalg.eigvalsh(found.task_stiffness - floor).min() > -1e-9
    assert np.all(np.diagonal(found.task_stiffness, axis1=1, axis2=2) < problem.LIMIT * (1 + 1e-6))


def test_load_is_that_of_the_bowl_on_the_tool(graph, as_numpy):
    """Check the load: back along the tool's axis, and friction against the motion."""
    task = problem.bowl_task(as_numpy, 5)
    axis = task.poses[:, :3, 2]
    assert np.all((task.wrenches[:, :3] * axis).sum(1) < 0)
    way = np.diff(task.poses[:, :3, 3], axis=0)
    across = task.wrenches[:-1, :3] + problem.PRESS * axis[:-1]
    assert np.all((across * way).sum(1) < 0)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), problem.PRESS * problem.FRICTION, rtol=1e-9)
    whole = problem.bowl_task(as_numpy, 12)
    constant = problem.joint_stiffness(as_numpy, whole, whole.recorded, problem.PAPER_STIFFNESS)
    assert softest(constant).min() < 0  # as the page says


@pytest.mark.wide(instead="test_solution_with_few_knots")
def test_program(tmp_path):
    """make optimal-control, with fewer knots: all three ways, the table and the figure."""
    folder = stiffgen.generate(
        URDF, name="iiwa14_wiping", tool=Tool(xyz=(0.0, 0.0, 0.24)), masses=False, output=tmp_path,
        derivatives=True,
    )  # fmt: skip
    file = tmp_path / "figure.svg"
    command = [sys.executable, "-m", "examples.optimal_control", "--robot", str(folder), "--figure", str(file)]
    done = subprocess.run([*command, "--knots", "4"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "graph to compiled" in done.stdout
    assert file.read_text().startswith("<svg")


@pytest.mark.slow
def test_the_pages_figure(graph, as_numpy):
    """With the page's twelve knots, by the graph: another way to the same solution, in 183 steps for 186."""
    task = problem.bowl_task(as_numpy, 12)
    drawn = figure(as_numpy, task, problem.solve(graph, as_numpy, task))
    assert difference(drawn, (ROOT / "docs" / "casadi.svg").read_text(), within=1.0) == ""
