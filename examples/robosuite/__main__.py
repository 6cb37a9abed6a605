# SPDX-License-Identifier: MIT
"""Compare the impedance controller with robosuite's own controllers on its tasks, at equal stiffness of the tip.

    python -m examples.robosuite [--robots Panda] [--tasks Lift] [--seeds 3] [--output docs/robosuite.md]

Without --output the tables are printed; with it a CSV file beside the page has a row per robot, task and controller,
of which the page's tables are made. The exit status is 0 if frames and masses of every robot agree with MuJoCo.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examples.robosuite.controller import PART, VELOCITY_LIMITS
from examples.robosuite.measures import CONTROLLERS, Arm, Job, make, run_job
from examples.robosuite.motions import TASKS, tip_pose
from examples.robosuite.tables import COLUMNS, NAMES, ORBIT, Record, csv_text, tables

MARK = "<!-- python -m examples.robosuite writes all below this line -->"
AGREEMENT = 1e-9  # m, 1 and kg m^2: largest difference from MuJoCo


def disagreement(robot: str) -> float:
    """Return the largest difference of the generated robot from MuJoCo in pose [m, 1] and mass matrix [kg m^2].

    The fingers are moved to 0, where the chain has them.
    """
    env = make("Lift", robot, PART, 1)
    env.reset()
    part, sim = Arm(env).part, env.sim
    sim.data.qpos[env.robots[0]._ref_gripper_joint_pos_indexes["right"]] = 0.0
    sim.forward()
    q, base = sim.data.qpos[part.qpos_index][part.order], np.eye(4)
    base[:3, :3] = sim.data.xmat[part.base_body].reshape(3, 3)
    base[:3, 3] = sim.data.xpos[part.base_body]
    pose = base @ part.module.forward_kinematics(q) - tip_pose(env)
    own = part.module.mass_matrix(q) + np.diag(part.settings["motor_inertia"])
    mass = own - Arm(env).mass_matrix()[np.ix_(part.order, part.order)]
    return float(max(np.abs(pose).max(), np.abs(mass).max()))


def run_jobs(jobs: Sequence[Job], workers: int) -> dict[Job, Any]:
    """Run all jobs in processes of their own, and print how far they are."""
    found: dict[Job, Any] = {}
    begin = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=20) as pool:
        for job, result in zip(jobs, pool.imap(run_job, jobs), strict=True):
            found[job] = result
            seconds = time.monotonic() - begin
            print(
                f"{len(found)} of {len(jobs)}, {seconds:.0f} s: {' '.join(str(each or 'orbit') for each in job)}",
                flush=True,
            )
    return found


def record_episodes(found: dict[Job, Any], robots: Iterable[str], tasks: Iterable[str], seeds: int) -> list[Record]:
    """Return a record per robot, task and controller: means of all seeds, of force and orbit's work the largest."""
    records = []
    for robot in robots:
        for task in tasks:
            for controller, name in zip(CONTROLLERS, NAMES, strict=True):
                runs = [found[robot, task, controller, seed] for seed in range(1, seeds + 1)]
                values = (
                    f"{np.mean([each.success for each in runs]):.2f}",
                    f"{max(each.force for each in runs):.0f}",
                    f"{1e3 * np.mean([each.error for each in runs]):.1f}",
                    f"{np.mean([each.torque_change for each in runs]):.2f}",
                    "",
                )
                records.append(dict(zip(COLUMNS, (robot, task, name, *values), strict=True)))
        for controller, name in zip(CONTROLLERS, NAMES, strict=True):
            work = max(found[robot, None, controller, seed] for seed in range(1, seeds + 1))
            cells = (robot, ORBIT, name, "", "", "", "", f"{1e3 * work:.1e}")
            records.append(dict(zip(COLUMNS, cells, strict=True)))
    return records


def main() -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=list(VELOCITY_LIMITS), choices=list(VELOCITY_LIMITS))
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=list(TASKS))
    parser.add_argument("--seeds", type=int, default=3, help="number of initial states [3]")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--output", type=Path, help="page whose tables are replaced, with its CSV")
    options = parser.parse_args()
    worst = 0.0
    for robot in options.robots:
        worst = max(worst, disagreement(robot))
        print(f"{robot}: largest difference from MuJoCo so far {worst:.1e}", flush=True)
    tasks = [*options.tasks, None]
    jobs = [(robot, task, controller, seed) for robot in options.robots for task in tasks
            for controller in CONTROLLERS for seed in range(1, options.seeds + 1)]  # fmt: skip
    found = run_jobs(jobs, options.workers)
    faults = {job[:2]: result.faults for job, result in found.items() if job[1] and result.faults}
    records = record_episodes(found, options.robots, options.tasks, options.seeds)
    text = (
        f"{options.seeds} initial states each; faults of this controller: {faults or 'none'}. Largest difference from "
        f"MuJoCo in frames and masses: {worst:.1e}.\n\n{tables(records)}"
    )
    if options.output:
        head = options.output.read_text(encoding="utf-8").partition(MARK)[0]
        options.output.write_text(f"{head}{MARK}\n\n{text}", encoding="utf-8")
        options.output.with_suffix(".csv").write_text(csv_text(records), encoding="utf-8")
    else:
        print(text)
    return 0 if worst < AGREEMENT else 1


if __name__ == "__main__":
    sys.exit(main())
