# SPDX-License-Identifier: MIT
"""Compute the findings of the parkour's trials: bars that must hold, and the rows of the report."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from examples.experiments.analysis import Array, Row, closed_form, excess, largest, worst_per_moment
from examples.experiments.motion import APPROACH_TIME
from examples.experiments.trial import FORCE_NOISE, MOMENT_NOISE, TASK_STIFFNESS, Trace, faults, parts
from examples.parkour.board import WIDTH
from examples.parkour.trajectory import DEPTH, LIFT_OFF, Shift, zero_force

SYMMETRY_BAR = 1e-12
"""[N m/rad] largest entry of the antisymmetric part with the correction, and deviation from the closed form without."""
CONTACT_BAR = 0.9
"""Share of the samples in contact, from the approach's end to the lift-off."""
NOISE_BAR = 7.0
"""Standard deviations of the sensor's noise between the measured wrench and the sum of the contacts."""
SHIFT_BAR = 1e-4
"""[m] between the replayed trajectory's depth below the recorded one and 20.0 mm."""


@dataclass(frozen=True)
class Findings:
    """Figures of one trial; units as in :data:`trial.COLUMNS`.

    Attributes:
        symmetric_entry: largest entry of the antisymmetric part of the stiffness that was applied.
        closed_form_error: deviation of the conventional formula's antisymmetric part from the closed form on the
            trial's states; in the conventional trial also of the stiffness that the controller applied.
        correction_torque: largest torque that the correction makes on the trial's deflection [N m].
        antisymmetric: largest singular value of the antisymmetric part.
        contact: share of the samples in contact until the lift-off.
        force, moment: mean force [N] and largest moment [N m] meanwhile.
        wrench_error: largest distance of the measured wrench from the contacts, in standard deviations of the noise.
        port_work: [J] put out at the port.
        excess: largest work beyond the controller's bound [J]; negative: the bound is kept.
        faults: status bits that count as faults, with the number of steps.

    """

    symmetric_entry: float
    closed_form_error: float
    correction_torque: float
    antisymmetric: float
    contact: float
    force: float
    moment: float
    wrench_error: float
    port_work: float
    excess: float
    faults: dict[str, int]


def findings(robot: ModuleType, law: str, trace: Trace) -> Findings:
    """Analyse one trial."""
    q, wrench = trace["q"], trace["wrench_used"]
    on_board = trace["pressing"] & (trace["time"] <= APPROACH_TIME + LIFT_OFF)
    closed = closed_form(robot, q, wrench)
    uncorrected = parts(robot.hybrid.joint_stiffness_uncorrected(q, wrench, TASK_STIFFNESS))[1]
    applied = parts(trace["stiffness"])[1]
    error = largest(uncorrected - closed)
    if law == "conventional":
        error = max(error, largest(applied - closed))
    torque = np.einsum("nij,nj->ni", closed, trace["q0"] - q)
    noise = np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
    return Findings(
        symmetric_entry=largest(applied),
        closed_form_error=error,
        correction_torque=largest(torque[on_board]),
        antisymmetric=float(trace["antisymmetric"][on_board].max()),
        contact=float(trace["contact"][on_board].mean()),
        force=float(np.linalg.norm(wrench[on_board, :3], axis=1).mean()),
        moment=float(np.linalg.norm(wrench[on_board, 3:], axis=1).max()),
        wrench_error=largest((trace["wrench"] - trace["contact_wrench"]) / noise),
        port_work=float(trace["port_total"][-1]),
        excess=excess(trace),
        faults=faults(robot, trace["status"]),
    )


def failed_bars(found: dict[str, Findings], shift: Shift) -> list[str]:
    """Return the bars that do not hold, in words; empty if all do. Nothing that is no number holds."""
    failed = []
    for law in ("corrected", "potential"):
        if law in found and not found[law].symmetric_entry <= SYMMETRY_BAR:
            failed.append(f"symmetry of the {law} trial: {found[law].symmetric_entry:.1e} N m/rad")
    for law, each in found.items():
        if not each.closed_form_error <= SYMMETRY_BAR:
            failed.append(f"closed form in the {law} trial: {each.closed_form_error:.1e} N m/rad apart")
        if not each.wrench_error <= NOISE_BAR:
            failed.append(f"wrench in the {law} trial: {each.wrench_error:.1f} standard deviations from the contacts")
        if not each.contact >= CONTACT_BAR:
            failed.append(f"contact in the {law} trial: only {each.contact:.1%} of the samples")
        if law == "potential" and not each.excess <= 0.0:
            failed.append(f"energy bound of the {law} trial: exceeded by {each.excess:.1e} J")
        failed += [f"fault in the {law} trial: {bit} in {count} steps" for bit, count in each.faults.items()]
    if not abs(shift.mean[2] + DEPTH) <= SHIFT_BAR:
        failed.append(f"shift: {-1e3 * shift.mean[2]:.2f} mm")
    return failed


def introduction(found: dict[str, Findings], trials: dict[str, Trace]) -> str:
    """Return what the correction changes on this task, and what it does not."""
    corrected, conventional = trials["corrected"], trials["conventional"]
    until = corrected["time"] <= APPROACH_TIME + LIFT_OFF
    apart = 1e3 * np.linalg.norm(corrected["position"] - conventional["position"], axis=1)[until].max()
    return (
        f"On this task the correction changes the torque by at most {found['conventional'].correction_torque:.2g} N m "
        f"and the tool point by at most {apart:.2g} mm, since the ball transmits at most "
        f"{found['conventional'].moment:.2g} N m about its centre. It does not change the symmetric part of the "
        "stiffness, its eigenvalues, or the force of the contact."
    )


def summary(found: dict[str, Findings], fast: dict[str, Findings], robot: ModuleType) -> list[Row]:
    """Return the rows of the trials; ``fast``: the same at the shorter sample time, empty if there is none."""
    worst = worst_per_moment(robot, zero_force())

    def row(what: str, text: str, remark: str, *laws: str) -> Row:
        def of(trials: dict[str, Findings]) -> str:
            chosen = [law for law in laws or trials if law in trials]
            return "; ".join(f"{law} {text.format(trials[law])}" for law in chosen) or "not run"

        return Row(what, of(found), of(fast), remark)

    return [
        row("largest antisymmetric entry [N m/rad]", "{0.symmetric_entry:.1g}", "0 with the correction", "corrected",
            "conventional", "potential"),
        row("the formula without correction against J_r^T [m]x J_r / 2 [N m/rad]", "{0.closed_form_error:.0e}",
            f"on all recorded states; 1 N m makes at most {worst:.2f} N m/rad anywhere on the trajectory"),
        row("torque of the correction, at most [N m]", "{0.correction_torque:.2g}",
            "the antisymmetric part times the deflection", "corrected", "conventional"),
        row("contact until the lift-off", "{0.contact:.1%}", "of the samples"),
        row("force, mean [N]", "{0.force:.1f}", "16 N are 20 mm at 800 N/m"),
        row("moment about the ball's centre, at most [N m]", "{0.moment:.2g}", "friction times the ball's radius"),
        row("work put out at the port [J]", "{0.port_work:.2f}", ""),
        row("work beyond the controller's bound [J]", "{0.excess:.1f}", "", "potential"),
    ]  # fmt: skip


def study_rows(study: dict[float, Findings]) -> list[Row]:
    """Return rows of the obstacles' width across the path."""
    return [
        Row(
            f"{1e2 * width:.0f} cm across the path" + (" (the trials')" if width == WIDTH else ""),
            f"contact {found.contact:.1%}, force {found.force:.1f} N",
            f"moment at most {found.moment:.2g} N m",
            f"antisymmetric part at most {found.antisymmetric:.2g} N m/rad",
        )
        for width, found in study.items()
    ]


def shift_rows(shift: Shift) -> list[Row]:
    """Return rows of the shift and of its reconstruction."""

    def vector(values: Array, scale: float, digits: int) -> str:
        return ", ".join(f"{scale * value:.{digits}f}" for value in values)

    return [
        Row(
            "replayed less recorded",
            f"x, y, z {vector(shift.mean, 1e3, 2)} mm",
            f"standard deviation {vector(shift.deviation, 1e3, 2)} mm",
            "the script says 40 mm; the file is what was replayed",
        ),
        Row(
            "made anew less replayed",
            f"tool point {1e3 * shift.position:.2f} mm, orientation {np.degrees(shift.orientation):.2f} deg at most",
            f"joints A1 to A7 {vector(shift.joints, np.degrees(1), 1)} deg at most",
            "one step of the inertia-weighted damped pseudo-inverse from each recorded sample, then smoothed; the rest "
            "is motion in the nullspace",
        ),
    ]
