# SPDX-License-Identifier: MIT
"""Draw the pictures of docs/controller.md: the loop, a jump of q0, and a load of 40 N, also under the paper's law.

The arm is simulated with the folder's own kernels (mass matrix, bias forces, Jacobian), gravity compensated.

    python -m examples.controller             prints what the pictures show
    python -m examples.controller --figures   also draws docs/controller_*.svg (needs matplotlib: the extra examples)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

Array = NDArray[np.float64]

Q0 = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])  # rad
TRANSLATION, ROTATION = np.diag([700.0, 700.0, 800.0]), np.diag([30.0, 30.0, 30.0])  # N/m, N m/rad
MOTOR = 0.1  # kg m^2 of each rotor, seen at its joint
T = 0.001  # s
JUMP = np.array([0.0, 0.6, 0.0, 0.6, 0.0, 0.0, 0.0])  # rad, of q0 at JUMP_TIME
JUMP_TIME, LOAD_TIME = 0.2, 0.2  # s
LOAD = np.array([0.0, 0.0, -40.0, 0.0, 0.0, 0.0])  # N, N m that the environment applies to the robot
HEAVIEST = (60.0, 10.0)  # N, N m: 1.5 times the load
SLOW = {"tip_velocity_limit": 0.5, "tip_rotation_limit": 1.5}  # m/s, rad/s: a governor that the figure can show
ZERO = np.zeros(3)


def move(robot: ModuleType, q: Array, dq: Array, torque: Array, wrench: Array) -> tuple[Array, Array]:
    """Return the arm's position and velocity after one sample time."""
    force = torque + robot.hybrid.jacobian(q).T @ wrench - robot.bias_forces(q, dq, ZERO)
    dq = dq + T * np.linalg.solve(robot.mass_matrix(q) + MOTOR * np.eye(7), force)
    return q + T * dq, dq


def simulate(
    robot: ModuleType, duration: float, wanted: Callable[[float], Array], load: Callable[[float], Array]
) -> dict[str, Array]:
    """Run the controller with a simulated arm from rest at Q0; arrays with a leading time axis."""
    slow = {"ramp_time": 0.2, "reference_velocity_limit": 0.5 * robot.VELOCITY} | SLOW
    controller = robot.Impedance(heaviest_wrench=HEAVIEST, motor_inertia=MOTOR, record=round(duration / T), **slow)
    gains = {"translation_stiffness": TRANSLATION, "rotation_stiffness": ROTATION}
    q, dq = Q0.copy(), np.zeros(7)
    for k in range(round(duration / T)):
        wrench = load(k * T)
        out = controller.step(q=q, dq=dq, q0=wanted(k * T), wrench=wrench, **gains)
        q, dq = move(robot, q, dq, out.torque, wrench)
    inputs, outputs = controller.trace
    tip = robot.forward_kinematics(inputs.q)[:, :3, 3]
    return {
        "time": T * np.arange(len(tip)),
        "q": inputs.q,
        "dq": inputs.dq,
        "q0": inputs.q0,
        "reference": outputs.reference,
        "energy": outputs.elastic_energy,
        "fault": outputs.fault,
        "deflection": np.linalg.norm(tip - tip[0], axis=1),
    }


def jump(robot: ModuleType) -> dict[str, Array]:
    """Simulate a jump of q0 while the arm is at rest."""
    return simulate(robot, 2.5, lambda t: Q0 + JUMP * (t >= JUMP_TIME), lambda t: np.zeros(6))


def loaded(robot: ModuleType) -> dict[str, Array]:
    """Apply a load at once and keep it."""
    return simulate(robot, 2.5, lambda t: Q0, lambda t: LOAD * (t >= LOAD_TIME))


def loaded_secant(robot: ModuleType) -> Array:
    """Return how far the same load carries the tip [m] under the paper's law, sample by sample."""
    K = np.zeros((6, 6))
    K[:3, :3], K[3:, 3:] = TRANSLATION, ROTATION
    law, q, dq, path = robot.PaperLaw(motor_inertia=MOTOR), Q0.copy(), np.zeros(7), []
    for k in range(round(2.5 / T)):
        wrench = LOAD * (k * T >= LOAD_TIME)
        path.append(robot.forward_kinematics(q)[:3, 3])
        out = law.step(q=q, dq=dq, q0=Q0, wrench=wrench, task_stiffness=K)
        q, dq = move(robot, q, dq, out.torque, wrench)
    deflections: Array = np.linalg.norm(np.array(path) - path[0], axis=1)
    return deflections


def figure(robot: ModuleType) -> str:
    """Return the SVG text: the governor on a jump of q0, its energy, and the load also under the paper's law."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CORRECTED, INK, POTENTIAL, STYLE, themed_svg

    moved, every = jump(robot), 5
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 5.6), layout="constrained")
        (position, load), (speed, energy) = drawing.subplots(2, 2, sharex=True)
        t = moved["time"][::every]
        lines = {
            "wanted, q0": (":", INK, "q0"),
            "equilibrium, moved by the governor": ("--", INK, "reference"),
            "arm": ("-", POTENTIAL, "q"),
        }
        for name, (style, colour, field) in lines.items():
            position.plot(t, moved[field][::every, 1], linestyle=style, color=colour, label=name)
        position.set(ylabel="joint 2 [rad]", title="q0 jumps by 0.6 rad")
        drawing.legend(*position.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        limit = 0.5 * robot.VELOCITY[1]
        reference = np.diff(moved["reference"], axis=0, prepend=Q0[None])[::every, 1] / T
        speed.plot(t, reference, linestyle="--", color=INK)
        speed.plot(t, moved["dq"][::every, 1], color=POTENTIAL)
        speed.axhline(limit, color=INK, linewidth=0.6)
        speed.annotate(
            "reference_velocity_limit", (2.5, limit), (0, -3), textcoords="offset points", ha="right", va="top"
        )
        speed.set(xlabel="time [s]", ylabel="joint 2 [rad/s]")
        run = loaded(robot)
        load.plot(t, 100 * run["deflection"][::every], color=POTENTIAL, label="the controller")
        load.plot(t, 100 * loaded_secant(robot)[::every], color=CORRECTED, label="the paper's law")
        energy.plot(t, run["energy"][::every], color=POTENTIAL)
        load.set(ylabel="tip from where it was [cm]", title="40 N hung at the tip")
        load.legend(loc="upper left")
        energy.set(xlabel="time [s]", ylabel="stored in the springs [J]")
        return themed_svg(drawing)


def loop_figure() -> str:
    """Return the SVG text: the parts of the controller and the signals between them."""
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

    from examples.style import AXES, CORRECTED, INK, POTENTIAL, STYLE, themed_svg

    boxes = {
        "governor": (1.9, 2.4, 1.4, 0.8, POTENTIAL),
        "spring U(q, r)": (4.4, 2.4, 1.6, 0.8, POTENTIAL),
        "damping B(q)": (4.4, 1.2, 1.6, 0.8, POTENTIAL),
        "is the sample\ntrue?": (4.4, 0.0, 1.6, 0.8, AXES[0]),
        "tank: is the\ntorque covered?": (7.2, 1.2, 1.8, 0.8, AXES[1]),
        "torque and\nrate limits": (7.2, 2.4, 1.8, 0.8, AXES[0]),
        "arm and\nenvironment": (7.2, 0.0, 1.8, 0.8, CORRECTED),
    }
    arrows = (
        ((0.0, 2.8), (1.9, 2.8), "wanted q0,\nstiffness", (0.9, 2.88)),
        ((3.3, 2.8), (4.4, 2.8), "equilibrium\nr", (3.85, 2.88)),
        ((3.0, 2.4), (4.4, 1.7), "velocity dr", (3.1, 1.72)),
        ((6.0, 2.8), (7.2, 2.8), "$-\\ell\\,\\partial U/\\partial q$", (6.6, 2.9)),
        ((6.0, 1.7), (7.2, 2.5), "B (dr - dq)", (6.55, 1.55)),
        ((7.9, 2.0), (7.9, 2.4), "", (0, 0)),
        ((8.3, 2.4), (8.3, 2.0), "", (0, 0)),
        ((7.2, 0.4), (6.0, 0.4), "q, dq", (6.6, 0.48)),
        ((5.2, 0.8), (5.2, 1.2), "", (0, 0)),
    )
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.2), layout="constrained")
        axes = drawing.subplots()
        axes.set(xlim=(-0.1, 10.1), ylim=(-0.1, 3.6))
        axes.set_axis_off()
        for name, (x, y, width, height, colour) in boxes.items():
            style = "round,pad=0,rounding_size=0.1"
            axes.add_patch(
                FancyBboxPatch((x, y), width, height, style, facecolor="none", edgecolor=colour, linewidth=1.4)
            )
            axes.text(x + width / 2, y + height / 2, name, ha="center", va="center")
        for start, end, name, at in arrows:
            axes.add_patch(
                FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=9, color=INK, shrinkA=0, shrinkB=0)
            )
            if name:
                axes.text(at[0], at[1], name, ha="center", va="bottom")
        for path in ([(9.0, 2.8), (9.6, 2.8), (9.6, 0.4), (9.0, 0.4)], [(4.4, 0.4), (2.6, 0.4), (2.6, 2.4)]):
            axes.plot(*zip(*path[:-1], strict=True), color=INK, linewidth=1.0)
            axes.add_patch(
                FancyArrowPatch(path[-2], path[-1], arrowstyle="-|>", color=INK, mutation_scale=9, shrinkA=0, shrinkB=0)
            )
        axes.text(9.7, 1.6, "torque, held for T", rotation=90, va="center")
        axes.text(3.5, 0.48, "q", ha="center", va="bottom")
        return themed_svg(drawing)


def draw(robot: ModuleType) -> dict[str, str]:
    """Return SVG texts by file name in docs/."""
    return {"controller_loop.svg": loop_figure(), "controller_governor.svg": figure(robot)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", action="store_true")
    options = parser.parse_args()
    from generated import iiwa14

    moved = jump(iiwa14)
    left = np.abs(moved["q"][-1] - moved["q0"][-1]).max()
    fastest = np.abs(moved["dq"][:, 1]).max()
    print(f"q0 jumps by {np.abs(JUMP).max()} rad: joint 2 at most {fastest:.3f} rad/s, the springs")
    print(f"store at most {moved['energy'].max():.3f} J, after 2.5 s {left:.1e} rad are left")
    for law, deflection in (("controller", loaded(iiwa14)["deflection"]), ("paper's law", loaded_secant(iiwa14))):
        print(f"40 N, {law}: tip away by at most {deflection.max():.3f} m, {deflection[-1]:.3f} m at the end")
    if options.figures:
        for name, svg in draw(iiwa14).items():
            (ROOT / "docs" / name).write_text(svg)


if __name__ == "__main__":
    main()
