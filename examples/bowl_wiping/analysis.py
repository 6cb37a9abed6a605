# SPDX-License-Identifier: MIT
"""Compute the findings of the trials: bars that must hold, and the paper's statements beside measured values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from examples.bowl_wiping.trajectory import MEASURED, STATED, Comparison, recorded
from examples.experiments.analysis import Row, closed_form, excess, largest, worst_per_moment
from examples.experiments.trial import TASK_STIFFNESS, Trace, faults, parts

Array = NDArray[np.float64]

LAWS = ("corrected", "conventional", "potential")
"""The trials, in this order."""
SYMMETRY_BAR = 1e-12
"""[N m/rad] largest entry of the antisymmetric part with the correction."""
CLOSED_FORM_BAR = 1e-12
"""[N m/rad] largest deviation from the closed form without it."""
CONTACT_BAR = 0.9
"""Share of the wipe in contact."""
MOMENT_BAR = 5.0
"""[N m] that the moment at the tool must reach."""


@dataclass(frozen=True)
class Findings:
    """Figures of the trials (index 0 corrected, 1 conventional, 2 potential, where a figure is about that one, too).

    Units as in :data:`trial.COLUMNS`.

    ``antisymmetric_entry``: largest absolute entry of the antisymmetric part of the applied stiffness, per trial.
    ``closed_form_error``: largest deviation of the conventional formula's antisymmetric part from the closed form, on
    the recorded states of each trial; in the conventional trial of the stiffness that the controller applied.
    ``per_moment``: range over the wipe of the antisymmetric part's largest singular value per N m of moment.
    ``worst_per_moment``: the largest that any unit moment causes anywhere on the zero-force trajectory.
    ``supplied`` and ``excess`` [J]: the potential law's bound on its work, and the largest work beyond it.
    """

    antisymmetric_entry: tuple[float, float]
    closed_form_error: tuple[float, float]
    antisymmetric: tuple[float, float]
    antisymmetric_median: float
    per_moment: tuple[float, float]
    worst_per_moment: float
    lowest_eigenvalue: tuple[float, float]
    indefinite: tuple[float, float]
    contact: tuple[float, float, float]
    largest_moment: tuple[float, float, float]
    largest_force: tuple[float, float, float]
    moment_range: tuple[float, float]
    force_range: tuple[float, float]
    faults: tuple[dict[str, int], dict[str, int], dict[str, int]]
    joint_difference: Array
    tip_difference: float
    deflection: tuple[float, float, float]
    port_work: tuple[float, float, float]
    supplied: float
    excess: float

    def failed_bars(self) -> list[str]:
        """Return the bars that do not hold, in words; empty if all do. Nothing that is no number holds."""
        failed = []
        if not self.antisymmetric_entry[0] <= SYMMETRY_BAR:
            failed.append(f"antisymmetric part with correction: {self.antisymmetric_entry[0]:.1e} N m/rad")
        if not all(error <= CLOSED_FORM_BAR for error in self.closed_form_error):
            failed.append(f"deviation from the closed form: {max(self.closed_form_error):.1e} N m/rad")
        if not all(share >= CONTACT_BAR for share in self.contact):
            failed.append(f"contact: only {min(self.contact):.1%} of the wipe")
        if not all(moment >= MOMENT_BAR for moment in self.largest_moment):
            failed.append(f"moment at the tool: only {min(self.largest_moment):.2f} N m")
        if not self.excess <= 0.0:
            failed.append(f"energy bound: exceeded by {self.excess:.1e} J")
        for name, counts in zip(LAWS, self.faults, strict=True):
            failed += [f"fault in the {name} trial: {bit} in {count} steps" for bit, count in counts.items()]
        return failed


def findings(robot: ModuleType, trials: list[Trace]) -> Findings:
    """Analyse the trials, in the order of :data:`LAWS`: two of the paper's law, then the potential's."""
    corrected, conventional, potential = trials
    wipes = [trace["pressing"] for trace in trials]  # masks of the samples in which the tool wipes
    wipe = wipes[1]
    applied = [parts(trace["stiffness"])[1] for trace in (corrected, conventional)]
    per_moment = conventional["antisymmetric"][wipe] / np.linalg.norm(conventional["wrench_used"][wipe, 3:], axis=1)
    at_tool = np.concatenate([trace["wrench_used"][w] for trace, w in zip(trials, wipes, strict=True)])
    tips = [robot.forward_kinematics(trace["q"])[wipe, :3, 3] for trace in (corrected, potential)]

    def all_three(value: Callable[[Trace, NDArray[np.bool_]], Any]) -> tuple[float, float, float]:
        """Return a number of each trial and its mask."""
        first, second, third = (float(value(trace, w)) for trace, w in zip(trials, wipes, strict=True))
        return first, second, third

    def paper(value: Callable[[Trace, NDArray[np.bool_]], Any]) -> tuple[float, float]:
        """Return a number of each trial of the paper's law."""
        return all_three(value)[:2]

    return Findings(
        antisymmetric_entry=(largest(applied[0]), largest(applied[1])),
        closed_form_error=_closed_form_errors(robot, corrected, conventional, applied[1]),
        antisymmetric=paper(lambda t, w: t["antisymmetric"].max()),
        antisymmetric_median=float(np.median(conventional["antisymmetric"][wipe])),
        per_moment=(float(per_moment.min()), float(per_moment.max())),
        worst_per_moment=worst_per_moment(robot, recorded()),
        lowest_eigenvalue=paper(lambda t, w: t["eigenvalues"].min()),
        indefinite=paper(lambda t, w: np.mean(t["eigenvalues"][w, 0] < 0)),
        contact=all_three(lambda t, w: np.mean(t["contact"][w])),
        largest_moment=all_three(lambda t, w: np.linalg.norm(t["wrench_used"][w, 3:], axis=1).max()),
        largest_force=all_three(lambda t, w: np.linalg.norm(t["wrench_used"][w, :3], axis=1).max()),
        moment_range=(float(at_tool[:, 3:].min()), float(at_tool[:, 3:].max())),
        force_range=(float(at_tool[:, :3].min()), float(at_tool[:, :3].max())),
        faults=(
            faults(robot, corrected["status"]),
            faults(robot, conventional["status"]),
            faults(robot, potential["status"]),
        ),
        joint_difference=np.abs(corrected["q"] - conventional["q"]).max(axis=0),
        tip_difference=float(np.linalg.norm(tips[0] - tips[1], axis=1).max()),
        deflection=all_three(lambda t, w: np.abs(t["error"]).max()),
        port_work=all_three(lambda t, w: t["port_total"][-1]),
        supplied=float(potential["supplied_total"][-1]),
        excess=excess(potential),
    )


def _closed_form_errors(
    robot: ModuleType, corrected: Trace, conventional: Trace, applied: Array
) -> tuple[float, float]:
    """Return the largest deviations of antisymmetric parts from the closed form, on the states of two trials.

    They are those of the conventional formula; in the conventional trial also that of the ``applied`` stiffness.
    """
    formula, closed = [], []
    for trace in (corrected, conventional):
        q, wrench = trace["q"], trace["wrench_used"]
        formula.append(parts(robot.hybrid.joint_stiffness_uncorrected(q, wrench, TASK_STIFFNESS))[1])
        closed.append(closed_form(robot, q, wrench))
    return largest(formula[0] - closed[0]), largest(np.stack([formula[1], applied]) - closed[1])


def summary(found: Findings) -> list[Row]:
    """Return the paper's statements beside the measured figures."""
    low, high = found.per_moment
    unknown = "no figure"
    return [
        Row(
            "antisymmetric part with the correction",
            "zero",
            f"{found.antisymmetric_entry[0]:.1g} N m/rad at most, in every entry at every step",
            "the kernel computes one triangle and mirrors it",
        ),
        Row(
            "antisymmetric part without it, largest singular value",
            "about 30 N m/rad",
            f"{found.antisymmetric[1]:.2f} N m/rad at most, {found.antisymmetric_median:.2f} in the median of the wipe",
            f"differs. Per N m of moment it is {low:.2f} to {high:.2f} here, and {found.worst_per_moment:.2f} at most "
            f"anywhere on the zero-force trajectory, whatever the moment's direction. So 30 N m/rad takes a moment of "
            f"{30 / found.worst_per_moment:.1f} N m or more, and the paper's moments end at 10 N m. (Kq - Kq^T without "
            f"the half would reach {20 * found.worst_per_moment:.1f} there.) Nothing is fitted to the 30.",
        ),
        Row(
            "the same against J_r^T [m]x J_r / 2",
            unknown,
            f"{max(found.closed_form_error):.1e} N m/rad apart at most, in every entry at every step",
            "the closed form of the antisymmetric part",
        ),
        Row(
            "external moments at the tool",
            "-5 to 10 N m",
            f"{found.moment_range[0]:.1f} to {found.moment_range[1]:.1f} N m, norm up to "
            f"{max(found.largest_moment):.1f} N m",
            "same size, other signs and peak: bowl and plate are ours, and the paper's moments are about its sensor, "
            "not the tool point",
        ),
        Row(
            "external forces at the tool",
            unknown,
            f"{found.force_range[0]:.0f} to {found.force_range[1]:.0f} N, norm up to {max(found.largest_force):.0f} N",
            "from the depth of the bowl, which is ours",
        ),
        Row(
            "contact during the wipe",
            unknown,
            f"corrected {found.contact[0]:.1%}, conventional {found.contact[1]:.1%}, potential "
            f"{found.contact[2]:.1%} of the samples",
            "",
        ),
        Row(
            "faults of the controller",
            unknown,
            "none in all trials" if not any(found.faults) else str(dict(zip(LAWS, found.faults, strict=True))),
            "",
        ),
        Row(
            "motion with and without the correction",
            unknown,
            f"joints {np.degrees(found.joint_difference).max():.2f} deg apart at most",
            "the corrected stiffness is the symmetric part of the conventional one",
        ),
        Row(
            "lowest eigenvalue of the symmetric part",
            unknown,
            f"{min(found.lowest_eigenvalue):.2f} N m/rad; negative for {max(found.indefinite):.1%} of the wipe",
            "symmetric is not positive definite: the kinematic part has negative directions",
        ),
        Row(
            "the potential law beside it",
            unknown,
            f"tool point {1e3 * found.tip_difference:.1f} mm apart from the corrected trial's at most; joints up to "
            f"{found.deflection[2]:.2f} rad from the zero-force ones, paper's law {found.deflection[0]:.2f} rad",
            "the same gains; no wrench is measured for it",
        ),
        Row(
            "work put out at the robot's port",
            unknown,
            f"corrected {found.port_work[0]:.2f} J, conventional {found.port_work[1]:.2f} J, potential "
            f"{found.port_work[2]:.2f} J",
            f"the potential law's bound on it ends at {found.supplied:.0f} J, and is kept at every sample",
        ),
    ]


def trajectory_rows(stated: Comparison, measured: Comparison) -> list[Row]:
    """Return rows that compare the regenerated trajectories with the recording."""
    wrist = np.degrees(recorded()[measured.worst, 5])
    return [
        Row(
            "stated geometry",
            f"radius {STATED.radius} m about the tip at the given posture, turn {np.degrees(STATED.turn):.0f} deg, "
            "tip 0.275 m from joint 7",
            _deviation(stated),
            "does not match: circle, turn and tip of the recording are those of the next row",
        ),
        Row(
            "geometry measured from the recording",
            f"radius {MEASURED.radius} m, centre {MEASURED.centre[0]} m further along x, turn "
            f"{np.degrees(MEASURED.turn):.1f} deg, tip {MEASURED.tip + 0.035:.4f} m from joint 7, 7 s each way",
            _deviation(measured),
            "matches at the tip. The joints part in the nullspace, and A5 and A7 against each other where their axes "
            f"almost coincide (A6 at {wrist:.1f} deg): a tenth of a degree at the tip is many there",
        ),
    ]


def _deviation(comparison: Comparison) -> str:
    joints = ", ".join(f"{angle:.1f}" for angle in np.degrees(comparison.joints))
    return (
        f"joints A1 to A7 {joints} deg, tool point {1e3 * comparison.position:.2f} mm and "
        f"{np.degrees(comparison.orientation):.2f} deg at most"
    )
