# SPDX-License-Identifier: MIT
"""Measure the largest tip stiffness with motors that have a controller inside, against motors that hold a torque.

    python tests/campaigns/motors.py [--hosts 100 200 500 1000] [--postures 3] [--ratio 1.41] [--rotors 1]

MuJoCo reads the Panda's URDF (with Franka's rotors) and has an actuator with an inner loop tau_ff + kp (q_des - q) +
kd (dq_des - dq) at each joint, updated at 10 kHz. The host computes springs, tangent and damping at its own rate from
a sample, and its command acts 1 ms later: once as a torque (kp = kd = 0), once split by joint_gains, with gains of any
size, and with kp <= 500 and kd <= 5. No cap of the controller acts: the loop itself is measured.

Two episodes in each posture: a push is held for 0.45 s and let go; the tip is pressed against a wall of 20 kN/m and
let go. The arm starts at rest at its equilibrium, so a passive arm has at no time put out more energy at the tip than
it was given. A stiffness passes if that holds up to 1 mJ, and if the last 0.2 s are slower than 0.3 of the fastest
moment (soft springs take long to come to rest, an unstable arm grows fast). The result is the stiffness below the first
one on a geometric ladder that does not pass. The rotational stiffness is 0.05 m^2 of it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import stiffgen
from stiffgen.core.opened import open_robot
from support.project import ROOT

INNER = 1e-4
"""[s] period of the motors' loop."""
DELAY = 1e-3
"""[s] from a sample to its command."""
POSTURE = 5.0
"""[N m/rad] stiffness of the posture spring."""
ROTORS = np.array([0.606, 0.606, 0.462, 0.462, 0.206, 0.206, 0.206])
"""[kg m^2] of the Panda, as in the presets."""
POSTURES = np.array([
    [0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8], [0.5, 0.4, -0.4, -1.4, 0.3, 1.9, 0.2],
    [-0.8, 0.2, 0.9, -2.5, -0.7, 2.4, -0.4],
])  # fmt: skip
PUSH = np.array([25.0, -20.0, 30.0])
WALL, PRESS = 2e4, np.array([0.0, 0.0, 30.0])
FORMS = {"torque": (0.0, 0.0), "gains": (np.inf, np.inf), "gains, kp <= 500, kd <= 5": (500.0, 5.0)}
"""Largest kp and kd of each form; 0: the torque is held."""


@dataclass(frozen=True)
class Bench:
    """Robot's functions, MuJoCo's model with its actuators, and the tip: body, and point in it."""

    robot: Any
    model: mujoco.MjModel
    body: int
    point: np.ndarray


def make_bench(folder: Path, rotors: float) -> Bench:
    """Generate the Panda, and set up MuJoCo from the same URDF; rotors: factor of ROTORS."""
    file = ROOT / "tests" / "data" / "panda.urdf"
    robot = open_robot(stiffgen.generate(file, tip="panda_hand_tcp", output=folder)).module
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep, spec.option.gravity = INNER, [0, 0, 0]
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for name in robot.JOINTS:
        motor = spec.add_actuator()
        motor.target, motor.trntype = name, mujoco.mjtTrn.mjTRN_JOINT
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    fingers = [joint for joint in spec.joints if joint.name not in robot.JOINTS]
    for element in (*spec.equalities, *fingers):
        spec.delete(element)
    model = spec.compile()
    assert model.nv == robot.DOF
    model.actuator_gainprm[:] = 0
    model.jnt_limited[:] = 0
    model.dof_damping[:] = model.dof_frictionloss[:] = 0
    model.dof_armature[:] = rotors * ROTORS
    data, body = mujoco.MjData(model), int(model.jnt_bodyid[-1])
    mujoco.mj_forward(model, data)
    away = robot.forward_kinematics(data.qpos)[:3, 3] - data.xpos[body]
    return Bench(robot, model, body, data.xmat[body].reshape(3, 3).T @ away)


def modal_damping(K: np.ndarray, M: np.ndarray, late: float) -> np.ndarray:
    """Return the damping of ratio 0.7 of every mode, with stiffness and damping that act late, and 0.1 N m s/rad."""
    root = np.linalg.cholesky(M)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ K @ inverse.T)
    size, zeta = np.abs(values), 0.7
    p = size * (2 * zeta**2 - 1) * late
    b = np.maximum(np.sqrt(np.maximum(p * p + 4 * zeta**2 * size - (size * late) ** 2, 0)) - p, size * late)
    modes = root @ vectors
    return np.asarray(modes @ np.diag(b) @ modes.T + 0.1 * np.eye(len(M)))


def command(bench: Bench, form: str, q: np.ndarray, v: np.ndarray, goal: Any, stiffness: float, late: float) -> Any:
    """Return the actuators' three bias parameters (n, 3): torque at q = dq = 0, and its slopes."""
    robot, (pose, posture), (kp, kd) = bench.robot, goal, FORMS[form]
    springs = (q, pose, stiffness * np.eye(3), 0.05 * stiffness * np.eye(3))
    K = robot.spring.joint_stiffness(*springs) + POSTURE * np.eye(robot.DOF)
    M = robot.mass_matrix(q) + np.diag(bench.model.dof_armature)
    B = modal_damping(K, M, late)
    torque = robot.spring.torque(*springs) - POSTURE * (q - posture) - B @ v
    gains = robot.joint_gains(q=q, dq=v, torque=torque, joint_stiffness=K, damping=B, kp_limit=kp, kd_limit=kd)
    return np.column_stack([gains.tau_ff + gains.kp * q, -gains.kp, -gains.kd])


def passes(bench: Bench, form: str, host: float, stiffness: float, posture: np.ndarray, wall: bool) -> bool:
    """Return whether the arm is passive in an episode of 1.4 s, and comes to rest; host rate [Hz], stiffness [N/m]."""
    model, data = bench.model, mujoco.MjData(bench.model)
    data.qpos[:] = posture
    goal = (bench.robot.forward_kinematics(posture), posture)
    first, normal = goal[0][:3, 3].copy(), PRESS / np.linalg.norm(PRESS)
    steps, delay, late = round(1 / (host * INNER)), round(DELAY / INNER), DELAY + 0.5 / host
    J, sent, put_out, fastest, last = np.zeros((3, model.nv)), [], 0.0, 0.0, 0.0
    for k in range(14000):
        time = k * INNER
        if k % steps == 0:
            sent.append((k + delay, command(bench, form, data.qpos.copy(), data.qvel.copy(), goal, stiffness, late)))
        if sent and sent[0][0] <= k:
            model.actuator_biasprm[:, :3] = sent.pop(0)[1]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        tip = data.xpos[bench.body] + data.xmat[bench.body].reshape(3, 3) @ bench.point
        mujoco.mj_jac(model, data, J, None, tip, bench.body)
        force = (PRESS if wall else PUSH) * (0.05 < time < 0.5)
        if wall:
            force = force - WALL * max(float(normal @ (tip - first)) - 1e-3, 0.0) * normal
        data.qfrc_applied[:] = J.T @ force
        before = J @ data.qvel
        mujoco.mj_step(model, data)
        put_out -= force @ (before + J @ data.qvel) / 2 * INNER
        speed = float(np.abs(data.qvel).max())
        fastest, last = max(fastest, speed), max(last, speed) if k >= 12000 else 0.0
        if not speed < 50 or put_out > 1e-3:  # [rad/s], [J]
            return False
    return last < 0.3 * fastest


def largest(bench: Bench, form: str, host: float, postures: np.ndarray, ladder: tuple[float, float]) -> float:
    """Return the last stiffness [N/m] before the first on the ladder (first, ratio) that fails; 0 without."""
    found, (stiffness, ratio) = 0.0, ladder
    bench.model.actuator_biasprm[:] = 0
    while stiffness < 1e7 and all(
        passes(bench, form, host, stiffness, posture, wall) for wall in (False, True) for posture in postures
    ):
        found, stiffness = stiffness, stiffness * ratio
    return found


def main() -> int:
    """Find the largest stable stiffness of each form at each host rate; return 1 if gains fall below the ratio
    --least.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hosts", type=float, nargs="+", default=[100.0, 200.0, 500.0, 1000.0], help="[Hz]")
    parser.add_argument("--postures", type=int, default=len(POSTURES), help="number of postures")
    parser.add_argument("--ratio", type=float, default=2**0.5, help="of one stiffness to the one before")
    parser.add_argument("--first", type=float, default=1600.0, help="first stiffness [N/m]")
    parser.add_argument("--rotors", type=float, default=1.0, help="factor of the rotors' inertia")
    parser.add_argument("--least", type=float, default=0.0, help="ratio of gains to torque below which this fails")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = make_bench(Path(folder), options.rotors)
        print(f"| host [Hz] | {' | '.join(f'{form} [N/m]' for form in FORMS)} | ratios to torque |")
        print(f"|---|{'---|' * (len(FORMS) + 1)}")
        least = np.inf
        for host in options.hosts:
            ladder = (options.first, options.ratio)
            found = [largest(bench, form, host, POSTURES[: options.postures], ladder) for form in FORMS]
            ratios = [value / found[0] if found[0] else np.inf for value in found[1:]]
            least = min(least, ratios[0])
            row = " | ".join(f"{value:.0f}" for value in found)
            print(f"| {host:.0f} | {row} | {', '.join(f'{ratio:.1f}' for ratio in ratios)} |", flush=True)
    return 0 if least >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
