# SPDX-License-Identifier: MIT
"""Wipe the bowl with 15 N: with Press and the sensor's wrench, and by the springs alone.

    python -m examples.bowl_wiping.pressing                prints mean and error of the force
    python -m examples.bowl_wiping.pressing --figure FILE  draws the force

The bowl is a height field, whose cells the plate's edge passes: that shakes the force, and lifts the plate at times.
The plate sweeps through the bowl, its face across the bowl's normal. Without Press the pose lies as deep as the springs
need for 15 N, in a bowl that stands 5 mm lower than believed. With Press the pose is the same; the sensor tells.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import stiffgen
from examples.bowl_wiping.bowl import Bowl
from examples.bowl_wiping.tool import EDGE_RADIUS, PLATE, PLATE_RADIUS
from examples.experiments.plant import MOTOR_INERTIA, START_POSTURE, Plant
from examples.experiments.tool import SENSOR, URDF
from examples.experiments.trial import FORCE_NOISE, MOMENT_NOISE

Array = NDArray[np.float64]

FORCE, TOO_LOW = 15.0, 0.005
"""Force that is wanted [N], and how much lower the bowl stands than believed [m]."""
STIFFNESS, TURNING = 800.0, 30.0
"""Of the tip [N/m, N m/rad]."""
STEP, LIFT = 1e-3, 0.03
"""Sample time [s], and height [m] of the plate above the bowl at the start."""
SWEEP, SPEED = 0.06, 0.05
"""Way of the plate to each side [m], and its fastest speed [m/s]."""
BEGIN, SETTLED, END = 2.0, 3.0, 9.0
"""Times [s]: the sweep begins, is measured from, ends."""
BELIEVED = Bowl(friction=0.2)
DEPTH = BELIEVED.radius - np.sqrt(BELIEVED.radius**2 - PLATE_RADIUS**2)
"""[m] of the bowl below the plate, whose edge alone touches."""


@dataclass(frozen=True)
class Pressed:
    """Time (N) [s] and force (N) [N] of the contact along the axis; a fault of the controller, 0 for none."""

    time: Array
    force: Array
    fault: int

    @property
    def error(self) -> Array:
        """Error of the force during the sweep (M) [N]."""
        return np.asarray(self.force[self.time >= SETTLED] - FORCE)


def plate_pose(time: float, depth: float) -> tuple[Array, Array]:
    """Return the pose of the plate's centre, ``depth`` [m] inside the believed bowl, and the axis into the bowl (3)."""
    swung = max(time - BEGIN, 0.0)
    along = SWEEP * np.sin(SPEED / SWEEP * swung) / BELIEVED.radius
    axis = np.array([0.0, np.sin(along), -np.cos(along)])
    pose = np.eye(4)
    across = np.array([1.0, 0.0, 0.0])
    pose[:3, :3] = np.stack([np.cross(across, axis), across, axis], axis=1)
    centre = np.array([*BELIEVED.centre, BELIEVED.bottom + BELIEVED.radius])
    pose[:3, 3] = centre + (BELIEVED.radius - DEPTH - EDGE_RADIUS + depth) * axis
    return pose, axis


def wipe(robot: ModuleType, *, press: bool, end: float = END) -> Pressed:
    """Return the force [N] of a sweep of `end` seconds, held by Press or by the depth that the spring needs."""
    bowl = replace(BELIEVED, bottom=BELIEVED.bottom - TOO_LOW)  # the true bowl lies lower than believed
    start, _ = plate_pose(0.0, -LIFT)
    half_turns = np.full(robot.DOF, np.pi)  # the recorded start is beyond the limits
    q = robot.find_posture(start, START_POSTURE, lower=-half_turns, upper=half_turns)
    plant = Plant(STEP, surface=bowl.surface(), tool=PLATE, q=q)
    springs = {"translation_stiffness": STIFFNESS * np.eye(3), "rotation_stiffness": TURNING * np.eye(3)}
    controller = robot.Impedance(
        sample_time=STEP, delay_samples=0, motor_inertia=MOTOR_INERTIA, heaviest_wrench=(150.0, 40.0),
        lower_limit=-np.inf, upper_limit=np.inf,
    )  # fmt: skip
    follow, hold = robot.Follow(q, sample_time=STEP), robot.Press(controller)
    random, last, force = np.random.default_rng(0), None, list[float]()
    for k in range(round(end / STEP)):
        depth = 0.0 if press else FORCE / STIFFNESS  # [m] at which the spring would give the force
        pose, axis = plate_pose(k * STEP, depth - LIFT * max(1.0 - k * STEP, 0.0))
        command: dict[str, Any] = {}
        if press:
            noise = random.normal(scale=[FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
            made = hold.step(
                pose=pose, last=last, wrench=plant.wrench(robot) + noise, axis=axis,
                force=FORCE if k * STEP >= 1.0 else 0.0, **springs,
            )  # fmt: skip
            pose, command["wrench_command"] = made.pose, made.wrench_command
        q0 = follow.step(pose=pose, posture=q).q0
        last = controller.step(q=plant.q, dq=plant.dq, q0=q0, shaped=True, counter=k, **springs, **command)
        plant.step(last.torque)
        force.append(float(-axis @ plant.contact_wrench()[:3]))
    time = np.arange(len(force), dtype=np.float64) * STEP
    return Pressed(np.asarray(time), np.array(force), int(last.fault) if last is not None else 0)


def said(name: str, found: Pressed) -> str:
    """Return a sentence with the error of the force."""
    error, fault = found.error, "no fault" if found.fault == 0 else f"fault {found.fault}"
    off = 100.0 * float((error <= -FORCE).mean())
    return (
        f"{name}: mean {FORCE + error.mean():.2f} N of {FORCE:g} N, rms error {np.sqrt(np.mean(error**2)):.2f} N, "
        f"without contact {off:.1f} % of the time; {fault}"
    )


def draw(found: dict[str, Pressed]) -> str:
    """Return an SVG with the force over time."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from examples.style import CONVENTIONAL, CORRECTED, INK, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(6.5, 2.6), layout="constrained")
        axes = drawing.subplots()
        for (name, each), colour in zip(found.items(), (CONVENTIONAL, CORRECTED), strict=True):
            axes.plot(each.time[::10], each.force[::10], color=colour, label=name)
        axes.axhline(FORCE, color=INK, linewidth=0.6)
        axes.set(xlabel="time [s]", ylabel="force on the bowl [N]", ylim=(0, None))
        drawing.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return themed_svg(drawing)


def main() -> int:
    """Print the errors, or draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, metavar="FILE")
    options = parser.parse_args()
    folder = Path("build/robots") / PLATE.robot
    if not folder.is_dir():
        stiffgen.generate(URDF, name=PLATE.robot, tool=PLATE.for_generator(), sensor=SENSOR, output=folder.parent)
    robot = stiffgen.open_robot(folder).module
    found = {name: wipe(robot, press=press) for name, press in (("springs alone", False), ("Press", True))}
    print("\n".join(said(name, each) for name, each in found.items()))
    if options.figure:
        options.figure.write_text(draw(found))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
