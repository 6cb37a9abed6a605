# SPDX-License-Identifier: MIT
"""Compute the stiffness that motors feel through linkages: a four-bar, and a humanoid's ankle with two motors.

The stiffness of the motors is G^T (d2U/dq2 - sum of lambda_k d2c_k/dq2) G. It is common to leave the sum out, the
kinematic stiffness of the closure. The example computes both:

- a four-bar with a spring at its coupler and a weight of 50 N, over the angle of the crank;
- an ankle that carries a load of 400 N through its sole, 5 cm before the ankle, over the angle of both motors.

With --figure FILE the example draws the four-bar and both comparisons (needs matplotlib: pip install -e
'.[examples]').
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stiffgen

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

Array = NDArray[np.float64]
Link = tuple[str, str, str, str]
"""Link, its parent, origin of its joint in the parent [m], axis of the joint ("" for a fixed joint)."""

FOUR_BAR: list[Link] = [
    ("crank", "ground", "0 0 0", "0 0 1"),
    ("coupler", "crank", "0.15 0 0", "0 0 1"),
    ("rocker", "ground", "0.3 0 0", "0 0 1"),
    ("tip", "coupler", "0.2 0.1 0", ""),
]
FOUR_BAR_LOOP = ["coupler:0.35,0,0=rocker:0.25,0,0"]
ANKLE: list[Link] = [
    ("pitch", "shank", "0 0 -0.35", "0 1 0"),
    ("roll", "pitch", "0 0 0", "1 0 0"),
    ("sole", "roll", "0.05 0 -0.06", ""),
    ("left", "shank", "0 0.05 -0.05", "0 1 0"),
    ("left_swing", "left", "-0.05 0 0", "0 1 0"),
    ("left_rod", "left_swing", "0 0 0", "1 0 0"),
    ("right", "shank", "0 -0.05 -0.12", "0 1 0"),
    ("right_swing", "right", "-0.05 0 0", "0 1 0"),
    ("right_rod", "right_swing", "0 0 0", "1 0 0"),
]
ANKLE_LOOPS = ["left_rod:0,0,-0.3=roll:-0.05,0.05,0", "right_rod:0,0,-0.23=roll:-0.05,-0.05,0"]
WEIGHT = np.array([0, -50.0, 0, 0, 0, 0])  # wrench on the four-bar [N, N m]
SPRING = np.diag([100.0, 100.0, 100.0, 1.0, 1.0, 1.0])  # N/m and N m/rad
LOAD = np.array([0, 0, 400.0, 0, 0, 0])  # wrench of the ground on the sole [N, N m]
GROUND = np.diag([0.0, 0.0, 0.0, 20.0, 20.0, 0.0])  # N m/rad of a soft ground


def model(
    links: list[Link], tip: str, loops: list[str], actuated: list[str], sliding: Sequence[str] = ()
) -> stiffgen.StiffnessModel:
    """Return the functions of a linkage; joints are hinges, except those that are ``sliding``.

    A link is its name, its parent's, the place of its joint in the parent's frame "x y z" [m], and the joint's axis
    ("": welded).
    """
    kinds = dict.fromkeys(sliding, "prismatic") | {name: "fixed" for name, _, _, axis in links if not axis}
    text = "".join(
        f'<link name="{name}"/><joint name="{name}" type="{kinds.get(name, "continuous")}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{xyz}"/><axis xyz="{axis or "0 0 1"}"/>'
        '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        for name, parent, xyz, axis in links
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "linkage.urdf"
        file.write_text(f'<robot name="linkage"><link name="{links[0][1]}"/>{text}</robot>')
        chain = stiffgen.load_chain(file, tip=tip, masses=False, loop=loops, actuated=actuated)
    return stiffgen.StiffnessModel(chain)


def four_bar() -> stiffgen.StiffnessModel:
    """Return the four-bar of docs/loops.md."""
    return model(FOUR_BAR, "tip", FOUR_BAR_LOOP, ["crank"])


def ankle() -> stiffgen.StiffnessModel:
    """Return the ankle: pitch and roll, two cranks on the shank, and rods with two hinges each."""
    return model(ANKLE, "sole", ANKLE_LOOPS, ["left", "right"])


def stiffnesses(
    robot: stiffgen.StiffnessModel, motors: Array, wrench: Array, task: Array, start: Array | None = None
) -> tuple[Array, Array]:
    """Return the stiffness of the motors with and without the closure's term, at each row of motor positions."""
    whole, without, q = [], [], np.array(robot.chain.start) if start is None else start
    for motor in motors:
        q = np.array(robot.close(motor, q)).ravel()
        G, Kq = np.array(robot.motors.jacobian(q)), np.array(robot.hybrid.joint_stiffness(q, wrench, task))
        whole.append(np.array(robot.motors.joint_stiffness(q, wrench, task)))
        without.append(G.T @ Kq @ G)
    return np.array(whole), np.array(without)


def four_bar_results() -> tuple[Array, Array, Array]:
    """Return angles of the crank [rad], and both stiffnesses there [N m/rad]."""
    angles = np.linspace(0.3, 2.6, 47)
    whole, without = stiffnesses(four_bar(), angles[:, None], WEIGHT, SPRING)
    return angles, whole[:, 0, 0], without[:, 0, 0]


def ankle_results() -> tuple[Array, Array, Array]:
    """Return angles of both motors [rad], and both stiffnesses of the left motor [N m/rad]."""
    angles = np.linspace(-0.6, 0.6, 25)
    whole, without = stiffnesses(ankle(), np.stack([angles, angles], axis=1), LOAD, GROUND)
    return angles, whole[:, 0, 0], without[:, 0, 0]


def figure() -> str:
    """Return the SVG text: the four-bar at three angles, and both stiffnesses of four-bar and ankle."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.5, 3.4), layout="constrained")
        picture, left, right = drawing.subplots(1, 3)
        robot = four_bar()
        q = np.array(robot.chain.start)
        for angle, strength in ((0.6, 1.0), (1.0, 0.5), (1.4, 0.25)):
            q = np.array(robot.close(angle, q)).ravel()
            # Points of the plane as complex numbers [m]: crank 0.15, coupler 0.35 with the tip, rocker to (0.3, 0).
            elbow = 0.15 * np.exp(1j * q[0])
            end, tip = elbow + 0.35 * np.exp(1j * (q[0] + q[1])), elbow + (0.2 + 0.1j) * np.exp(1j * (q[0] + q[1]))
            bars, plate = np.array([0, elbow, end, 0.3]), np.array([elbow, tip, end])
            picture.plot(bars.real, bars.imag, "o-", color=INK, alpha=strength, markersize=4)
            picture.plot(plate.real, plate.imag, "-", color=CORRECTED, alpha=strength)
            picture.plot(tip.real, tip.imag, "x", color=CORRECTED, alpha=strength)
        picture.set(aspect="equal", title="four-bar at 0.6, 1.0, 1.4 rad", xlabel="x [m]", ylabel="y [m]")
        for axes, results, title, name in (
            (left, four_bar_results(), "four-bar with 50 N at its tip", "crank [rad]"),
            (right, ankle_results(), "ankle under 400 N, left motor", "both motors [rad]"),
        ):
            angles, whole, without = results
            axes.plot(angles, whole, color=CORRECTED, label="with the closure's term")
            axes.plot(angles, without, "--", color=CONVENTIONAL, label="without")
            axes.axhline(0, color=INK, linewidth=0.6)
            axes.set(title=title, xlabel=name, ylabel="stiffness of the motor [N m/rad]")
        left.legend()
        return themed_svg(drawing)


def main() -> None:
    """Print both comparisons; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    for title, results in (("four-bar, crank", four_bar_results()), ("ankle, both motors", ankle_results())):
        print(f"{title} [rad]   stiffness [N m/rad]   without the closure's term")
        for angle, whole, without in list(zip(*results, strict=True))[::6]:
            print(f"{angle:22.2f} {whole:21.2f} {without:28.2f}")
    if options.figure:
        options.figure.write_text(figure())


if __name__ == "__main__":
    main()
