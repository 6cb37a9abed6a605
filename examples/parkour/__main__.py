# SPDX-License-Identifier: MIT
"""Run the parkour experiment: four laws press along a recorded path over a board with obstacles.

``python -m examples.parkour`` in the repository's root, or ``make experiment``.
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
    print(f"parkour: {missing.name} is not installed; pip install -e '.[examples]'", file=sys.stderr)
    sys.exit(2)

from examples.experiments import command, figures, report
from examples.experiments.trial import run
from examples.parkour import analysis, trajectory
from examples.parkour.board import WIDTH, parkour_plant
from examples.parkour.experiment import EXPERIMENT

WIDTHS = (0.03, WIDTH, 0.12)
"""[m] of the obstacles across the path, in the study."""
INTRODUCTION = (
    "“Experiment 1: Parkour” of Lachner, Nah and Hogan, “A Physically Consistent Stiffness Formulation for "
    "Contact-Rich Manipulation” (2025), in simulation: an LBR iiwa 14 was guided by hand over a board with obstacles, "
    "and replays the motion 20 mm lower, so that it presses. Four laws with the same gains: the paper's, corrected and "
    "conventional, the gradient of a spring's energy, and the Cartesian law in common use."
)
CAPTIONS = {
    **figures.CAPTIONS,
    report.PICTURE: "Configurations of the corrected trial: start, on the first obstacle, at the far end, and on the "
    "third obstacle (solid). Rendered by MuJoCo.",
    report.FILM: "The corrected trial in real time.",
}


def main(arguments: Sequence[str] | None = None) -> int:
    return command.main(EXPERIMENT, describe, arguments)


def describe(robot: ModuleType, trials: command.Trials) -> report.Content:
    """Analyse the trials and draw the figures of the first sample time."""
    (first, traces), *others = trials.items()
    found = {law: analysis.findings(robot, law, trace) for law, trace in traces.items()}
    fast = {law: analysis.findings(robot, law, trace) for _, more in others for law, trace in more.items()}
    shift = trajectory.compare(robot)
    study = {}
    for width in WIDTHS:
        trace = run(robot, "conventional", parkour_plant(first, width=width), trajectory.motion(first))
        study[width] = analysis.findings(robot, "conventional", trace)
    common = [*figures.CAPTIONS]
    heads = ("what", *(f"{1e3 * each:g} ms" for each in (*trials, *((0.001,) if not others else ()))), "remark")
    return report.Content(
        title="Parkour with and without the correction",
        introduction=(analysis.introduction(found, traces), INTRODUCTION),
        sections=(
            report.Section(
                "The trials",
                (heads[0], heads[1], heads[2], heads[-1]),
                analysis.summary(found, fast, robot),
                [report.PICTURE, report.FILM, *common],
            ),
            report.Section(
                "Width of the obstacles, conventional trial",
                ("width", "contact", "moment", "antisymmetric part"),
                analysis.study_rows(study),
                [],
            ),
            report.Section(
                "The shift of the recording", ("what", "mean", "spread", "remark"), analysis.shift_rows(shift), []
            ),
        ),
        figures=figures.draw(robot, traces),
        captions=CAPTIONS,
        failed=[*analysis.failed_bars(found, shift), *analysis.failed_bars(fast, shift)],
    )


if __name__ == "__main__":
    sys.exit(main())
