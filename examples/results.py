# SPDX-License-Identifier: MIT
"""Compute the tables of docs/results.md.

    python -m examples.results [SECTION ...]   prints tables: all, or those of some sections
    python -m examples.results --write         replaces the tables in docs/results.md

The section ``experiments`` reads what ``make experiment`` wrote.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import stiffgen
from examples import energy_cycle, theory
from stiffgen import StiffgenError

Array = NDArray[np.float64]
Rows = list[tuple[str, ...]]

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "results.md"
ROBOTS = Path("build/robots")
EVERY = 20
"""Samples of a recorded trajectory from one posture that is looked at to the next."""
TASK_STIFFNESS: Array = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
"""The paper's K [N/m, N m/rad], hybrid frame."""


def appendix(robots: Path) -> Rows:
    """Compute the paper's appendix example, three revolute joints, at q1 = 0.7 rad under m = (1, 2, 3) N m."""
    q1, m = 0.7, np.array([1.0, 2.0, 3.0])
    s, c = np.sin(q1), np.cos(q1)
    Jr = np.array([[0, s, s], [0, -c, -c], [1, 0, 0]])
    derivative = np.array([[0, c, c], [0, s, s], [0, 0, 0]])  # of Jr by q1; by q2 and q3 it is zero
    kinematic = np.zeros((3, 3))
    kinematic[:, 0] = derivative.T @ m
    gamma = theory.cross_matrix(m).T / 2
    corrected = kinematic + Jr.T @ gamma @ Jr
    return [
        ("second entry of the first column, conventional", f"{kinematic[1, 0]:.4f} N m/rad"),
        ("second entry of the first row, conventional", f"{kinematic[0, 1]:.4f} N m/rad"),
        ("both entries, corrected: (c m1 + s m2) / 2", f"{corrected[1, 0]:.4f} N m/rad"),
        ("asymmetry of the corrected matrix", f"{_below(np.abs(corrected - corrected.T).max(), 1e-15)}"),
    ]


def experiments(robots: Path) -> Rows:
    """Look at both experiments at 5 ms, seed 0: corrected, conventional, and the laws beside them."""
    from examples.bowl_wiping import analysis as bowl_analysis
    from examples.bowl_wiping.experiment import EXPERIMENT as BOWL
    from examples.experiments.command import open_arm, read_traces
    from examples.parkour import analysis, trajectory
    from examples.parkour.experiment import EXPERIMENT as PARKOUR

    results = robots.parent  # build/, where make experiment writes both
    plate, ball = (open_arm(each, robots / each.tool.robot) for each in (BOWL, PARKOUR))
    bowl = bowl_analysis.findings(plate, list(read_traces(BOWL, results / BOWL.name).values()))
    traces = read_traces(PARKOUR, results / PARKOUR.name)
    found = {law: analysis.findings(ball, law, trace) for law, trace in traces.items()}
    board, shift = found["conventional"], trajectory.compare(ball)
    board_closed_form_error = max(each.closed_form_error for each in found.values())
    board_contact = min(each.contact for each in found.values())
    return [
        ("antisymmetric part, corrected, every entry", _stiffness_below(bowl.antisymmetric_entry[0]),
         _stiffness_below(found["corrected"].symmetric_entry)),
        ("antisymmetric part, conventional, largest singular value", f"{bowl.antisymmetric[1]:.1f} N m/rad",
         f"{board.antisymmetric:.2f} N m/rad"),
        ("conventional less its closed form J_r^T [m]x J_r / 2", _stiffness_below(max(bowl.closed_form_error)),
         _stiffness_below(board_closed_form_error)),
        ("largest moment at the tool point", f"{max(bowl.largest_moment):.1f} N m", f"{board.moment:.2f} N m"),
        ("contact, of the samples", f"{min(bowl.contact):.0%}", f"{board_contact:.0%}"),
        ("torque of the correction, at most", "", f"{board.correction_torque:.1g} N m"),
        ("work beyond the controller's bound, largest", _excess(bowl.excess), _excess(found["potential"].excess)),
        ("replayed below recorded trajectory", "", f"{-1e3 * shift.mean[2]:.2f} mm"),
    ]  # fmt: skip


def _stiffness_below(value: float) -> str:
    """Return a stiffness that is zero up to rounding."""
    return _below(value, 1e-12) + " N m/rad"


def _excess(work: float) -> str:
    """Return work [J] beyond a bound."""
    return "none" if work <= 0.0 else f"{work:.1e} J"


def per_moment(robots: Path) -> Rows:
    """Measure the conventional stiffness under 1 N m about each base axis, at the flange, every 20th sample."""
    robot = _iiwa()
    rows: Rows = []
    for name, folder, file in (
        ("bowl", "bowl_wiping", "zero_force_trajectory.csv"),
        ("parkour", "parkour", "recorded_trajectory.csv"),
    ):
        q = _postures(ROOT / "examples" / folder / file)
        moments = np.hstack([np.zeros((3, 3)), np.eye(3)])  # (3, 6): a wrench per axis
        K = robot.hybrid.joint_stiffness_uncorrected(q[:, None], moments, TASK_STIFFNESS)  # (postures, 3, 7, 7)
        turned = np.swapaxes(K, -1, -2)
        odd, even = (np.linalg.norm(part, 2, axis=(-2, -1)) for part in ((K - turned) / 2, (K + turned) / 2))
        rows.append((name, f"{odd.min():.2f} to {odd.max():.2f}", f"{even.min():.0f} to {even.max():.0f}"))
    return rows


def _postures(file: Path) -> Array:
    """Return every 20th posture of a trajectory (postures, 7) [rad]; its file has a row per joint."""
    return np.asarray(np.loadtxt(file, delimiter=",").T[::EVERY])


def symmetrising(robots: Path) -> Rows:
    """Compute the symmetric part of the conventional matrix less the corrected one, on the bowl's path."""
    robot = _iiwa()
    q = _postures(energy_cycle.TRAJECTORY)
    rows = []
    for name, wrench in (("moment alone", np.r_[np.zeros(3), 4, -3, 8.0]), ("force and moment", energy_cycle.WRENCH)):
        row = [name]
        for representation in ("hybrid", "body", "spatial"):
            kernels = getattr(robot, representation)
            K = kernels.joint_stiffness_uncorrected(q, wrench, TASK_STIFFNESS)
            symmetric = (K + np.swapaxes(K, -1, -2)) / 2
            corrected = kernels.joint_stiffness(q, wrench, TASK_STIFFNESS)
            row.append(_below(np.abs(symmetric - corrected).max(), 1e-12))
        rows.append(tuple(row))
    return rows


def spatial_term(robots: Path) -> Rows:
    """Compare one spring in two representations: joint stiffness of the spatial form less the hybrid one."""
    robot = _iiwa()
    q = _postures(energy_cycle.TRAJECTORY)
    K = robot.hybrid.joint_stiffness(q, energy_cycle.WRENCH, TASK_STIFFNESS)
    rows: Rows = []
    for name, as_tensor in (("with the covariant term", False), ("without it, as in the paper's spatial form", True)):
        pose = robot.forward_kinematics(q)
        wrench, moved = stiffgen.move_stiffness(
            pose, energy_cycle.WRENCH, TASK_STIFFNESS, "hybrid", "spatial", as_tensor=as_tensor
        )
        worst = float(np.abs(robot.spatial.joint_stiffness(q, wrench, moved) - K).max())
        rows.append((name, f"{_below(worst, 1e-10)} N m/rad"))
    return rows


def secant(robots: Path) -> Rows:
    """Use a tangent as a secant: one joint on a spring, and laps of the iiwa 14 under a constant wrench."""
    rows: Rows = []
    for degrees in (20, 60, 90, 120):
        spring = theory.pendulum_spring(np.radians([degrees]))
        torque, as_secant = -spring["torque"][0], -spring["secant_law"][0]
        rows.append((f"one joint at {degrees} deg, torque / k", f"{torque:.2f}", f"{as_secant:.2f}"))
    robot, q = _iiwa(), energy_cycle.centre()
    for u, v in energy_cycle.PLANES:
        of_gradient, of_tangent = (
            energy_cycle.following(robot, q, (u, v), energy_cycle.RADIUS, law)[-1] for law in ("gradient", "corrected")
        )
        name = f"lap of joints {u + 1}, {v + 1}, work [J]"
        rows.append((name, _below(abs(of_gradient), 1e-12), f"{of_tangent:.1e}"))
    return rows


_TOOL_POINT = (0.0, 0.0, 0.24)
"""[m] Tool point of the bowl's plate from the flange, 0.275 m from joint 7."""
_PAYLOAD = np.array([1.3, 0.0, 0.0, 1.3 * 0.09])
"""Tool of 1.3 kg, its centre of mass 90 mm beyond the sensor."""


def wrenches(robots: Path) -> Rows:
    """Compare Kq under wrongly declared readings, and that of the published client, with Kq on the bowl's path."""
    true, client = _felt(), _model("link_7")
    # how the reading is declared, and the payload that is taken off
    wrong = {
        "the other sign": (_felt(sign="robot"), -_PAYLOAD),
        "moment left at the sensor": (_felt(_TOOL_POINT), _PAYLOAD),
        "weight of the tool left in": (true, np.zeros(4)),
    }
    # errors of moment [N m] and stiffness (share), posture by posture
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in (*wrong, "the published client")}
    random, no_bias = np.random.default_rng(0), np.zeros(6)
    for q in _postures(energy_cycle.TRAJECTORY):
        wrench = random.uniform(-1, 1, 6) * [20, 20, 20, 2, 2, 2]  # [N], [N m]
        right = np.array(true.hybrid.joint_stiffness(q, wrench, TASK_STIFFNESS))
        reading = true.sensor.reading(q, wrench, no_bias, _PAYLOAD)
        for name, (declared, payload) in wrong.items():
            taken = np.array(declared.sensor.tip_wrench(q, reading, no_bias, payload)).ravel()
            stiffness = np.array(true.hybrid.joint_stiffness(q, taken, TASK_STIFFNESS))
            found[name].append((np.abs((taken - wrench)[3:]).max(), _share_off(stiffness, right)))
        found["the published client"].append((np.nan, _share_off(_client_stiffness(client, q, wrench), right)))
    rows: Rows = []
    for name, values in found.items():
        (moment, median), (_, worst) = np.median(values, axis=0), np.max(values, axis=0)
        rows.append((name, "" if np.isnan(moment) else f"{moment:.1f} N m", f"{median:.1%}", f"{worst:.1%}"))
    return rows


def _model(tip: str = "link_ee", **options: Any) -> stiffgen.StiffnessModel:
    """Return the iiwa 14 up to a link, without masses."""
    return stiffgen.StiffnessModel(stiffgen.load_chain(ROOT / "urdf" / "iiwa14.urdf", tip=tip, masses=False, **options))


def _felt(xyz: tuple[float, float, float] = (0.0, 0.0, 0.0), sign: Any = "environment") -> stiffgen.StiffnessModel:
    """Return the iiwa 14 up to the plate's tool point, with a sensor at a place of the flange [m] and of a sign."""
    return _model(tool=stiffgen.Tool(xyz=_TOOL_POINT), sensor=stiffgen.Sensor("link_ee", xyz, sign=sign))


def _share_off(stiffness: Array, right: Array) -> float:
    """Return the largest error of an entry as a share of the largest entry."""
    return float(np.abs(stiffness - right).max() / np.abs(right).max())


def _client_stiffness(client: stiffgen.StiffnessModel, q: Array, wrench: Array) -> Array:
    """Return Kq as the published client computes it: a Jacobian whose lever to the tool point stays in base axes."""
    J = np.array(client.hybrid.jacobian(q))  # of link 7
    lever = np.array([0, 0, 0.035 + _TOOL_POINT[2]])  # [m] from joint 7 to the tool point
    moved = np.vstack([J[:3] - theory.cross_matrix(lever) @ J[3:], J[3:]])
    matrix = TASK_STIFFNESS + np.array(client.hybrid.connection_correction(wrench))
    kinematic = np.array(client.hybrid.kinematic_stiffness(q, wrench))
    return np.asarray(kinematic + moved.T @ matrix @ moved)


def compliance(robots: Path) -> Rows:
    """Compare the tip's compliance with the load's terms and without them with solved equilibria."""
    from examples import tip_compliance

    return tip_compliance.rows(_iiwa())


def stiff_postures(robots: Path) -> Rows:
    """Compare postures at the ends of self-motions: least torque, and stiffest under the load."""
    from examples import stiff_postures

    return stiff_postures.rows(stiff_postures.arms(_iiwa(), stiff_postures.panda()))


def flutter(robots: Path) -> Rows:
    """Push a ball joint at its target: three position drives, and the gradient of an energy, in MuJoCo."""
    from examples import flutter

    return flutter.rows()


SECTIONS: dict[str, tuple[Callable[[Path], Rows], tuple[str, ...]]] = {
    "appendix": (appendix, ("quantity", "value")),
    "experiments": (experiments, ("quantity", "bowl", "parkour")),
    "per moment": (per_moment, ("trajectory", "antisymmetric part [N m/rad]", "symmetric part [N m/rad]")),
    "symmetrising": (symmetrising, ("wrench", "hybrid", "body", "spatial")),
    "spatial term": (spatial_term, ("conversion of the task stiffness", "largest difference")),
    "wrench": (wrenches, ("mistake", "moment off by, median", "Kq off by, median", "Kq off by, at most")),
    "secant": (secant, ("case", "gradient", "tangent as secant")),
    "flutter": (flutter, ("target", "damping ratio", "limit of three drives", "three drives", "gradient")),
    "compliance": (
        compliance,
        (
            "motors [N m/rad]",
            "without the load's terms",
            "C = J H^-1 J^T",
            "solved",
            "smallest eigenvalue of H [N m/rad]",
        ),
    ),
    "stiff postures": (stiff_postures, ("arm", "start", "least torque", "stiffest", "between both [rad]")),
}
"""Tables of the page: function and head of the columns."""


def _below(value: float, bound: float) -> str:
    """Return "0", "below" a bound, or the number: rounding differs between machines."""
    if value == 0:
        return "0"
    return f"below {bound:.0e}" if value < bound else f"{value:.2g}"


def _iiwa() -> ModuleType:
    from generated import iiwa14

    return iiwa14


def table(section: str, robots: Path = ROBOTS) -> str:
    """Return a section's table in Markdown.

    Raises:
        StiffgenError: a robot is not there.

    """
    compute, head = SECTIONS[section]
    rows = [head, ("---",) * len(head), *compute(robots)]
    return "".join("| " + " | ".join(row) + " |\n" for row in rows)


def replaced(text: str, section: str, made: str) -> str:
    """Return the page's text with a section's table replaced."""
    before, start, rest = text.partition(f"<!-- {section} -->\n")
    _, end, after = rest.partition(f"<!-- end of {section} -->")
    return before + start + made + end + after


def main() -> int:
    """Print the tables of the chosen sections, and write them into the page with --write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--write", action="store_true", help="replace the tables in docs/results.md")
    options = parser.parse_args()
    text = PAGE.read_text()
    for section in options.sections or SECTIONS:
        if section not in SECTIONS:
            parser.error(f"no section {section!r}; there are {', '.join(SECTIONS)}")
        try:
            made = table(section)
        except StiffgenError as error:
            print(f"results: {error}", file=sys.stderr)
            return 2
        print(f"{section}\n\n{made}")
        text = replaced(text, section, made)
    if options.write:
        PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
