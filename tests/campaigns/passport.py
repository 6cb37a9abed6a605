# SPDX-License-Identifier: MIT
"""Compare the stiffness passport with MuJoCo: where does the sampled loop of eight arms put out energy?

    python tests/campaigns/passport.py [--arms iiwa14,ur5] [--postures 3] [--loops 0 1 2] [--seed 1] [--controller]
    python tests/campaigns/passport.py --sweep [--postures 200]

MuJoCo reads each robot's file. A spring (translation k, rotation 0.05 m^2 k) with the controller's damping law runs at
a rate, with a delay and an encoder; no cap acts. Without an encoder step the velocity is exact; with one, positions
are rounded to it and the velocity is their difference over one sample.

A stiffness passes if the arm, pushed at the tip in a random direction and let go, loses energy: the largest energy of
the last quarter of the episode is below that of the quarter before it, or below a hundredth of the first. The result is
the stiffness below the first one that fails, up to 1 %. Slow cycles along every mode, too, must cost work. The
passport's limit is within 20 % of both, and at most 5 % above.

In the first posture the tip is also held by an undamped spring, of growing stiffness, while the loop renders its
stiffness in full: the sum of both stiffnesses up to which energy is lost has the same bounds. Damping ratios are those
of recursions that fit the motion after a push; they agree up to 0.02.

With --controller, the limit up to which the C controller renders springs in full (status STIFFNESS_CAPPED) is found by
bisection, and compared up to 2 %.

The force available is compared with MuJoCo's inverse dynamics: at this force one joint is at its effort limit.

With --sweep, no simulation: the eigenvalues of the sampled loop at the stiffness cap, with MuJoCo's mass matrix and
Jacobian, in 75 loops of three rates, delays of 0 to 5 samples and encoder steps up to 1e-3. The least damping ratio of
each arm is printed, and has to be above 0.1.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import stiffgen
from stiffgen.control.presets import motor_tables
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.lab.passport.loop import Arms, LoopTiming, damping_attained, rendered_limit
from stiffgen.lab.passport.passport import PassportOptions, make_passport
from stiffgen.lab.passport.statics import DIRECTIONS, UNITS
from support.project import ROOT

DATA = ROOT / "tests" / "data"
ARMS: dict[str, tuple[Path, str | None]] = {
    "iiwa7": (ROOT / "urdf" / "iiwa7.urdf", None),
    "iiwa14": (ROOT / "urdf" / "iiwa14.urdf", None),
    "med7": (ROOT / "urdf" / "med7.urdf", None),
    "med14": (ROOT / "urdf" / "med14.urdf", None),
    "panda": (DATA / "panda.urdf", "panda_hand_tcp"),
    "ur5": (DATA / "ur5.urdf", "tool0"),
    "j2s6s200": (DATA / "j2s6s200.urdf", "j2s6s200_end_effector"),
    "dual_arm": (DATA / "dual_arm.urdf", "left hand"),
}
"""File and tip of each arm; of the robot with two arms, one."""
LOOPS = (LoopTiming(1000.0, 0, 0.0), LoopTiming(1000.0, 1, 1e-5), LoopTiming(500.0, 1, 0.0), LoopTiming(250.0, 2, 1e-4))
SWEPT = [
    LoopTiming(rate, delay, quantum)
    for rate in (1000.0, 500.0, 250.0)
    for delay in (0, 1, 2, 3, 5)
    for quantum in (0.0, 1e-6, 1e-5, 1e-4, 1e-3)
]
"""Loops of --sweep."""
LEAST_DAMPING = 0.1
"""Damping ratio that --sweep asks for at the cap."""
ROTATION = 0.05
"""[m^2] rotational over translational stiffness."""
SAMPLES = 400
"""Samples of an episode."""
ABOVE, BELOW = 0.05, 0.20
"""Largest shares by which the passport may be above and below the simulation."""


@dataclass(frozen=True)
class Plant:
    """Robot's functions, MuJoCo's model without contacts and gravity, and the tip: body, and point in it."""

    robot: GeneratedRobot
    model: mujoco.MjModel
    data: mujoco.MjData
    body: int
    point: np.ndarray
    gravity: np.ndarray

    @classmethod
    def load(cls, name: str, folder: Path, controller: bool) -> Plant:
        """Generate an arm, and set up MuJoCo from the same file; joints that are not the arm's are fixed."""
        file, tip = ARMS[name]
        robot = open_robot(stiffgen.generate(file, tip=tip, name=name, output=folder, controller=controller))
        spec = mujoco.MjSpec.from_file(str(file))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        others = [joint for joint in spec.joints if joint.name not in robot.module.JOINTS]
        for element in (*spec.equalities, *others):
            spec.delete(element)
        model = spec.compile()
        assert [model.joint(k).name for k in range(model.njnt)] == list(robot.module.JOINTS)
        model.jnt_limited[:] = 0
        model.dof_damping[:] = model.dof_frictionloss[:] = 0
        model.dof_armature[:] = motor_tables(robot.chain).motor_inertia
        gravity, data = model.opt.gravity.copy(), mujoco.MjData(model)
        model.opt.gravity[:] = 0
        mujoco.mj_forward(model, data)
        body = int(model.jnt_bodyid[-1])
        away = robot.module.forward_kinematics(data.qpos)[:3, 3] - data.xpos[body]
        return cls(robot, model, data, body, data.xmat[body].reshape(3, 3).T @ away, gravity)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's Jacobian of the tip (6, n) in base axes."""
        J = np.zeros((6, self.model.nv))
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        tip = self.data.xpos[self.body] + self.data.xmat[self.body].reshape(3, 3) @ self.point
        mujoco.mj_jac(self.model, self.data, J[:3], J[3:], tip, self.body)
        return J

    def mass(self, q: np.ndarray) -> np.ndarray:
        """Return MuJoCo's mass matrix with rotors (n, n)."""
        M = np.zeros((self.model.nv, self.model.nv))
        self.data.qpos[:], self.data.qvel[:] = q, 0
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_fullM(self.model, self.data, M)
        return M


class Law:
    """Springs and modal damping at a posture, sampled, late, with an encoder; written from docs/controller.md."""

    def __init__(self, plant: Plant, posture: np.ndarray, k: float, timing: LoopTiming) -> None:
        """Linearise plant and controller at the posture; `k` is the translation stiffness [N/m]."""
        self.module, self.posture, self.k, self.timing = plant.robot.module, posture, k, timing
        self.pose = self.module.forward_kinematics(posture)
        n, J, M = len(posture), plant.jacobian(posture), plant.mass(posture)
        self.Kq = J.T @ np.diag([k] * 3 + [ROTATION * k] * 3) @ J + np.eye(n)
        root = np.linalg.cholesky(M)
        inverse = np.linalg.inv(root)
        self.values, vectors = np.linalg.eigh(inverse @ self.Kq @ inverse.T)
        self.modes = inverse.T @ vectors  # M-orthonormal columns
        self.B = self.design(root @ vectors, float(np.trace(np.linalg.inv(M))))
        self.rounds = True
        self.before = posture
        self.sent = [np.zeros(n)] * timing.delay

    def design(self, rows: np.ndarray, trace: float) -> np.ndarray:
        """Return the damping matrix (n, n); rows: M V, trace: of the inverse of M."""
        T, late, zeta, size = (
            1 / self.timing.rate,
            (self.timing.delay + 0.5) / self.timing.rate,
            0.7,
            np.abs(self.values),
        )
        most = min(0.25, 0.75 / (1 + self.timing.delay)) / T
        joint = min(0.1, 0.5 * most / trace)
        p = size * late * (2 * zeta**2 - 1)
        b = np.maximum(np.sqrt(np.maximum(p * p + 4 * zeta**2 * size - (size * late) ** 2, 0)) - p, size * late)
        return np.asarray(rows @ np.diag(np.minimum(b, most - joint * trace)) @ rows.T + joint * np.eye(len(rows)))

    def energy(self, q: np.ndarray) -> float:
        """Return the springs' energy [J]."""
        away = q - self.posture
        of_tip = self.module.spring.energy(q, self.pose, self.k * np.eye(3), ROTATION * self.k * np.eye(3))
        return float(of_tip + 0.5 * away @ away)

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the torque that acts until the next sample, from the state at a sample."""
        quantum = self.timing.quantum
        if quantum > 0:
            q = np.round(q / quantum) * quantum if self.rounds else q
            v, self.before = (q - self.before) * self.timing.rate, q
        spring = self.module.spring.torque(q, self.pose, self.k * np.eye(3), ROTATION * self.k * np.eye(3))
        self.sent.append(spring - (q - self.posture) - self.B @ v)
        return self.sent.pop(0)


@contextmanager
def held_by(stiffness: np.ndarray, posture: np.ndarray) -> Iterator[None]:
    """Let a joint stiffness (n, n) act about a posture in every evaluation of MuJoCo."""

    def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_passive[:] -= stiffness @ (data.qpos - posture)

    mujoco.set_mjcb_passive(act if stiffness.any() else None)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)


def loses_energy(plant: Plant, posture: np.ndarray, k: float, timing: LoopTiming, wall: float = 0.0) -> bool:
    """Return whether an arm that was pushed loses its energy; wall: stiffness of what holds the tip [N/m]."""
    law, random = Law(plant, posture, k, timing), np.random.default_rng(1)
    model, data = plant.model, plant.data
    J, M = plant.jacobian(posture), plant.mass(posture)
    of_wall = wall * J.T @ np.diag([1.0] * 3 + [ROTATION] * 3) @ J  # stiffness of the wall in the joints (n, n)
    mujoco.mj_resetData(model, data)
    data.qpos[:] = posture
    steps = 8 if wall else 2
    model.opt.timestep = 1 / (steps * timing.rate)
    swing = max(
        2e-3, 300 * timing.quantum
    )  # [rad or m] of the fastest joint: far above what the encoder's steps excite
    energies = np.zeros(SAMPLES)
    for sample in range(SAMPLES):
        if sample == 0:  # a push so short that it is a velocity, in every direction of the tip
            v = np.linalg.solve(M, J.T @ (random.normal(size=6) * [1, 1, 1, 0.2, 0.2, 0.2]))  # shares of push and turn
            data.qvel[:] = v * swing * np.sqrt(law.values[-1]) / np.abs(v).max()
        data.qfrc_applied[:] = law.torque(data.qpos.copy(), data.qvel.copy())
        with held_by(of_wall, posture):
            mujoco.mj_step(model, data, steps)
        if not np.abs(data.qpos - posture).max() < 10 * swing:
            return False
        away = data.qpos - posture
        energies[sample] = law.energy(data.qpos) + 0.5 * (data.qvel @ M @ data.qvel + away @ of_wall @ away)
    # over 100 samples: the energy swings with the motion
    first, third, last = energies[:100].max(), energies[-200:-100].max(), energies[-100:].max()
    return bool(last < third or last < 1e-2 * first)


def takes_work(plant: Plant, posture: np.ndarray, k: float, timing: LoopTiming) -> bool:
    """Return whether slow cycles of 400 samples along every mode cost work: the held, late torques put out none."""
    period, swing, law = 400, max(1e-3, 100 * timing.quantum), Law(plant, posture, k, timing)
    phase = 2 * np.pi / period * np.arange(period + 21)
    for number in range(len(posture))[::-1]:  # the stiffest first
        shape = law.modes[:, number] / np.abs(law.modes[:, number]).max() * swing
        path = posture + np.sin(phase)[:, None] * shape
        speed = np.cos(phase)[:, None] * shape * 2 * np.pi / period * timing.rate
        work = 0.0
        for sample in range(period + 20):
            torque = law.torque(path[sample], speed[sample])
            work += torque @ (path[sample + 1] - path[sample]) * (sample >= 20)  # without the first, from rest
        if work > 0:
            return False
    return True


def least_damping(plant: Plant, posture: np.ndarray, k: float, timing: LoopTiming) -> float:
    """Return the least damping ratio of all modes: each is pushed alone, and its motion identified as a recursion."""
    model, data, M, found = plant.model, plant.data, plant.mass(posture), []
    model.opt.timestep = 0.5 / timing.rate
    for number in range(len(posture)):
        law = Law(plant, posture, k, timing)
        law.rounds = False  # the encoder's steps would hide the decay
        mujoco.mj_resetData(model, data)
        data.qpos[:] = posture
        shape = law.modes[:, number]
        data.qvel[:] = 1e-4 * np.sqrt(law.values[number]) * shape / np.abs(shape).max()
        motion = []
        for _ in range(80):
            motion.append(shape @ M @ (data.qpos - posture))
            data.qfrc_applied[:] = law.torque(data.qpos.copy(), data.qvel.copy())
            mujoco.mj_step(model, data, 2)
        order = 2 + timing.delay + int(timing.quantum > 0)
        rows = np.array([motion[i : i + order] for i in range(len(motion) - order)])
        recursion = np.linalg.lstsq(rows, np.array(motion[order:]), rcond=1e-9)[0]
        roots = np.roots([1.0, *-recursion[::-1]])
        exponent = np.log(roots[np.abs(roots).argmax()] + 0j)
        found.append(-exponent.real / abs(exponent))
    return min(found)


def largest(passes: Any) -> float:
    """Return the stiffness [N/m] below the first one that fails, up to 1 %; the ladder knows no expectation."""
    low, high = 0.0, 150.0
    while passes(high):
        low, high = high, 2 * high
    while high > 1.01 * low:
        middle = np.sqrt(low * high) if low else 0.5 * high
        low, high = (middle, high) if passes(middle) else (low, middle)
        if high < 1:
            return 0.0
    return low


def capped_from(robot: GeneratedRobot, posture: np.ndarray, timing: LoopTiming) -> float:
    """Return the stiffness [N/m] below which the C controller never says STIFFNESS_CAPPED, up to 0.1 %."""
    module, n = robot.module, len(posture)
    config = {
        "sample_time": 1 / timing.rate, "delay_samples": timing.delay, "heaviest_wrench": (100.0, 20.0),
        "motor_inertia": motor_tables(robot.chain).motor_inertia, "lower_limit": -np.inf, "upper_limit": np.inf,
    }  # fmt: skip

    def passes(k: float) -> bool:
        springs = {"translation_stiffness": k * np.eye(3), "rotation_stiffness": ROTATION * k * np.eye(3)}
        controller = module.Impedance(**config, errors="ignore")
        for counter in range(3):
            out = controller.step(q=posture, dq=np.zeros(n), q0=posture, counter=counter, **springs)
        return not out.status & (module.Status.STIFFNESS_CAPPED | module.Status.COMMAND_REFUSED)

    low, high = 1.0, 1e6
    while high > 1.001 * low:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def effort_share(plant: Plant, posture: np.ndarray, force: np.ndarray) -> float:
    """Return the largest torque over its limit while the tip at rest exerts a force: MuJoCo's inverse dynamics."""
    plant.model.opt.gravity[:] = plant.gravity
    J = plant.jacobian(posture)
    plant.data.qvel[:], plant.data.qacc[:] = 0, 0
    plant.data.qfrc_applied[:] = 0
    mujoco.mj_inverse(plant.model, plant.data)
    torque = plant.data.qfrc_inverse + J[:3].T @ force
    plant.model.opt.gravity[:] = 0
    return float((np.abs(torque) / np.array(plant.robot.module.EFFORT)).max())


@dataclass(frozen=True)
class Row:
    """Passport over simulation in one posture, and the damping ratios of both; contact: spring and environment."""

    limit: float
    stable: float
    passive: float
    contact: float
    damping: tuple[float, float]
    rendered: float = 1.0

    @property
    def passed(self) -> bool:
        """Whether the limits are within the bar; the controller within 2 %, the damping ratio within 0.02."""
        inside = all(
            1 / (1 + BELOW) <= each <= 1 + ABOVE for each in (self.limit, self.stable, self.passive, self.contact)
        )
        return inside and abs(self.rendered - 1) < 0.02 and abs(self.damping[0] - self.damping[1]) < 0.02


def compare(plant: Plant, timing: LoopTiming, postures: np.ndarray, controller: bool) -> list[Row]:
    """Compare the passport with the simulation in some postures."""
    passport, rows = make_passport(plant.robot, PassportOptions(timing), postures), []
    for number, posture in enumerate(postures):
        stable = largest(lambda k, q=posture: loses_energy(plant, q, k, timing))
        passive = largest(lambda k, q=posture: takes_work(plant, q, k, timing))
        rendered = float(passport["rendered"][number])
        contact = float(passport["contact"][number])
        if number == 0:  # it takes longest
            contact = largest(lambda k, q=posture, of=rendered: loses_energy(plant, q, of, timing, k))
        attained = least_damping(plant, posture, rendered, timing)
        capped = capped_from(plant.robot, posture, timing) if controller else rendered
        rows.append(
            Row(
                passport["limit"][number] / min(stable, passive),
                passport["stable"][number] / stable,
                passport["passive"][number] / passive,
                (rendered + passport["contact"][number]) / (rendered + contact),
                (float(passport["damping"][number]), attained),
                rendered / capped,
            )
        )
        for direction, name in zip(UNITS, DIRECTIONS, strict=True):
            force = passport[f"force {name}"][number]
            share = effort_share(plant, posture, force * direction)
            is_held = abs(share - 1) < 1e-6 if force > 0 else share > 1  # gravity alone takes all torque
            assert is_held, f"{force} N along {name}: {share:.6f} of an effort limit"
    return rows


def sweep_caps(plant: Plant, postures: np.ndarray) -> tuple[float, LoopTiming]:
    """Return the least damping ratio at the stiffness cap of all postures and loops, and its loop."""
    mass = np.array([plant.mass(q) for q in postures])
    jacobian = np.array([plant.jacobian(q) for q in postures])
    arms = Arms(mass, jacobian, ROTATION)
    found = [(damping_attained(arms, rendered_limit(arms, timing), timing).min(), timing) for timing in SWEPT]
    least, timing = min(found, key=lambda each: each[0])
    return float(least), timing


def main() -> int:
    """Compare the passport's limits with simulations of the loop; return 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", default=",".join(ARMS), help="names with commas")
    parser.add_argument("--postures", type=int, default=3, help="postures of each arm")
    parser.add_argument("--loops", type=int, nargs="+", default=range(len(LOOPS)), help="numbers of the loops")
    parser.add_argument("--seed", type=int, default=1, help="of the postures")
    parser.add_argument("--sweep", action="store_true", help="only the damping ratios at the cap, in many loops")
    parser.add_argument("--controller", action="store_true", help="compare with the C controller, too")
    options = parser.parse_args()
    random, passed = np.random.default_rng(options.seed), True
    if not options.sweep:
        print("| arm | loop | limit | stable | passive | contact | rendered | damping ratio: passport, simulation |")
        print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in options.arms.split(","):
            plant = Plant.load(name, Path(folder), options.controller)
            low, high = plant.robot.module.LOWER, plant.robot.module.UPPER
            low = np.maximum(low, np.minimum(high, np.pi) - 2 * np.pi)
            postures = random.uniform(low, np.minimum(high, low + 2 * np.pi), (options.postures, len(low)))
            if options.sweep:
                least, at = sweep_caps(plant, postures)
                passed &= least > LEAST_DAMPING
                print(f"{name}: least damping ratio at the cap {least:.3f}, at {at.text}", flush=True)
                continue
            for number in options.loops:
                timing = LOOPS[number]
                rows = compare(plant, timing, postures, options.controller)
                passed &= all(row.passed for row in rows)
                cells = [
                    _span([getattr(row, each) for row in rows]) for each in ("limit", "stable", "passive", "contact")
                ]
                cells.append(_span([row.rendered for row in rows]) if options.controller else "")
                cells.append("; ".join(f"{own:.3f}, {other:.3f}" for own, other in (row.damping for row in rows)))
                loop = f"{timing.rate:g} Hz, delay {timing.delay}, step {timing.quantum:g}"
                print(f"| {name} | {loop} | {' | '.join(cells)} |", flush=True)
    return 0 if passed else 1


def _span(values: list[float]) -> str:
    return f"{min(values):.3f} to {max(values):.3f}"


if __name__ == "__main__":
    sys.exit(main())
