# SPDX-License-Identifier: MIT
"""Run the bowl-wiping experiment: the paper's law, corrected and conventional, and the potential law.

``python -m examples.bowl_wiping`` in the repository's root, or ``make experiment``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import ModuleType

try:
    import matplotlib  # noqa: F401
    import mujoco  # noqa: F401
    import scipy  # noqa: F401
except ImportError as missing:
    print(f"bowl_wiping: {missing.name} is not installed; pip install -e '.[examples]'", file=sys.stderr)
    sys.exit(2)

from examples.bowl_wiping import analysis, trajectory
from examples.bowl_wiping.experiment import EXPERIMENT
from examples.bowl_wiping.figures import draw
from examples.experiments import command, figures, report

INTRODUCTION = (
    "The experiment of Lachner, Nah and Hogan, “A Physically Consistent Stiffness Formulation for Contact-Rich "
    "Manipulation” (2025), in simulation: an LBR iiwa 14 wipes a bowl three times: with the paper's law, its joint "
    "stiffness corrected and conventional, and with the gradient of a spring's energy."
)
CAPTIONS = {
    **figures.CAPTIONS,
    report.PICTURE: "Configurations of the corrected trial: start, start of the wipe, on the way, and the turning "
    "point, which is solid. Rendered by MuJoCo.",
    report.FILM: "The corrected trial in real time.",
    "joints.svg": f"{figures.CAPTIONS['joints.svg']} Towards the end joints 5 and 7 swing under the paper's law: "
    "the smallest eigenvalue is near zero there, and with it the designed damping of that motion.",
    "trajectory.svg": "The zero-force trajectory: as recorded, and by inverse kinematics from the stated and from the "
    "measured geometry.",
}


def main(arguments: Sequence[str] | None = None) -> int:
    return command.main(EXPERIMENT, describe, arguments)


def describe(robot: ModuleType, trials: command.Trials) -> report.Content:
    """Analyse the trials of the first sample time and draw the figures."""
    (first, *_) = trials.values()
    found = analysis.findings(robot, list(first.values()))
    compared = [trajectory.compare(robot, geometry) for geometry in (trajectory.STATED, trajectory.MEASURED)]
    drawn = {**figures.draw(robot, first), "trajectory.svg": draw(robot, *compared)}
    common = [*figures.CAPTIONS]
    return report.Content(
        title="Bowl wiping with and without the correction",
        introduction=(INTRODUCTION,),
        sections=(
            report.Section(
                "The paper and this simulation",
                ("what", "paper", "measured here", "remark"),
                analysis.summary(found),
                [common[0], report.PICTURE, report.FILM, *common[1:]],
            ),
            report.Section(
                "The zero-force trajectory made anew",
                ("from", "geometry", "largest deviation from the recording", "remark"),
                analysis.trajectory_rows(*compared),
                ["trajectory.svg"],
            ),
        ),
        figures=drawn,
        captions=CAPTIONS,
        failed=found.failed_bars(),
    )


if __name__ == "__main__":
    sys.exit(main())
