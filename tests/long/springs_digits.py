"""Springs against 60 digits over many poses: python tests/long/springs_digits.py [COUNT] [ROBOT_COUNT].

For every spring, axes and centre the worst relative error of energy, wrench and covariant Hessian over COUNT poses at
random, COUNT within 1e-9 to 1e-3 of the equilibrium and COUNT within 1e-6 of the edge (turns by pi); then, for three
robots, torque and tangent from q over ROBOT_COUNT of each, in units of what test_springs.py allows. Exit code 1 beyond.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stiffgen.symbolic.springs import KINDS
from support.spring_digits import CASES, PLACEMENTS, ROBOTS, pose_errors, robot_errors

BOUND = 1e-11


def main(count: int, of_robots: int) -> int:
    failed = 0
    for kind in KINDS:
        for placement in PLACEMENTS:
            for case in CASES:
                errors = pose_errors(kind, placement, case, count, seed=1)
                failed += max(errors.values()) > BOUND
                shown = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
                print(f"{kind} | {placement} | {case}, {count} poses | {shown}", flush=True)
    with tempfile.TemporaryDirectory() as work:
        for robot in ROBOTS if of_robots else ():
            for kind in KINDS:
                for placement in PLACEMENTS:
                    for case in CASES:
                        errors = robot_errors(robot, kind, placement, case, of_robots, 1, Path(work))
                        failed += max(errors.values()) > 1
                        shown = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
                        print(f"{robot} | {kind} | {placement} | {case}, {of_robots} poses | {shown}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*(given + [1000, 1000][len(given) :])))
