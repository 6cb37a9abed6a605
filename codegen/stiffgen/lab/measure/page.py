# SPDX-License-Identifier: MIT
"""Page and table of a measurement: findings, the residual's picture, stiffness with intervals, the sensor's errors."""

from __future__ import annotations

import csv
import io

import numpy as np
from markupsafe import Markup

from stiffgen.core.rendering import environment
from stiffgen.lab.measure.measurement import MeasuredJointStiffness, Measurement
from stiffgen.lab.measure.picture import residual_picture
from stiffgen.lab.measure.refusals import DELAY
from stiffgen.lab.measure.residual import NORMAL, SensorError
from stiffgen.lab.page import POLICY, STYLE

_UNITS = {
    "turn": ("deg", float(np.degrees(1.0))),
    "lever": ("mm", 1e3),
    "force bias": ("N", 1.0),
    "moment bias": ("N m", 1.0),
}
"""Unit of each error of the sensor, and the factor to it."""
ROWS, COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz"), ("x", "y", "z", "rx", "ry", "rz")


def statements(found: Measurement, joints: MeasuredJointStiffness | None = None) -> list[str]:
    """Return the findings in sentences: fit, sign, whether sensor and pose agree, and what a delay would fake."""
    K, residual = found.K, found.residual
    lines = [
        f"{len(found.motion)} rows about one pose, {'quadratic' if found.fit.quadratic else 'linear'} fit: stiffness "
        f"{_span(np.linalg.eigvalsh(K[:3, :3]))} N/m and {_span(np.linalg.eigvalsh(K[3:, 3:]))} N m/rad.",
        "Readings are the wrench that stretches the spring."
        if found.sign > 0
        else "Readings are the wrench of the spring itself: stiffness and load are given with the opposite sign.",
    ]
    chance = f"chi-square {residual.chi2:.1f} of 15, probability {residual.probability:.2g}"
    if not residual.is_alarm:
        lines.append(f"Sensor and pose agree: the antisymmetric part is what the load explains ({chance}).")
    else:
        lines.append(f"The antisymmetric part is not what the load explains ({chance}).")
        if residual.left_probability < 0.001:
            lines.append(
                "No turn, shift or bias of the sensor explains it: look for crosstalk, friction, and gains of single "
                "channels."
            )
    lines += [_sentence(each) for each in residual.errors if residual.is_alarm or each.verdict == "not separable"]
    turn, lever = found.faked  # [rad], [m]
    lines.append(
        f"A delay of {1000 * DELAY:g} ms between pose and reading would look like a turn of {np.degrees(turn):.2g} deg "
        f"and a shift of {1000 * lever:.2g} mm in this motion."
    )
    if joints is not None:
        at = np.unravel_index(int(joints.deviation.argmax()), joints.deviation.shape)
        lines.append(
            f"Joint stiffness: largest entry {np.abs(joints.joint_stiffness).max():.4g} N m/rad; largest standard "
            f"deviation {joints.deviation[at]:.2g} N m/rad."
        )
    return lines


def _span(values: np.ndarray) -> str:
    return f"{values.min():.4g} to {values.max():.4g}"


def _sentence(error: SensorError) -> str:
    unit, factor = _UNITS[error.name]
    if error.verdict == "not separable":
        return f"{error.name}: not separable from the others in this recording"
    numbers = ", ".join(f"{factor * each:.3g}" for each in error.value)
    spread = ", ".join(f"{NORMAL * factor * each:.2g}" for each in error.deviation)
    return f"{error.name}: ({numbers}) +- ({spread}) {unit} in sensor axes" + (" (found)" * (error.verdict == "found"))


def to_csv(found: Measurement, joints: MeasuredJointStiffness | None = None) -> str:
    """Return the table: entries of Km and K with their 95 % half widths, load, and the sensor's errors in SI units."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("quantity", "row", "column", "value", "half_width_95"))
    for name, matrix in (("Km", found.fit.Km), ("K", found.K)):
        for i, row in enumerate(ROWS):
            for j, column in enumerate(COLUMNS):
                rows.writerow((name, row, column, f"{matrix[i, j]:.9g}", f"{found.interval[i, j]:.3g}"))
    for i, row in enumerate(ROWS):
        half = NORMAL * found.fit.load_deviation[i]  # 95 % of a normal distribution
        rows.writerow(("load", row, "", f"{found.load[i]:.9g}", f"{half:.3g}"))
    for error in found.residual.errors:
        for axis, value, deviation in zip("xyz", error.value, error.deviation, strict=True):
            rows.writerow((error.name, axis, error.verdict, f"{value:.9g}", f"{NORMAL * deviation:.3g}"))
    if joints is not None:
        for (i, j), value in np.ndenumerate(joints.joint_stiffness):
            rows.writerow(("joint stiffness", i, j, f"{value:.9g}", f"{NORMAL * joints.deviation[i, j]:.3g}"))
    return text.getvalue()


def render_page(name: str, found: Measurement, joints: MeasuredJointStiffness | None, table: str) -> str:
    """Return the page: one file without scripts, for light and dark; ``table`` is the name of the CSV file.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    cells = [
        [f"{value:.4g} ± {half:.2g}" for value, half in zip(*both, strict=True)]
        for both in zip(found.K, found.interval, strict=True)
    ]
    text: str = (
        environment("stiffgen.lab.measure", escaped=True)
        .get_template("measured.html.j2")
        .render(
            name=name, statements=statements(found, joints), is_alarm=found.residual.is_alarm, cells=cells, rows=ROWS,
            columns=COLUMNS, load=[f"{each:.4g}" for each in found.load], table=table,
            picture=Markup(residual_picture(found.residual)), policy=POLICY, style=Markup(STYLE),
        )
    )  # fmt: skip
    return text
