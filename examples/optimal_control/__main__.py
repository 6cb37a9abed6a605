# SPDX-License-Identifier: MIT
"""Solve the problem with CasADi's graph and with the compiled functions, and compare times: ``make optimal-control``.

    python -m examples.optimal_control [--robot FOLDER] [--knots N] [--figure FILE]

Prints what the optimal stiffnesses give beside the paper's constant one, and what each way of solving costs, in
processor time. Exit code 1 if a solution is not feasible, or the graph with the compiled functions' method finds
another one than these. With exact second derivatives the search may end in another, local minimum.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from examples.optimal_control.problem import (
    LEAST,
    PAPER_STIFFNESS,
    Array,
    Solution,
    Task,
    bowl_task,
    distance,
    joint_stiffness,
    solve,
)
from stiffgen import GeneratedRobot, StiffnessModel, open_robot

COMPILED, GRAPH, EXACT = "compiled, first derivatives", "graph, first derivatives", "graph, exact Hessian"
REPEATS, CONFIGURATIONS = 15, 1000


def costs(robot: GeneratedRobot, functions: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return processor times [us] of a joint stiffness, one product and all derivatives: least of all repeats."""
    random = np.random.default_rng(0)
    many = CONFIGURATIONS
    q = random.uniform(-1, 1, (7, many))  # CasADi maps over columns, one per configuration
    wrench, root = random.normal(size=(6, many)), random.normal(size=(6, 6 * many))
    stiffness = np.hstack([block @ block.T for block in np.split(root, many, axis=1)])
    cotangent = random.normal(size=(7, 7 * many))
    runs: dict[tuple[str, str], tuple[Any, tuple[Array, ...]]] = {}
    for way, namespace in functions.items():
        function = namespace.hybrid.joint_stiffness
        results = np.zeros((7, 7 * many))
        kinds: tuple[tuple[str, Any, tuple[Array, ...]], ...] = (
            ("value", function, (q, wrench, stiffness)),
            ("product", function.reverse(1), (q, wrench, stiffness, results, cotangent)),
            ("all derivatives", function.jacobian(), (q, wrench, stiffness, results)),
        )
        for what, called, given in kinds:
            runs[way, what] = called.map(many), given
    least = dict.fromkeys(runs, np.inf)
    for _ in range(REPEATS):
        for key, (mapped, given) in runs.items():
            started = time.process_time()
            mapped.call(given)
            least[key] = min(least[key], time.process_time() - started)
    return {way: {what: 1e6 * least[way, what] / many for w, what in runs if w == way} for way in functions}


def softest(stiffness: Array) -> Array:
    """Return the smallest eigenvalue [N m/rad] of matrices (..., 7, 7)."""
    return np.asarray(np.linalg.eigvalsh(stiffness)[..., 0])


def feasible(robot: Any, task: Task, solution: Solution) -> bool:
    """Return whether tool poses (to 1 um and 1 urad), least joint stiffness and positive K satisfy the constraints."""
    off = np.abs(np.asarray(robot.forward_kinematics(solution.q)) - task.poses).max()
    least = softest(joint_stiffness(robot, task, solution.q, solution.task_stiffness)).min()
    inside = np.all((solution.q > robot.LOWER - 1e-6) & (solution.q < robot.UPPER + 1e-6))
    return bool(
        off < 1e-6 and least > LEAST - 1e-3 and inside and np.linalg.eigvalsh(solution.task_stiffness).min() > 0
    )


def figure(robot: Any, task: Task, solution: Solution) -> str:
    """Return an SVG: distance, smallest eigenvalue and task stiffness along the trajectory."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    from examples.style import AXES, CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    way = np.linspace(0, 100, len(task.recorded))
    constant = joint_stiffness(robot, task, task.recorded, PAPER_STIFFNESS)
    found = joint_stiffness(robot, task, solution.q, solution.task_stiffness)
    with plt.rc_context(STYLE):
        drawing, ((near, soft), (entries, beside)) = plt.subplots(2, 2, figsize=(7.5, 5.4), layout="constrained")
        for stiffness, colour, label in (
            (constant, CONVENTIONAL, "constant task stiffness"), (found, CORRECTED, "optimal"),
        ):  # fmt: skip
            near.semilogy(way, distance(stiffness), color=colour)
            soft.plot(way, softest(stiffness), color=colour, label=label)
        near.set(title="distance to the wanted joint stiffness", ylabel="sum of squares, weighted [1]")
        soft.axhline(LEAST, color=CORRECTED, linestyle=":", linewidth=1, label="required of the optimal one")
        soft.set(title="softest direction of the joints", ylabel="smallest eigenvalue [N m/rad]")
        soft.axhline(0, color=INK, linewidth=0.8)
        for block, line, label in (
            (slice(0, 3), "-", "of the translation [N/m]"), (slice(3, 6), "--", "of the rotation [N m/rad]"),
        ):  # fmt: skip
            principal = np.linalg.eigvalsh(solution.task_stiffness[:, block, block])
            for k, colour in enumerate(AXES):
                entries.semilogy(way, principal[:, k], line, color=colour)
            beside.plot([], [], line, color=INK, label=label)
        entries.set(title="principal stiffnesses of the optimal K", ylabel="stiffness [N/m or N m/rad]")
        beside.set_axis_off()
        beside.legend(handles=[*soft.lines[:3], *beside.lines], loc="center")
        for axes in (near, soft, entries):
            axes.set_xlabel("part of the way [%]")
        svg = themed_svg(drawing)
        plt.close(drawing)
    return svg


def main() -> int:
    """Run the example; options stand in the text of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", type=Path, default=Path("build/robots/iiwa14_wiping"))
    parser.add_argument("--knots", type=int, default=12)
    parser.add_argument("--figure", type=Path, help="write the figure there, an SVG")
    options = parser.parse_args()
    opened = open_robot(options.robot)
    robot: Any = opened.module
    functions = {
        COMPILED: importlib.import_module(f"{robot.__name__}.casadi"),
        GRAPH: StiffnessModel(opened.chain),
    }
    task = bowl_task(robot, options.knots)
    # The same task three times: derivatives by compiled functions, by CasADi's graph, and with the exact Hessian.
    solutions = {
        COMPILED: solve(functions[COMPILED], robot, task),
        GRAPH: solve(functions[GRAPH], robot, task),
        EXACT: solve(functions[GRAPH], robot, task, exact_hessian=True),
    }
    best = solutions[COMPILED]
    constant = joint_stiffness(robot, task, task.recorded, PAPER_STIFFNESS)
    found = joint_stiffness(robot, task, best.q, best.task_stiffness)
    print(f"{options.knots} knots of the bowl trajectory, {56 * options.knots} unknowns")
    for title, stiffness in (("the paper's K, recorded postures", constant), ("optimal", found)):
        away, soft = distance(stiffness), softest(stiffness)
        print(
            f"  {title:34} distance {away.min():7.2f} to {away.max():7.2f}, softest direction {soft.min():.2f} N m/rad"
        )
    print(
        f"  postures differ from the recording by up to {np.degrees(np.abs(best.q - task.recorded).max()):.1f} degrees"
    )
    print(f"  {'solved with':34} iterations  seconds  of these in functions     cost")
    for way, each in solutions.items():
        print(f"  {way:34} {each.iterations:10d} {each.seconds:8.2f} {each.evaluating:22.2f} {each.cost:9.5f}")
    measured = costs(opened, functions)
    print("  one joint stiffness [us]                value   product   all derivatives")
    rows = {way.partition(",")[0]: timed for way, timed in measured.items()}
    rows["graph to compiled"] = {what: measured[GRAPH][what] / least for what, least in measured[COMPILED].items()}
    for row, values in rows.items():
        print(f"  {row:34} {values['value']:10.2f} {values['product']:9.2f} {values['all derivatives']:17.2f}")
    if options.figure:
        options.figure.write_text(figure(robot, task, best), encoding="utf-8")
    same = abs(solutions[GRAPH].cost - best.cost) < 1e-4 * best.cost
    good = all(feasible(robot, task, each) for each in solutions.values())
    for failed, text in (
        (not same, "graph and compiled functions lead to different solutions"),
        (not good, "a solution is not feasible"),
    ):
        if failed:
            print(f"  {text}")
    return 0 if same and good else 1


if __name__ == "__main__":
    raise SystemExit(main())
