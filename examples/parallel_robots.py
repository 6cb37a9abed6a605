# SPDX-License-Identifier: MIT
"""Compute the stiffness of the motors of three robots with closed loops: Cassie's leg, a five-bar and a Delta.

Each robot bears a load, and its tip is held by a spring. The example compares the stiffness of the motors with
G^T Kq G, which leaves the kinematic stiffness of the closure out:

- the left leg of Cassie (examples/cassie_leg.xml) under the robot's weight, over the angle of the knee: the coupling
  of the knee's motor with the leaf spring of the heel, which counts as a motor here;
- a planar five-bar with two motors, which carries 3 kg along a horizontal line;
- a Delta with three motors and a payload of 4 kg, over its height.

With --figure FILE the example draws the robots and the comparisons (needs matplotlib: pip install -e
'.[examples]'). The leg is an MJCF file: pip install -e '.[mjcf]'.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import stiffgen

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from examples.closed_loops import model, stiffnesses

Array = NDArray[np.float64]
LEG = Path(__file__).with_name("cassie_leg.xml")
WEIGHT = 31 * 9.81
"""Weight of Cassie [N]."""
FOOT = -1.34
"""Angle of the foot's motor [rad]."""
DEFLECTION = 0.1
"""Deflection of the leaf spring of the heel [rad]."""
FIVE_BAR = [
    ("left", "ground", "0 0 0", "0 0 1"),
    ("left_rod", "left", "0.2 0 0", "0 0 1"),
    ("tip", "left_rod", "0.35 0 0", ""),
    ("right", "ground", "0.3 0 0", "0 0 1"),
    ("right_rod", "right", "0.2 0 0", "0 0 1"),
]
ARMS = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
"""Angles of the Delta's arms about the vertical [rad]; motors at 0.2 m, arms of 0.3 m, rods of 0.7 m, joints at 0.08 m
on the platform."""


class Loaded(NamedTuple):
    """A robot, the wrench on its tip [N, N m], the task stiffness there [N/m, N m/rad], and where the motors start."""

    robot: stiffgen.StiffnessModel
    wrench: Array
    task: Array
    start: Array


def leg() -> Loaded:
    """Return the leg, whose foot bears the weight; motors: knee, heel spring and crank."""
    motors = ["knee", "heel_spring", "crank"]
    chain = stiffgen.load_chain(LEG, tip="sole", masses=False, close_loops=True, actuated=motors)
    robot = stiffgen.StiffnessModel(chain)
    return Loaded(robot, np.array([0, 0, WEIGHT, 0, 0, 0]), np.zeros((6, 6)), np.array(chain.start))


def five_bar() -> Loaded:
    """Return a five-bar in a vertical plane, y upwards: a payload of 3 kg and a spring of 400 N/m.

    The start is the branch with the tip above the motors.
    """
    loop = ["left_rod:0.35,0,0=right_rod:0.35,0,0"]
    robot = model(FIVE_BAR, "tip", loop, ["left", "right"])
    left, right = five_bar_motors(np.array([0.15]), 0.4)[0]
    rods = np.angle([0.15 + 0.4j - 0.2 * np.exp(1j * left), -0.15 + 0.4j - 0.2 * np.exp(1j * right)]) - [left, right]
    start = np.array([left, rods[0], right, rods[1]])
    return Loaded(robot, np.array([0, -3 * 9.81, 0, 0, 0, 0]), np.diag([400.0, 400, 400, 0, 0, 0]), start)


def delta() -> Loaded:
    """Return a Delta: its platform moves on three slides without a motor, each rod has two hinges at its arm."""
    links = [("x", "ground", "0 0 -0.6", "1 0 0"), ("y", "x", "0 0 0", "0 1 0"), ("tip", "y", "0 0 0", "0 0 1")]
    loops = []
    for k, angle in enumerate(ARMS):
        c, s = math.cos(angle), math.sin(angle)
        across = f"{-s!r} {c!r} 0"
        links.append((f"arm{k}", "ground", f"{0.2 * c!r} {0.2 * s!r} 0", across))
        links.append((f"swing{k}", f"arm{k}", f"{0.3 * c!r} {0.3 * s!r} 0", across))
        links.append((f"rod{k}", f"swing{k}", "0 0 0", f"{c!r} {s!r} 0"))
        loops.append(f"rod{k}:0,0,-0.7=tip:{0.08 * c!r},{0.08 * s!r},0")
    robot = model(links, "tip", loops, ["arm0", "arm1", "arm2"], sliding=("x", "y", "tip"))
    spring, start = np.diag([500.0, 500, 500, 0, 0, 0]), np.array(robot.chain.start)
    return Loaded(robot, np.array([0, 0, -4 * 9.81, 0, 0, 0]), spring, start)


def _along(loaded: Loaded, motors: Array) -> tuple[Array, Array]:
    return stiffnesses(loaded.robot, motors, loaded.wrench, loaded.task, loaded.start)


def leg_results() -> tuple[Array, Array, Array]:
    """Return angles of the knee's motor [rad], and both couplings of that motor with the heel's spring."""
    loaded, angles = leg(), np.linspace(0.1, -2.0, 22)
    motors = np.stack([angles, np.full_like(angles, DEFLECTION), np.full_like(angles, FOOT)], axis=1)
    whole, without = _along(loaded, motors)
    return angles, whole[:, 0, 1], without[:, 0, 1]


def five_bar_motors(x: Array, y: float) -> Array:
    """Return the motors' angles at tips (x, y), elbows outwards."""
    angles = []
    for base, side in ((0.0, 1), (0.3, -1)):
        away = x - base + 1j * y
        inner = np.arccos((0.2**2 + np.abs(away) ** 2 - 0.35**2) / (0.4 * np.abs(away)))
        angles.append(np.angle(away) + side * inner)
    return np.stack(angles, axis=1)


def five_bar_results() -> tuple[Array, Array, Array]:
    """Return places of the tip on a horizontal line [m], and both stiffnesses of the left motor."""
    loaded, x = five_bar(), np.linspace(-0.05, 0.35, 33)
    whole, without = _along(loaded, five_bar_motors(x, 0.4))
    return x, whole[:, 0, 0], without[:, 0, 0]


def delta_results() -> tuple[Array, Array, Array]:
    """Return heights of the platform [m], and both stiffnesses of a motor; all motors stand at the same angle."""
    loaded, angles = delta(), np.linspace(-0.9, 1.0, 31)
    whole, without = _along(loaded, np.stack(3 * [angles], axis=1))
    across = 0.12 + 0.3 * np.cos(angles)
    return -0.3 * np.sin(angles) - np.sqrt(0.7**2 - across**2), whole[:, 0, 0], without[:, 0, 0]


def leg_lines(knee: float) -> list[Array]:
    """Return the leg's links as polygons in the plane of x and z [m]: x + 1j z."""
    robot = leg().robot
    q = np.array(robot.close([knee, DEFLECTION, FOOT], robot.chain.start)).ravel()
    angle = dict(zip((each.name for each in robot.chain.coordinates), q, strict=True))
    upper = np.exp(1j * knee)
    lower = upper * np.exp(1j * angle["tarsus"])
    ankle, heel = -0.12j + upper * (-0.30266 - 0.398j), 0.03266 + 0.11451j
    heel = ankle + lower * ((-0.03266 + 0.00549j) + np.exp(1j * DEFLECTION) * heel)
    crank, foot = ankle + lower * (-0.02008 - 0.06416j), ankle + lower * (0.0528 - 0.40654j)
    turned, sole = lower * np.exp(1j * FOOT), lower * np.exp(1j * angle["foot"])
    pin, toe = crank + turned * (0.01237 - 0.05359j), foot + sole * (0.01237 - 0.05359j)
    tip = foot + sole * (0.0461 + 0.00038j)
    links = [[0, -0.12j, ankle, foot, tip], [0, heel, ankle], [crank, pin, toe, foot]]
    return [np.array(link) for link in links]


def five_bar_lines(x: float) -> list[Array]:
    """Return the bars as a polygon: x + 1j y [m]."""
    left, right = five_bar_motors(np.array([x]), 0.4)[0]
    return [np.array([0, 0.2 * np.exp(1j * left), x + 0.4j, 0.3 + 0.2 * np.exp(1j * right), 0.3])]


def delta_lines(angle: float) -> list[Array]:
    """Return arms, rods and platform, seen from the side and a little from above: across + 1j up [m]."""
    height = -0.3 * math.sin(angle) - math.sqrt(0.7**2 - (0.12 + 0.3 * math.cos(angle)) ** 2)

    def seen(turn: float, radius: float, z: float) -> complex:
        c, s = math.cos(turn + 0.3), math.sin(turn + 0.3)
        return complex(radius * c, z + 0.3 * radius * s)

    arms = [[(0.2, 0), (0.2 + 0.3 * math.cos(angle), -0.3 * math.sin(angle)), (0.08, height)]] * 3
    lines = [np.array([seen(turn, *corner) for corner in arm]) for turn, arm in zip(ARMS, arms, strict=True)]
    for radius, z in ((0.2, 0.0), (0.08, height)):
        lines.append(np.array([seen(turn, radius, z) for turn in (*ARMS, ARMS[0])]))
    return lines


def figure() -> str:
    """Return the SVG text: the robots above, both stiffnesses below."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    coupling, stiffness = "knee and heel spring [N m/rad]", "stiffness of a motor [N m/rad]"
    columns = (
        ("Cassie's leg", leg_lines, (-1.2, 0.0), leg_results(), "knee [rad]", coupling),
        ("five-bar with 3 kg", five_bar_lines, (0.3, 0.0), five_bar_results(), "x of the tip [m]", stiffness),
        ("Delta with 4 kg", delta_lines, (-0.5, 0.6), delta_results(), "z of the platform [m]", stiffness),
    )
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.5, 6.4), layout="constrained")
        for pictures, (title, lines, poses, results, name, meaning) in zip(
            drawing.subplots(2, 3).T, columns, strict=True
        ):
            for pose, strength in zip(poses, (0.3, 1.0), strict=True):
                for line in lines(pose):
                    pictures[0].plot(line.real, line.imag, "o-", color=INK, alpha=strength, markersize=3)
            pictures[0].set(aspect="equal", title=title)
            pictures[0].axis("off")
            at, whole, without = results
            pictures[1].plot(at, whole, color=CORRECTED, label="with the closure's term")
            pictures[1].plot(at, without, "--", color=CONVENTIONAL, label="without")
            pictures[1].axhline(0, color=INK, linewidth=0.6)
            pictures[1].set(xlabel=name, ylabel=meaning)
        pictures[1].legend()
        return themed_svg(drawing)


def main() -> None:
    """Print the comparisons; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    for title, (at, whole, without) in (
        ("Cassie's leg, knee [rad]", leg_results()),
        ("five-bar, x [m]", five_bar_results()),
        ("Delta, z [m]", delta_results()),
    ):
        print(f"{title:>26}   stiffness [N m/rad]   without the closure's term")
        for row in list(zip(at, whole, without, strict=True))[::5]:
            print(f"{row[0]:26.2f} {row[1]:21.2f} {row[2]:28.2f}")
    if options.figure:
        options.figure.write_text(figure())


if __name__ == "__main__":
    main()
