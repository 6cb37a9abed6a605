# SPDX-License-Identifier: MIT
"""Compute the net work of three laws round closed joint-space orbits: corrected, conventional, gradient of an energy.

This is the paper's problem statement for slow motions. A spring with the torque field tau = -K dq returns the energy
that it received exactly if K is symmetric. Otherwise, round a circle of radius r in the plane of unit directions u
and v,

    W = integral of tau . dq = integral over the area of the antisymmetric part = 2 pi r^2 u^T A v,   A = (K - K^T)/2.

The example computes three cases on the iiwa 14:

- The stiffness is constant, that of one configuration and wrench: the problem statement itself.
- The stiffness follows the configuration at a constant wrench, as in a controller that measures a wrench. The corrected
  law is then not conservative either, since K varies along the orbit, but its work grows with r^3, not r^2.
- The torque is that of a spring at the tip (iiwa14.spring) with the same gains and, at the orbit's centre, the same
  wrench. It is the gradient of an energy at every configuration, so that no orbit gains or loses energy.

With --figure FILE the example writes energy_cycle.svg (needs matplotlib: pip install -e '.[examples]').
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

Array = NDArray[np.float64]

TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
TASK_STIFFNESS = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])  # N/m and N m/rad
WRENCH = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])  # N and N m, applied by the environment, held
PLANES = ((0, 2), (4, 5), (1, 3), (2, 6))  # joint pairs (0-based) that span the orbits
RADIUS = 0.1  # rad
STEPS = 20000
FORMULAS = {"corrected": "joint_stiffness", "conventional": "joint_stiffness_uncorrected"}
LAWS = (*FORMULAS, "gradient")


def centre() -> Array:
    """Return the configuration (n,) in the middle of the paper's zero-force trajectory [rad]."""
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",")
    return np.asarray(trajectory[:, trajectory.shape[1] // 2])


def orbit(plane: tuple[int, int], radius: float, steps: int = STEPS) -> Array:
    """Return displacements (steps + 1, n) round a circle through zero, first along u, then towards v [rad]."""
    phase = 2 * np.pi * np.arange(steps + 1)[:, None] / steps
    u, v = np.eye(7)[list(plane)]
    return np.asarray(radius * (np.sin(phase) * u + (1 - np.cos(phase)) * v))


def work(torque: Array, displacement: Array) -> Array:
    """Return the work [J] of torques (N, n) [N m] up to each point of an orbit (N, n) [rad]: trapezoidal rule."""
    middle = (torque[1:] + torque[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(np.einsum("ti,ti->t", middle, np.diff(displacement, axis=0)))])


def stiffness(robot: ModuleType, q: Array, formula: str) -> Array:
    """Return Kq (..., n, n) at configurations (..., n) and the constant wrench [N m/rad]."""
    return np.asarray(getattr(robot.hybrid, FORMULAS[formula])(q, WRENCH, TASK_STIFFNESS))


def held(robot: ModuleType, q: Array, plane: tuple[int, int], radius: float, formula: str) -> Array:
    """Return the work round an orbit about q with a constant stiffness."""
    displacement = orbit(plane, radius)
    return work(-displacement @ stiffness(robot, q, formula).T, displacement)


def following(robot: ModuleType, q: Array, plane: tuple[int, int], radius: float, law: str) -> Array:
    """Return the work round an orbit about q with the torque of each configuration; less the gradient's load at q."""
    displacement = orbit(plane, radius)
    if law == "gradient":
        spring = (rest(robot, q), TASK_STIFFNESS[:3, :3], TASK_STIFFNESS[3:, 3:])
        return work(robot.spring.torque(q + displacement, *spring) - robot.spring.torque(q, *spring), displacement)
    K = stiffness(robot, q + displacement, law)
    return work(-np.einsum("tij,tj->ti", K, displacement), displacement)


def rest(robot: ModuleType, q: Array) -> Array:
    """Return the equilibrium (4, 4) from which the spring, deflected to q, has the wrench WRENCH.

    The trace spring with Ko = k 1 has the moment k sin(angle) axis. The equilibrium is the pose turned back by that
    angle about that axis (Rodrigues), and moved back by the force over the stiffness.
    """
    pose = np.array(robot.forward_kinematics(q))
    turned = WRENCH[3:] / TASK_STIFFNESS[3, 3]  # sin(angle) axis
    sine, cosine = np.linalg.norm(turned), np.sqrt(1 - turned @ turned)
    x, y, z = turned / sine
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # cross-product matrix of the axis
    back = np.eye(3) - sine * W + (1 - cosine) * W @ W
    pose[:3, 3] -= WRENCH[:3] / np.diag(TASK_STIFFNESS)[:3]
    pose[:3, :3] = back @ pose[:3, :3]
    return pose


def area_integral(robot: ModuleType, q: Array, plane: tuple[int, int], radius: float, formula: str) -> float:
    """Return the net work of :func:`held` by the closed form [J]."""
    K = stiffness(robot, q, formula)
    u, v = plane
    return float(np.pi * radius**2 * (K[u, v] - K[v, u]))


def table(robot: ModuleType, q: Array) -> None:
    """Print the net work [J] of orbits in all planes of two joints, and how it grows with the orbit's radius."""
    print(f"iiwa14 at q [rad] = {np.round(q, 3)}")
    print(f"wrench applied by the environment [N, N m] = {WRENCH}; orbits of radius {RADIUS} rad")
    print("\nstiffness held: net work and area integral [J]")
    print("joints   " + "".join(f"{formula:>14s}{'integral':>12s}" for formula in FORMULAS))
    # by Stokes' theorem the work round an orbit is the area integral of the antisymmetric part
    for u, v in PLANES:
        row = f"{u + 1}, {v + 1}     "
        for formula in FORMULAS:
            row += f"{held(robot, q, (u, v), RADIUS, formula)[-1]:14.1e}"
            row += f"{area_integral(robot, q, (u, v), RADIUS, formula):12.6f}"
        print(row)
    print("\ntorque of each posture: net work [J]")
    print("joints   " + "".join(f"{law:>14s}" for law in LAWS))
    for u, v in PLANES:
        print(
            f"{u + 1}, {v + 1}     " + "".join(f"{following(robot, q, (u, v), RADIUS, law)[-1]:14.1e}" for law in LAWS)
        )
    print("\nGrowth with the radius (exponent of r between 0.01 and 0.02 rad):")
    for formula in FORMULAS:
        small, large = (abs(following(robot, q, PLANES[0], radius, formula)[-1]) for radius in (0.01, 0.02))
        print(f"  {formula:14s}{np.log2(large / small):6.3f}")


def figure(robot: ModuleType, q: Array) -> str:
    """Return the SVG text: three laps with a constant stiffness; net work over the radius with each torque."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.8), layout="constrained")
        left, right = drawing.subplots(1, 2)
        _draw_laps(left, robot, q)
        _draw_radii(right, robot, q)
        drawing.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=4)
        return themed_svg(drawing)


def _colours() -> dict[str, str]:
    """Return the colour of each law."""
    from examples.style import CONVENTIONAL, CORRECTED, POTENTIAL

    return dict(zip(LAWS, (CORRECTED, CONVENTIONAL, POTENTIAL), strict=True))


def _draw_laps(axes: Any, robot: ModuleType, q: Array) -> None:
    """Draw the work [J] over three laps with the stiffness held, and the area integral at the end of each lap."""
    from examples.style import INK

    plane, colours = PLANES[0], _colours()
    turns = np.arange(3 * STEPS + 1) / STEPS
    for law, line, width in zip(LAWS, ("-", "--", (0, (1, 3))), (1.2, 1.2, 2.5), strict=True):
        lap = held(robot, q, plane, RADIUS, law) if law in FORMULAS else following(robot, q, plane, RADIUS, law)
        laps = np.concatenate([lap[:-1] + k * lap[-1] for k in range(3)] + [[3 * lap[-1]]])  # each adds the same work
        axes.plot(turns[::50], laps[::50], linestyle=line, linewidth=width, color=colours[law])
    for k in range(1, 4):
        axes.plot(k, k * area_integral(robot, q, plane, RADIUS, "conventional"), "o", color=INK, markersize=4)
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set(xlabel="laps", ylabel="work put out [J]", title=f"stiffness held, radius {RADIUS} rad")


def _draw_radii(axes: Any, robot: ModuleType, q: Array) -> None:
    """Draw the net work [J] of a lap over its radius [rad], with the torque of each posture, and the area integral."""
    from examples.style import INK

    plane, colours = PLANES[0], _colours()
    radii = np.geomspace(0.005, RADIUS, 10)
    for law in LAWS:
        # The exact law's work is rounding, of which 1e-18 J is still on the logarithmic axis.
        values = [max(abs(following(robot, q, plane, radius, law)[-1]), 1e-18) for radius in radii]
        axes.loglog(radii, values, "o-", color=colours[law], markersize=3, label=law)
    areas = [abs(area_integral(robot, q, plane, radius, "conventional")) for radius in radii]
    axes.loglog(radii, areas, ":", color=INK, label="area integral (left: dots)")
    axes.set(xlabel="radius [rad]", ylabel="|net work of a lap| [J]", title="torque of each posture")
    axes.set_xticks([0.005, 0.01, 0.02, 0.05, 0.1], labels=["0.005", "0.01", "0.02", "0.05", "0.1"])
    axes.minorticks_off()
    axes.set_ylim(1e-18, 1)


def main() -> None:
    """Print the table; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    from generated import iiwa14

    q = centre()
    table(iiwa14, q)
    if options.figure:
        options.figure.write_text(figure(iiwa14, q))


if __name__ == "__main__":
    main()
