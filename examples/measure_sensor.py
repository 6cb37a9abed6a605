# SPDX-License-Identifier: MIT
"""Measure a spring and a sensor: an iiwa 14 in MuJoCo, its flange held by eight springs, runs a planned motion.

    python -m examples.measure_sensor [TURN_IN_DEG]

The readings are those of a sensor that is turned about its z axis by TURN_IN_DEG (default: 1), with noise. The
recording is measured.csv; what 'stiffgen measure' says of it is printed, and drawn in measured_measured.html.
"""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import stiffgen

Array = NDArray[np.float64]

URDF = Path(__file__).resolve().parents[1] / "urdf" / "iiwa14.urdf"
FLANGE = "link_ee"
POSTURE = np.array([0.3, 0.6, -0.2, -1.2, 0.4, 1.0, 0.2])
SPRING = 2000.0
"""[N/m] of each of the eight springs."""
NOISE = np.repeat([0.05, 0.002], 3)
"""[N, N m] of an ATI Gamma."""
GAIN, DAMPING = 4000.0, 40.0
"""[N m/rad, N m s/rad] of the joints' position control."""


def held_arm(seed: int = 0) -> mujoco.MjModel:
    """Return the arm with springs from points of the flange to the ground, stretched at the posture."""
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False
    spec.option.timestep = 0.001
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in spec.joints:
        joint.armature = 0.3  # [kg m^2] reflected rotors
    plain = spec.compile()
    data = mujoco.MjData(plain)
    data.qpos[:] = POSTURE
    mujoco.mj_kinematics(plain, data)
    flange = spec.body(FLANGE)
    flange.add_site(name="sensor")
    for name, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    body = plain.body(FLANGE).id
    origin, R = data.xpos[body], data.xmat[body].reshape(3, 3)
    random = np.random.default_rng(seed)
    for k in range(8):  # eight springs of 0.3 m, in random directions, within 0.1 m of the flange
        near = random.uniform(-0.1, 0.1, 3)
        there = origin + R @ near
        away = random.normal(size=3)
        away *= 0.3 / np.linalg.norm(away)
        flange.add_site(name=f"near{k}", pos=near)
        spec.worldbody.add_site(name=f"far{k}", pos=there + away)
        rest = 0.3 - random.uniform(0.002, 0.01)  # [m] shorter than now: a load
        tendon = spec.add_tendon(name=f"spring{k}", stiffness=SPRING, springlength=[rest, rest])
        tendon.wrap_site(f"near{k}")
        tendon.wrap_site(f"far{k}")
    return spec.compile()


def record(
    model: mujoco.MjModel, plan: Array, turn: float, seed: int = 0, period: float = 0.005
) -> tuple[Array, Array, Array]:
    """Run joint positions (N, n); return time [s], q and readings of a sensor turned about z by ``turn`` [rad]."""
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    data.qpos[:] = plan[0]
    # the springs pull before the motion begins
    mujoco.mj_forward(model, data)
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # readings in turned axes
    rows = []
    steps = round(period / model.opt.timestep)
    for wanted in np.concatenate([np.repeat(plan[:1], 100, axis=0), plan]):
        for _ in range(steps):
            mujoco.mj_step1(model, data)
            data.qfrc_applied[:] = GAIN * (wanted - data.qpos) - DAMPING * data.qvel + data.qfrc_bias
            mujoco.mj_step2(model, data)
        mujoco.mj_forward(model, data)  # readings of the same state as the positions
        reading = np.concatenate([axes @ data.sensor(name).data for name in ("force", "torque")])
        rows.append((data.time, data.qpos.copy(), reading + NOISE * random.normal(size=6)))
    time, q, readings = (np.array(each) for each in zip(*rows[100:], strict=True))
    return time, q, readings


def measure(*arguments: str) -> None:
    """Run the command; it returns 1 if the sensor does not agree with the pose."""
    if subprocess.run([sys.executable, "-m", "stiffgen", "measure", *arguments], check=False).returncode > 1:
        raise SystemExit(2)


def main(turn: float) -> None:
    """Plan, run, measure."""
    folder = stiffgen.generate(URDF, tip=FLANGE, kernels="hybrid,body", controller=False, name="held")
    posture, stiffness = ",".join(map(str, POSTURE)), "5000,5000,5000,40,40,40"
    robot = ("--robot", str(folder), "--calibration", "none")
    measure("--plan", "plan.csv", *robot, "--posture", posture, "--stiffness", stiffness, "--deviation", "0.02")
    time, q, readings = record(held_arm(), np.loadtxt("plan.csv", delimiter=","), turn)
    with Path("measured.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", *(f"q_{i}" for i in range(7)), *(f"wrench_{i}" for i in range(6))])
        rows.writerows(np.column_stack([time, q, readings]).tolist())
    measure("measured.csv", *robot)


if __name__ == "__main__":
    main(np.radians(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0))
