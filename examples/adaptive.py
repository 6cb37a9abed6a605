# SPDX-License-Identifier: MIT
"""Adapt a stiffness while the arm works, within the energy of the controller's tank: ``make adaptive``.

    python -m examples.adaptive [--robot FOLDER] [--figure FILE]

A load appears and disappears at the tip. Every LEARN seconds a learner requests another translation stiffness.

- The careful learner follows a gradient: that of the expected deflection and of a cost of stiffness. The gradient
  uses the kernel's vector-Jacobian product.
- The greedy learner requests a soft spring while the load pushes the arm away, and a stiff one while the arm comes
  back, so that the spring returns more energy than it received.

Both use the generated controller, which computes the cost of a change of stiffness and withdraws it from its tank. The
greedy learner also uses a controller whose tank pays for every change.

The folder's own kernels simulate the arm, with compensated gravity. The exit code is 1 if the arm put out more work
than its tank had at the start.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stiffgen import open_robot

Array = NDArray[np.float64]

Q0 = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])  # rad, of the springs and at the start
MOTOR = 0.1  # kg m^2 of each rotor, seen at its joint
T, LEARN = 0.001, 0.02  # s, of the controller and of the learner
LOAD, PERIOD = 30.0, 2.0  # N downwards at most, and s from one maximum to the next
DURATION = 12.0  # s
TANK, HUGE = 2.0, 20.0  # J at the start, and what no change of stiffness here uses up
SOFT, STIFF = 200.0, 4500.0  # N/m that a learner may ask for
ROTATION = 30.0 * np.eye(3)  # N m/rad
POSTURE_STIFFNESS = 1.0  # N m/rad
ALLOWED = 0.01  # m of deflection that counts as much as a stiffness e times the usual one
USUAL, RATE, LARGEST = 300.0, 0.05, 0.2  # N/m; of a gradient step, and the largest step, both of log(k)

Learner = Callable[[float, Array, Array, Array], Array]
"""Time [s], posture [rad], wrench [N, N m] and present request [N/m] (3,) to the next request (3,)."""


@dataclass(frozen=True)
class Run:
    """Time [s], load [N], requested stiffness in z [N/m], deflection [m], tank, port work and its bound [J].

    ``held`` says where the tank could not pay for the requested stiffness.
    """

    time: Array
    load: Array
    asked: Array
    held: NDArray[np.bool_]
    deflection: Array
    tank: Array
    port: Array
    bound: float
    fault: int


def loss(robot: Any, q: Array, wrench: Array, stiffness: Array) -> tuple[float, Array]:
    """Return the careful learner's cost and its gradient with respect to log(k), k the three stiffnesses [N/m].

    With S = Kq(q, F, K) + Kp the deflection to expect is e = J S^-1 J^T F (linear part), the loss
    |e|^2 / (2 ALLOWED^2) + |log(k / USUAL)|^2 / 2. By S it changes as -lambda dq^T with
    lambda = S^-1 J^T e / ALLOWED^2: this is the cotangent of the joint stiffness.
    """
    K = np.zeros((6, 6))
    K[:3, :3], K[3:, 3:] = np.diag(stiffness), ROTATION
    J = robot.hybrid.jacobian(q)
    S = robot.hybrid.joint_stiffness(q, wrench, K) + POSTURE_STIFFNESS * np.eye(len(q))
    dq = np.linalg.solve(S, J.T @ wrench)  # deflection of the joints [rad]
    e = J[:3] @ dq  # deflection of the tip [m]
    weight = np.linalg.solve(S, J[:3].T @ e) / ALLOWED**2
    _, _, by_stiffness = robot.hybrid.joint_stiffness_vjp(q, wrench, K, -np.outer(weight, dq))
    logarithm = np.log(stiffness / USUAL)  # distance from the usual stiffness, which the prior punishes
    gradient = np.diag(by_stiffness)[:3] * stiffness + logarithm  # d/d log(k) = k d/dk
    return float(e @ e / (2 * ALLOWED**2) + logarithm @ logarithm / 2), gradient


def careful(robot: Any) -> Learner:
    """Take a step down the gradient."""

    def learner(time: float, q: Array, wrench: Array, stiffness: Array) -> Array:
        step = np.clip(-RATE * loss(robot, q, wrench, stiffness)[1], -LARGEST, LARGEST)
        return np.clip(stiffness * np.exp(step), SOFT, STIFF)

    return learner


def greedy(time: float, q: Array, wrench: Array, stiffness: Array) -> Array:
    """Request a soft spring while the load pushes the arm away, and a stiff one while the arm comes back."""
    return np.full(3, STIFF if time % PERIOD >= PERIOD / 2 else SOFT)


def simulate(robot: Any, learner: Learner, tank: float, duration: float = DURATION) -> Run:
    """Run the controller with a simulated arm, from rest at Q0, for `duration` [s] with a tank of `tank` [J]."""
    steps = round(duration / T)
    controller = robot.Impedance(
        sample_time=T,
        delay_samples=0,
        motor_inertia=MOTOR,
        heaviest_wrench=(60.0, 10.0),
        tank_initial=tank,
        record=steps,
    )
    q, dq, stiffness = Q0.copy(), np.zeros(7), np.full(3, USUAL)
    asked, loads = np.empty(steps), np.empty(steps)
    every = round(LEARN / T)  # samples between two decisions of the learner
    for k in range(steps):
        wrench = np.array([0.0, 0.0, -LOAD * np.sin(np.pi * k * T / PERIOD) ** 2, 0.0, 0.0, 0.0])
        if k % every == 0:
            stiffness = learner(k * T, q, wrench, stiffness)
        asked[k], loads[k] = stiffness[2], -wrench[2]
        out = controller.step(
            q=q, dq=dq, q0=Q0, counter=k, translation_stiffness=np.diag(stiffness), rotation_stiffness=ROTATION,
            posture_stiffness=POSTURE_STIFFNESS,
        )  # fmt: skip
        q, dq = _moved(robot, q, dq, out.torque, wrench)
    inputs, outputs = controller.trace
    tip = robot.forward_kinematics(inputs.q)[:, :3, 3]
    work = np.sum(outputs.torque[:-1] * np.diff(inputs.q, axis=0), axis=1)  # [J] per sample, put into the arm
    return Run(
        time=np.asarray(T * np.arange(steps), dtype=np.float64),
        load=loads,
        asked=asked,
        held=(outputs.status & int(robot.Status.TANK_LIMITED)) != 0,
        deflection=np.linalg.norm(tip - tip[0], axis=1),
        tank=outputs.tank,
        port=np.concatenate([[0.0], np.cumsum(work)]),
        bound=float(outputs.energy_supplied[-1]),
        fault=int(np.max(outputs.fault)),
    )


def _moved(robot: Any, q: Array, dq: Array, torque: Array, wrench: Array) -> tuple[Array, Array]:
    """Return joint positions and velocities a sample later, by semi-implicit Euler.

    M ddq = torque + J^T wrench - bias forces, without gravity; the motors' inertia is part of M.
    """
    force = torque + robot.hybrid.jacobian(q).T @ wrench - robot.bias_forces(q, dq, np.zeros(3))
    dq = dq + T * np.linalg.solve(robot.mass_matrix(q) + MOTOR * np.eye(7), force)
    return q + T * dq, dq


def figure(runs: dict[str, Run]) -> str:
    """Return an SVG with requested stiffness and where the tank holds it back, tank, and work of every run."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    from examples.style import CONVENTIONAL, CORRECTED, INK, POTENTIAL, STYLE, themed_svg

    colours = dict(zip(runs, (POTENTIAL, CORRECTED, CONVENTIONAL), strict=True))
    with plt.rc_context(STYLE):
        drawing, ((careful_k, greedy_k), (tanks, ports)) = plt.subplots(2, 2, figsize=(7.5, 5.2), layout="constrained")
        for axes, name in zip((careful_k, greedy_k), runs, strict=False):
            run = runs[name]
            axes.plot(run.time[::10], run.asked[::10], color=colours[name])  # every 10th sample is enough
            asked = np.where(run.held, run.asked, np.nan)
            axes.plot(run.time[::10], asked[::10], color=INK, linewidth=3, label="held back by the tank")
            axes.set(title=f"stiffness in z, {name}", ylabel="[N/m]", ylim=(0, 1.08 * STIFF))
        for name, run in runs.items():
            if run.bound == TANK:
                tanks.plot(run.time[::10], run.tank[::10], color=colours[name])
            ports.plot(run.time[::10], run.port[::10], color=colours[name], label=name)
        tanks.set(title="energy in the tank", ylabel="[J]", ylim=(0, None))
        ports.axhline(TANK, color=INK, linestyle=":", linewidth=1, label=f"bound of {TANK:g} J")
        ports.set(title="work put out by the controller", ylabel="[J]")
        # Beside the curves, which fill their panels.
        drawing.legend(handles=[*ports.lines, careful_k.lines[1]], loc="outside lower center", ncols=3)
        for axes in (tanks, ports):
            axes.set_xlabel("time [s]")
        svg = themed_svg(drawing)
        plt.close(drawing)
    return svg


def main() -> int:
    """Run the example; options stand in the text of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", type=Path, default=Path("build/robots/iiwa14_derivatives"))
    parser.add_argument("--figure", type=Path, help="write the figure there, an SVG")
    options = parser.parse_args()
    robot: Any = open_robot(options.robot).module
    runs = {
        f"careful, tank {TANK:g} J": simulate(robot, careful(robot), TANK),
        f"greedy, tank {TANK:g} J": simulate(robot, greedy, TANK),
        f"greedy, tank {HUGE:g} J": simulate(robot, greedy, HUGE),
    }
    print("most deflection, stiffness asked for (z), held back, least in the tank, most work put out, and at the end")
    for name, run in ({"constant": simulate(robot, lambda _t, _q, _f, k: k, TANK)} | runs).items():
        print(
            f"  {name:22} {1000 * run.deflection.max():6.1f} mm {run.asked.max():6.0f} N/m {run.held.mean():6.1%} "
            f"{run.tank.min():7.2f} J {run.port.max():6.2f} J {run.port[-1]:6.2f} J"
        )
    if options.figure:
        options.figure.write_text(figure(runs), encoding="utf-8")
    return 1 if any(run.fault or run.port.max() > run.bound for run in runs.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
