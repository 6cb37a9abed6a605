# SPDX-License-Identifier: MIT
"""Measure how soft the tip of an arm on joint springs is under a load, and when the arm buckles.

An arm rests at q on springs of stiffness Kth in its joints, under a force F at the tip. A further small force dF moves
the tip by C dF, with

    C = J H^-1 J^T        H = Kth - (dJ^T/dq . F + J^T (Gamma F) J)

The usual formula, C = J Kth^-1 J^T, leaves the load's terms out. The example compares both with a solved equilibrium:
q is where the torque of the springs, Kth (q - q0), is J^T (F + dF), found by scipy.optimize.root from torques alone.

With --figure FILE the example writes compliance.svg (needs matplotlib: pip install -e '.[examples]').
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, root

Array = NDArray[np.float64]

BENT = np.array([1.23, 0.97, -0.63, -1.66, 0.04, 0.20, 2.44])  # rad, of the paper's bowl
MOTORS = np.array([800.0, 800.0, 600.0, 500.0, 300.0, 200.0, 150.0])  # N m/rad
FORCE = np.array([20.0, -30.0, 60.0, 0.0, 0.0, 0.0])  # N and N m, of the environment on the robot, base axes
SHARES = (1.0, 0.5, 0.2, 0.1, 0.05)
"""Of the motors' stiffness: from a stiff arm to one of soft proportional gains."""
INCREMENT = 1e-4  # N
LEANING = np.array([0.0, 0.25, 0.0, -0.5, 0.0, 0.25, 0.0])  # rad, nearly upright, the elbow a little bent
SOFT = 100.0  # N m/rad, in every joint of the leaning and of the upright arm


@dataclass(frozen=True)
class Posture:
    """A configuration (n,) [rad] on joint springs (n, n) [N m/rad] under a wrench (6,) [N, N m], hybrid axes."""

    robot: ModuleType
    q: Array
    stiffness: Array
    wrench: Array

    def jacobian(self) -> Array:
        """Return J (6, n)."""
        return np.asarray(self.robot.hybrid.jacobian(self.q))

    def hessian(self) -> Array:
        """Return H (n, n) [N m/rad]; the load's part is Kq of a tip without a spring."""
        load = self.robot.hybrid.joint_stiffness(self.q, self.wrench, np.zeros((6, 6)))
        return np.asarray(self.stiffness - load)

    def compliance(self, loaded: bool = True) -> Array:
        """Return C (6, 6) [m/N, 1/N, rad/(N m)], with the load's terms or without them."""
        J = self.jacobian()
        return np.asarray(J @ np.linalg.solve(self.hessian() if loaded else self.stiffness, J.T))

    def stability(self) -> float:
        """Return the smallest eigenvalue of H [N m/rad]: positive where the posture is stable."""
        return float(np.linalg.eigvalsh(self.hessian())[0])

    def unloaded(self) -> Array:
        """Return q0 (n,) [rad], where the springs would be at rest."""
        return np.asarray(self.q - np.linalg.solve(self.stiffness, self.jacobian().T @ self.wrench))


def equilibrium(posture: Posture, rest: Array, wrench: Array) -> Array:
    """Return where springs that rest at ``rest`` (n,) hold a wrench (6,), near the posture: (n,) [rad]."""

    def torque(q: Array) -> Array:
        return np.asarray(posture.stiffness @ (q - rest) - posture.robot.hybrid.jacobian(q).T @ wrench)

    found = root(torque, posture.q, method="hybr", options={"xtol": 1e-14})
    if np.abs(torque(found.x)).max() > 1e-9:
        raise ArithmeticError(f"no equilibrium under {wrench}: {found.message}")
    return np.asarray(found.x)


def softest(compliance: Array) -> tuple[float, Array]:
    """Return the largest compliance against a force [m/N], and its direction (3,)."""
    values, directions = np.linalg.eigh(compliance[:3, :3])
    return float(values[-1]), np.asarray(directions[:, -1])


def solved(posture: Posture) -> float:
    """Return the softest direction's compliance [m/N] from two equilibria, without H."""
    _, direction = softest(posture.compliance())
    rest, step = posture.unloaded(), np.r_[direction, np.zeros(3)] * INCREMENT
    ends = (equilibrium(posture, rest, posture.wrench + sign * step) for sign in (1, -1))
    places = [posture.robot.forward_kinematics(q)[:3, 3] for q in ends]
    return float(direction @ (places[0] - places[1])) / (2 * INCREMENT)


def rows(robot: ModuleType) -> list[tuple[str, ...]]:
    """Return the table: motors, softest direction with and without the load's terms and solved, eigenvalue of H."""
    made: list[tuple[str, ...]] = []
    for share in SHARES:
        posture = Posture(robot, BENT, np.diag(share * MOTORS), FORCE)
        without, _ = softest(posture.compliance(loaded=False))
        with_load, by_equilibria = "unstable", "none"
        if posture.stability() > 0:
            with_load, by_equilibria = _millimetres(softest(posture.compliance())[0]), _millimetres(solved(posture))
        motors = f"{share * MOTORS.min():g} to {share * MOTORS.max():g}"
        made.append((motors, _millimetres(without), with_load, by_equilibria, f"{posture.stability():.1f}"))
    return made


def _millimetres(compliance: float) -> str:
    """Return a compliance [m/N] in mm/N."""
    return f"{1e3 * compliance:.4g}"


def pressed(robot: ModuleType, forces: Array) -> list[Posture]:
    """Return where the leaning arm rests under each force downwards [N]."""
    stiffness, postures, q = SOFT * np.eye(7), [], LEANING
    for force in forces:
        wrench = -force * np.eye(6)[2]
        q = equilibrium(Posture(robot, q, stiffness, wrench), LEANING, wrench)
        postures.append(Posture(robot, q, stiffness, wrench))
    return postures


def upright(robot: ModuleType, force: float, stiffness: float) -> Posture:
    """Return the straight arm, pressed along itself by a force [N] on equal springs [N m/rad]."""
    return Posture(robot, np.zeros(7), stiffness * np.eye(7), -force * np.eye(6)[2])


def buckling_force(robot: ModuleType, stiffness: float) -> float:
    """Return the force [N] at which the straight arm gives way: H loses its smallest eigenvalue."""
    return float(brentq(lambda force: upright(robot, force, stiffness).stability(), 0.0, 1e4))


def figure(robot: ModuleType) -> str:
    """Return the SVG text: height lost under a load, solved and predicted; stability of the straight arm."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.6), layout="constrained")
        left, right = drawing.subplots(1, 2)
        _draw_leaning(left, robot)
        _draw_straight(right, robot)
        return themed_svg(drawing)


def _draw_leaning(axes: Any, robot: ModuleType) -> None:
    """Draw the height that the leaning arm loses under a force downwards: solved, and predicted by both compliances."""
    from examples.style import CONVENTIONAL, CORRECTED, INK

    forces = np.linspace(0, 60, 61)  # [N]
    postures = pressed(robot, forces)
    heights = np.array([robot.forward_kinematics(each.q)[2, 3] for each in postures])
    lost, unloaded = heights[0] - heights, postures[0].compliance()[2, 2]  # [m], [m/N]
    axes.plot(forces, 1e3 * lost, color=INK, label="solved")
    axes.plot(forces, 1e3 * unloaded * forces, "--", color=CONVENTIONAL, label="C without the load's terms")
    for at in range(10, len(forces), 15):  # tangents of 12 N at each 15th load
        push, slope = forces[at] + np.array([-6.0, 6.0]), postures[at].compliance()[2, 2]
        label = "slope: C with the load's terms" if at == 10 else None
        axes.plot(push, 1e3 * (lost[at] + slope * (push - forces[at])), color=CORRECTED, linewidth=2.5, label=label)
    axes.set(xlabel="force downwards [N]", ylabel="height lost [mm]", title="leaning arm, 100 N m/rad a joint")
    axes.legend(loc="upper left")


def _draw_straight(axes: Any, robot: ModuleType) -> None:
    """Draw the stability of the straight arm over the force along it, for three stiffnesses, and where it buckles."""
    from examples.style import CONVENTIONAL, CORRECTED, INK

    for stiffness, line in ((100.0, "-"), (200.0, "--"), (300.0, ":")):
        end = buckling_force(robot, stiffness)
        push = np.linspace(0, 1.15 * end, 60)  # up to 15 % beyond the buckling force
        values = [upright(robot, force, stiffness).stability() for force in push]
        axes.plot(push, values, line, color=CORRECTED, label=f"{stiffness:.0f} N m/rad")
        axes.plot(end, 0, "o", color=CONVENTIONAL, markersize=5)
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set(
        xlabel="force along the arm [N]", ylabel="smallest eigenvalue of H [N m/rad]",
        title="straight arm: it buckles at the dots",
    )  # fmt: skip
    axes.legend(loc="upper right")


def main() -> None:
    """Print the table; draw the figure if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="also draw an SVG")
    options = parser.parse_args()
    from generated import iiwa14

    for row in rows(iiwa14):
        print(*(f"{value:>12}" for value in row))
    print(f"the straight arm buckles at {buckling_force(iiwa14, SOFT):.1f} N")
    if options.figure:
        options.figure.write_text(figure(iiwa14))


if __name__ == "__main__":
    main()
