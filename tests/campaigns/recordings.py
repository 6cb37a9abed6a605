# SPDX-License-Identifier: MIT
"""Estimate the antisymmetric part of the conventional joint stiffness from recordings of a real arm.

    python tests/campaigns/recordings.py FOLDER [--figure FILE.svg] [--postures 50]

FOLDER holds RobotData_*.txt of DiffusionBasedImpedanceLearning (Data/Parkour, MIT): pose of the flange of a LBR iiwa,
equilibrium, and an ATI sensor's reading less its first sample, turned into base axes, every 5 ms. Nothing of it is
committed. What is inferred:

- q, by inverse kinematics. The posture that the pose leaves open is the one nearest to a posture of the paper's parkour
  trajectory; --postures of them, spread over it, give the interval.
- the payload, by least squares from the recording of free motion; each recording's bias from its own free beginning.
  What both leave unexplained in the free motion is the standard deviation of a reading.

Each row names the largest moment, the largest singular value of the antisymmetric part with two standard deviations,
and the work that this part puts out in one lap of the piece of the path that nearly closes, closed by a straight line,
with the spring at rest at the piece's mean posture and the wrench at its mean. With the corrected stiffness it is 0.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import stiffgen
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.arms.loads import stiffness_deviation, tip_covariance
from support.project import ROOT

TRAJECTORY = ROOT / "examples" / "parkour" / "recorded_trajectory.csv"
FREE = "Free"
"""Name of the recording without contact."""
CONTACT = 1.0
"""[N] Change of the force, less the payload's, that ends a recording's free beginning."""
BEFORE = 0.2
"""[s] before it in which the contact may have begun."""
SETTLED = 0.1
"""[s] The first samples are those of a filter that has not settled."""
BLOCKS = 12
"""Parts of the free motion that are left out in turn for the payload's interval: neighbours are alike."""
LEAST_LAP, LEAST_TIME = 0.5, 1.0
"""[rad] and [s] of a piece of the path that counts as a lap."""
HEAD = ("recording", "largest moment [N m]", "antisymmetric part, at most [N m/rad]", "by the posture [N m/rad]",
        "lap [rad], gap [rad]", "work of a lap [mJ]")  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """Poses of the flange (N, 4, 4), readings of the sensor in its axes (N, 6) and time (N); no joint positions."""

    name: str
    time: FloatArray
    poses: FloatArray
    reading: FloatArray

    @property
    def settled(self) -> int:
        """First sample that counts."""
        return int(np.searchsorted(self.time, self.time[0] + SETTLED))


def read_recording(file: Path) -> Recording:
    """Read a text file of named columns, one row a sample, in SI units."""
    columns = file.read_text().split("\n", 1)[0].split()
    rows = np.loadtxt(file, skiprows=1)

    def named(*names: str) -> FloatArray:
        return np.stack([rows[:, columns.index(name)] for name in names], axis=1)

    axis = named("u_x", "u_y", "u_z")
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turns = Rotation.from_rotvec(axis * named("theta")).as_matrix()
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns, named("x", "y", "z")
    base = np.stack([named("f_x", "f_y", "f_z"), named("m_x", "m_y", "m_z")], axis=1)
    return Recording(file.stem.split("_")[1], rows[:, columns.index("time")], poses, (base @ turns).reshape(-1, 6))


def solve_postures(robot: ModuleType, poses: FloatArray, near: FloatArray) -> FloatArray:
    """Return the joint positions (N, n) at poses (N, 4, 4) that are nearest to a posture (n).

    Raises:
        ArithmeticError: a pose is not reached.

    """
    q = np.tile(near, (len(poses), 1))
    for _ in range(80):
        at, J = robot.forward_kinematics(q), robot.hybrid.jacobian(q)
        turn = Rotation.from_matrix(poses[:, :3, :3] @ np.swapaxes(at[:, :3, :3], 1, 2)).as_rotvec()
        error = np.concatenate([poses[:, :3, 3] - at[:, :3, 3], turn], axis=1)
        back = near - q
        across = error - np.einsum("kij,kj->ki", J, back)
        step = back + np.einsum("kji,kj->ki", J, np.linalg.solve(J @ np.swapaxes(J, 1, 2), across[..., None])[..., 0])
        q += step * np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        if np.abs(error).max() < 1e-9 and np.abs(step).max() < 1e-7:
            return q
    raise ArithmeticError(f"inverse kinematics: {np.abs(error).max():.2g} m or rad are left")


@dataclass(frozen=True)
class Payload:
    """Payload (4) [kg, kg m] with two standard deviations, and standard deviations of a reading (6) in free motion."""

    values: FloatArray
    interval: FloatArray
    deviation: FloatArray


def estimate_payload(sensor: ModuleType, q: FloatArray, reading: FloatArray) -> Payload:
    """Return the payload that fits readings in free motion, whose bias is not known either."""
    none = np.zeros(6)
    weights = np.swapaxes(sensor.reading(q[:, None, :], none, none, np.eye(4)), 1, 2)
    X = np.concatenate([weights, np.broadcast_to(np.eye(6), (len(q), 6, 6))], axis=2)

    def fit(rows: NDArray[np.int_]) -> FloatArray:
        return np.asarray(np.linalg.lstsq(X[rows].reshape(-1, 10), reading[rows].ravel(), rcond=None)[0])

    found, every = fit(np.arange(len(q))), np.arange(len(q))
    without = np.array([fit(np.setdiff1d(every, part)) for part in np.array_split(every, BLOCKS)])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return Payload(found[:4], 2.0 * spread[:4], (reading - X @ found).std(axis=0))


def find_contact(recording: Recording, force: FloatArray) -> int:
    """Return the number of samples before contact; force (N, 3): less the payload's, with a bias."""
    start = recording.settled
    away = np.linalg.norm(force - np.median(force[start : 2 * start], axis=0), axis=1)[start:] > CONTACT
    end = recording.time[start + int(np.argmax(away))] - BEFORE if away.any() else np.inf
    return max(start + 1, int(np.searchsorted(recording.time, end)))


def antisymmetric_part(robot: ModuleType, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return (K - K^T) / 2 of the conventional joint stiffness; the task stiffness has no part in it."""
    K = robot.hybrid.joint_stiffness_uncorrected(q, wrench, np.zeros((6, 6)))
    return np.asarray((K - np.swapaxes(K, 1, 2)) / 2)


def find_lap(q: FloatArray, time: FloatArray, every: int = 10) -> tuple[int, int]:
    """Return first and last sample of the piece of a path whose gap is the smallest share of its length."""
    path, at = q[::every], time[::every]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])[::every]
    long = (length[None] - length[:, None] > LEAST_LAP) & (at[None] - at[:, None] > LEAST_TIME)
    if not long.any():
        raise ArithmeticError(f"the path is shorter than {LEAST_LAP} rad")
    gap = np.linalg.norm(path[:, None] - path[None], axis=2)
    share = np.where(long, gap / np.where(long, length[None] - length[:, None], 1.0), np.inf)
    first, last = np.unravel_index(int(share.argmin()), share.shape)
    return int(first) * every, int(last) * every


def lap_work(robot: ModuleType, q: FloatArray, wrench: FloatArray) -> float:
    """Return the work [J] of the antisymmetric part in one lap of q (N, n), closed by a straight line.

    The spring is at rest at the mean of q, under one wrench (6).
    """
    lap = np.concatenate([q, np.linspace(q[-1], q[0], 100)[1:]])
    torque = np.einsum(
        "kij,kj->ki", antisymmetric_part(robot, lap, np.tile(wrench, (len(lap), 1))), q.mean(axis=0) - lap
    )
    return float(np.einsum("ki,ki->", (torque[1:] + torque[:-1]) / 2, np.diff(lap, axis=0)))


@dataclass(frozen=True)
class Found:
    """What a recording shows: over time, and its lap."""

    name: str
    time: FloatArray
    moment: FloatArray
    value: FloatArray
    deviation: FloatArray
    least: FloatArray
    most: FloatArray
    lap: float
    gap: float
    work: tuple[float, float]

    def row(self) -> tuple[str, ...]:
        """Return the cells of the table."""
        k = int(self.value.argmax())
        return (
            f"{self.name}, {self.time[-1]:.1f} s", f"{self.moment.max():.1f}",
            f"{self.value[k]:.2f} +- {2 * self.deviation[k]:.2f}", f"{self.least[k]:.2f} to {self.most[k]:.2f}",
            f"{self.lap:.1f}, {self.gap:.2f}",
            f"{1e3 * min(self.work):.1f} to {1e3 * max(self.work):.1f}",
        )  # fmt: skip


def analyse(robot: ModuleType, recording: Recording, payload: Payload, references: FloatArray) -> Found:
    """Compute what a recording shows for postures near each reference (P, n); the first one gives the values."""
    sizes, works = [], []
    reading, settled, none = recording.reading, recording.settled, np.zeros(6)
    for k, near in enumerate(references):
        q = solve_postures(robot, recording.poses, near)
        free = find_contact(recording, (reading - robot.sensor.reading(q, none, none, payload.values))[:, :3])
        bias = stiffgen.tare(robot.sensor, q[settled:free], reading[settled:free], payload.values)
        wrench = robot.sensor.tip_wrench(q, reading, bias, payload.values)
        wrench[:settled] = wrench[settled]
        sizes.append(np.linalg.norm(antisymmetric_part(robot, q, wrench), 2, axis=(1, 2)))
        if k == 0:
            covariance = tip_covariance(robot, q, np.diag(payload.deviation**2))
            spread = stiffness_deviation(robot, q, wrench, np.zeros((6, 6)), covariance).antisymmetric_deviation
            moment = np.linalg.norm(wrench[:, 3:], axis=1)
            lap = slice(*find_lap(q, recording.time))
            length = float(np.linalg.norm(np.diff(q[lap], axis=0), axis=1).sum())
            gap = float(np.linalg.norm(q[lap][-1] - q[lap][0]))
        works.append(lap_work(robot, q[lap], wrench[lap].mean(axis=0)))
    least, most = np.min(sizes, axis=0), np.max(sizes, axis=0)
    return Found(recording.name, recording.time - recording.time[0], moment, sizes[0], spread, least, most, length, gap,
                 (min(works), max(works)))  # fmt: skip


def draw(found: Sequence[Found], file: Path) -> None:
    """Draw the antisymmetric part over time, with its interval, of recordings with contact."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from stiffgen.lab.style import CONVENTIONAL, CORRECTED, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(8.4, 2.0 * len(found)), layout="constrained")
        for panel, each in zip(np.atleast_1d(drawing.subplots(len(found), 1, sharey=True)), found, strict=True):
            every = slice(None, None, 10)
            low, high = each.least - 2 * each.deviation, each.most + 2 * each.deviation
            panel.fill_between(each.time[every], np.maximum(low, 0)[every], high[every], color=CONVENTIONAL, alpha=0.35,
                               linewidth=0)  # fmt: skip
            panel.plot(each.time[every], each.value[every], color=CONVENTIONAL, label="conventional")
            panel.plot(each.time[every], 0 * each.time[every], color=CORRECTED, label="corrected: 0")
            panel.set_ylabel(f"{each.name}\n[N m/rad]")
        drawing.axes[0].legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, ncols=3)
        drawing.axes[-1].set_xlabel("time [s]")
        file.write_text(themed_svg(drawing), encoding="utf-8")


def table(found: Sequence[Found]) -> str:
    """Return the table of docs/results.md."""
    return "".join("| " + " | ".join(row) + " |\n" for row in (HEAD, ("---",) * len(HEAD), *(f.row() for f in found)))


def main(given: Iterable[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--figure", type=Path, help="SVG file to draw")
    parser.add_argument("--postures", type=int, default=50, help="of the parkour's trajectory (%(default)s)")
    options = parser.parse_args(None if given is None else list(given))
    files = sorted(options.folder.glob("RobotData_*.txt")) if options.folder else []
    if not files:
        print("recordings: give the folder with RobotData_*.txt; they are not committed", file=sys.stderr)
        return 0 if options.folder is None or not options.folder.exists() else 2
    sensor = stiffgen.Sensor("link_ee", sign="environment")
    robot = stiffgen.load(ROOT / "urdf" / "iiwa14.urdf", sensor=sensor).module
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",").T
    references = trajectory[np.linspace(0, len(trajectory) - 1, options.postures).astype(int)]
    recordings = [read_recording(file) for file in files]
    moving = next(each for each in recordings if each.name == FREE)
    q = solve_postures(robot, moving.poses, references[0])[moving.settled :]
    payload = estimate_payload(robot.sensor, q, moving.reading[moving.settled :])
    print(f"payload of {moving.name}: mass {payload.values[0]:.4f} +- {payload.interval[0]:.4f} kg, first moment "
          f"{payload.values[1:].round(4)} +- {payload.interval[1:].round(4)} kg m; standard deviation of a reading "
          f"{payload.deviation[:3].max():.3f} N, {payload.deviation[3:].max():.3f} N m")  # fmt: skip
    found = []
    for each in recordings:
        found.append(analyse(robot, each, payload, references))
        print(f"{each.name}: {len(references)} postures", flush=True)
    print("\n" + table(found))
    if options.figure:
        draw([each for each in found if each.moment.max() > 1.0], options.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main())
