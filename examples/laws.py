# SPDX-License-Identifier: MIT
"""Five laws that execute policies, from their formulas, and the spring that has the tangent of each at its goal.

A policy sends goals (joint positions, or the pose that belongs to them), and a law turns each into torques. Of the five
laws in use none is the gradient of an energy: a motion round a closed path can gain energy from it. Each law here has a
twin, which is one: a spring at the tip, a quadratic energy of the posture and a damping, with the law's own linear
behaviour at the goal. Feed-forward of gravity and Coriolis forces, filters and rate limits are left out of both.

    python -m examples.laws      prints the table, on a Panda (generated on first use: 1 minute)

Sources of the formulas: facebookresearch/fairo (polymetis, HybridJointSpacePD), rail-berkeley/serl_franka_controllers,
utiasDSL/crisp_controllers, ARISE-Initiative/robosuite (OperationalSpaceController) and isaac-sim/IsaacLab (the same).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import stiffgen

Array = NDArray[np.float64]

PANDA = Path(__file__).resolve().parent.parent / "tests" / "data" / "panda.urdf"
OPTIONS: dict[str, Any] = {"tip": "panda_hand_tcp", "springs": ("bounded", "coupled")}
HOME: Array = np.array([0.0, -0.5, 0.0, -2.1, 0.0, 1.7, 0.8])
"""A posture in the middle of the Panda's range [rad]."""


@dataclass(frozen=True)
class State:
    """Configuration of an arm, or of many: leading dimensions broadcast.

    Attributes:
        q: joint positions (n) [rad].
        dq: joint velocities (n) [rad/s].
        pose: pose of the tip (4, 4) [m].
        J: hybrid Jacobian (6, n).
        M: mass matrix (n, n) [kg m^2].

    """

    q: Array
    dq: Array
    pose: Array
    J: Array
    M: Array

    @staticmethod
    def of(robot: ModuleType, q: ArrayLike, dq: ArrayLike | None = None) -> State:
        """Evaluate a robot's kinematics and inertia; without velocities the arm is at rest."""
        q = np.asarray(q, dtype=float)
        dq = np.zeros_like(q) if dq is None else np.asarray(dq, dtype=float)
        return State(q, dq, robot.forward_kinematics(q), robot.hybrid.jacobian(q), robot.mass_matrix(q))


@dataclass(frozen=True)
class Twin:
    """Energy and damping with the tangent of a law at its goal.

    Attributes:
        spring: group of the spring at the tip.
        parameters: arguments of the spring after the equilibrium.
        posture: stiffness (n, n) of the energy (q - q0) . posture (q - q0) / 2 [N m/rad].
        damping: (n, n) [N m s/rad], symmetric and positive semidefinite.

    """

    spring: str
    parameters: tuple[Any, ...]
    posture: Array
    damping: Array

    def torque(self, robot: ModuleType, goal: State, state: State) -> Array:
        """Return the torque (n) [N m]."""
        at_tip = getattr(robot, self.spring).torque(state.q, goal.pose, *self.parameters)
        return np.asarray(at_tip + times(self.posture, goal.q - state.q) - times(self.damping, state.dq))


@dataclass(frozen=True)
class Law:
    """Law of a project: torque (goal, state), and the twin at a goal."""

    torque: Callable[[State, State], Array]
    twin: Callable[[State], Twin]


def times(A: Array, x: Array) -> Array:
    """Return the product of a matrix and a vector, over leading dimensions."""
    return np.asarray((A @ x[..., None])[..., 0])


def transposed(A: NDArray[np.floating[Any]]) -> Array:
    return np.asarray(np.swapaxes(A, -1, -2), dtype=float)


def symmetric(A: NDArray[np.floating[Any]]) -> Array:
    return np.asarray((A + transposed(A)) / 2, dtype=float)


def pseudo_inverse(A: Array) -> Array:
    return np.asarray(np.linalg.pinv(A), dtype=float)


def positive(A: Array) -> Array:
    """Return the symmetric part of a matrix without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(symmetric(A))
    kept = np.maximum(values, 0)
    return np.asarray(vectors * kept @ vectors.T)


def quaternion(R: Array) -> tuple[Array, Array]:
    """Return scalar part >= 0 (1) and vector part (3) of a rotation's unit quaternion.

    With q = (w, v) the matrix 4 q q^T has the entries 4 w^2 = 1 + trace, 4 w v from R - R^T, and 4 v v^T =
    R + R^T + (1 - trace) 1. Each of its rows is proportional to q; the one with the largest square keeps all digits.
    """
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    trace = np.diagonal(R, axis1=-2, axis2=-1).sum(-1, keepdims=True)
    square = np.zeros((*R.shape[:-2], 4, 4))
    square[..., 0, :], square[..., 1:, 0] = np.concatenate([1 + trace, axial], -1), axial
    square[..., 1:, 1:] = R + transposed(R) + (1 - trace)[..., None] * np.eye(3)
    best = np.argmax(np.diagonal(square, axis1=-2, axis2=-1), axis=-1)[..., None, None]
    row = np.take_along_axis(square, best, axis=-2)[..., 0, :]
    row = row * np.where(row[..., :1] < 0, -1.0, 1.0) / np.linalg.norm(row, axis=-1, keepdims=True)
    unit = np.asarray(row, dtype=float)
    return unit[..., :1], unit[..., 1:]


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3) [rad] of a rotation, at most pi long."""
    cosine, vector = quaternion(R)  # of half the angle; its sine times the axis
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    is_turned = sine > 0
    angle_over_sine = np.where(is_turned, 2 * np.arctan2(sine, cosine) / np.where(is_turned, sine, 1.0), 2.0)
    return np.asarray(vector * angle_over_sine)


def pose_error(goal: State, state: State) -> Array:
    """Return displacement and rotation vector (6) from the tip to the goal, in base axes."""
    turn = goal.pose[..., :3, :3] @ transposed(state.pose[..., :3, :3])
    return np.concatenate([goal.pose[..., :3, 3] - state.pose[..., :3, 3], rotation_vector(turn)], -1)


def mobility(state: State) -> tuple[Array, Array]:
    """Return M^-1 J^T (n, 6) and J M^-1 J^T (6, 6)."""
    lever = np.asarray(np.linalg.solve(state.M, transposed(state.J)), dtype=float)
    return lever, state.J @ lever


def solved(A: Array, b: Array) -> Array:
    """Return A^-1 b, over leading dimensions."""
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])


# polymetis: HybridJointSpacePD, on which DROID's checkpoints and others were trained

KX: Array = np.diag([750.0, 750.0, 750.0, 15.0, 15.0, 15.0])
KXD: Array = np.diag([37.0, 37.0, 37.0, 2.0, 2.0, 2.0])
KQ: Array = np.diag([40.0, 30.0, 50.0, 25.0, 35.0, 25.0, 10.0])
KQD: Array = np.diag([4.0, 6.0, 5.0, 5.0, 3.0, 2.0, 1.0])


def polymetis(goal: State, state: State) -> Array:
    """Return (J^T Kx J + Kq) (q_d - q) - (J^T Kxd J + Kqd) dq."""
    stiffness = transposed(state.J) @ KX @ state.J + KQ
    damping = transposed(state.J) @ KXD @ state.J + KQD
    return times(stiffness, goal.q - state.q) - times(damping, state.dq)


def polymetis_twin(goal: State) -> Twin:
    damping = goal.J.T @ KXD @ goal.J + KQD
    return Twin(spring="spring", parameters=(KX[:3, :3], KX[3:, 3:]), posture=KQ, damping=damping)


# SERL: serl_franka_controllers, CartesianImpedanceController (without its integral, whose gain is 0)

SERL_K: Array = np.diag([2000.0, 2000.0, 2000.0, 150.0, 150.0, 150.0])
SERL_D: Array = np.diag([89.0, 89.0, 89.0, 7.0, 7.0, 7.0])
SERL_CLIP = np.repeat([0.01, 0.05], 3)  # m; vector part of a quaternion
SERL_POSTURE = 0.2 * np.array([100.0, 1, 1, 1, 1, 1, 1])  # the first joint's error has a factor of its own
SERL_POSTURE_DAMPING = 2 * np.sqrt(0.2) * np.array([2 * np.sqrt(100.0), 1, 1, 1, 1, 1, 1])


def serl(goal: State, state: State) -> Array:
    """Return J^T (K clip(e) - D J dq) + (I - J^T J^T+) (posture spring), e with the vector part of a quaternion."""
    R, JT = state.pose[..., :3, :3], transposed(state.J)
    _, vector = quaternion(transposed(R) @ goal.pose[..., :3, :3])  # in the tip's axes
    e = np.concatenate([goal.pose[..., :3, 3] - state.pose[..., :3, 3], times(R, vector)], -1)
    wrench = times(SERL_K, np.clip(e, -SERL_CLIP, SERL_CLIP)) - times(SERL_D, times(state.J, state.dq))
    posture = SERL_POSTURE * (goal.q - state.q) - SERL_POSTURE_DAMPING * state.dq
    return np.asarray(times(JT, wrench) + posture - times(JT, times(pseudo_inverse(JT), posture)))


def serl_twin(goal: State) -> Twin:
    """Return the bounded spring: the vector part of a quaternion is half an angle, so K counts half in rotation."""
    free = np.eye(7) - goal.J.T @ pseudo_inverse(goal.J.T)  # projector on the torques of the self-motion
    Kt, Ko = SERL_K[:3, :3], SERL_K[3:, 3:] / 2
    largest_force, largest_moment = Kt[0, 0] * SERL_CLIP[0], SERL_K[3, 3] * SERL_CLIP[3]
    damping = positive(goal.J.T @ SERL_D @ goal.J + free * SERL_POSTURE_DAMPING)
    spring, posture = (Kt, Ko, largest_force, largest_moment), symmetric(free * SERL_POSTURE)
    return Twin(spring="spring_bounded", parameters=spring, posture=posture, damping=damping)


# CRISP: crisp_controllers, CartesianController, with the kinematic projector

CRISP_K: Array = np.diag([500.0, 500.0, 500.0, 30.0, 30.0, 30.0])
CRISP_POSTURE = 1.0  # N m/rad


def crisp(goal: State, state: State) -> Array:
    """Return J^T (K e - 2 sqrt(K) J dq) + (I - J^+ J) (k (q_d - q) - 2 sqrt(k) dq)."""
    wrench = times(CRISP_K, pose_error(goal, state)) - times(2 * np.sqrt(CRISP_K), times(state.J, state.dq))
    posture = CRISP_POSTURE * (goal.q - state.q) - 2 * np.sqrt(CRISP_POSTURE) * state.dq
    taken = times(pseudo_inverse(state.J), times(state.J, posture))
    return np.asarray(times(transposed(state.J), wrench) + posture - taken)


def crisp_twin(goal: State) -> Twin:
    free = symmetric(np.eye(7) - pseudo_inverse(goal.J) @ goal.J)  # projector on the self-motion
    damping = goal.J.T @ (2 * np.sqrt(CRISP_K)) @ goal.J + 2 * np.sqrt(CRISP_POSTURE) * free
    stiffness = CRISP_K[:3, :3], CRISP_K[3:, 3:]
    return Twin(spring="spring", parameters=stiffness, posture=CRISP_POSTURE * free, damping=damping)


# robosuite: OperationalSpaceController, position and orientation decoupled

ROBOSUITE_KP, ROBOSUITE_POSTURE = 150.0, 10.0  # 1/s^2


def robosuite(goal: State, state: State) -> Array:
    """Return J^T diag(Lp, Lo) (kp e - 2 sqrt(kp) J dq) + (I - J^T L J M^-1) M (k (q_d - q) - 2 sqrt(k) dq)."""
    lever, inverse = mobility(state)  # M^-1 J^T, and L^-1
    wanted = ROBOSUITE_KP * pose_error(goal, state) - 2 * np.sqrt(ROBOSUITE_KP) * times(state.J, state.dq)
    force = solved(inverse[..., :3, :3], wanted[..., :3])
    moment = solved(inverse[..., 3:, 3:], wanted[..., 3:])
    wrench = np.concatenate([force, moment], -1)
    posture = ROBOSUITE_POSTURE * (goal.q - state.q) - 2 * np.sqrt(ROBOSUITE_POSTURE) * state.dq
    posture = times(state.M, posture)
    taken = solved(inverse, times(transposed(lever), posture))  # L J M^-1 times the posture's torque
    return times(transposed(state.J), wrench - taken) + posture


def robosuite_twin(goal: State) -> Twin:
    """Return the spring whose gradient has robosuite's stiffness at the goal: gains times inertia there."""
    # J M^-1 J^T (6, 6); its blocks' inverses are the inertias of robosuite's two decoupled laws
    inverse, R = mobility(goal)[1], goal.pose[:3, :3]
    Lp, Lo = np.linalg.inv(inverse[:3, :3]), np.linalg.inv(inverse[3:, 3:])  # felt at the tip [kg], [kg m^2]
    # part of the mass matrix that the tip's motion takes; the rest belongs to the self-motion
    taken: Any = goal.J.T @ np.linalg.solve(inverse, goal.J)
    free = symmetric(goal.M - taken)
    task = goal.J[:3].T @ Lp @ goal.J[:3] + goal.J[3:].T @ Lo @ goal.J[3:]
    damping = 2 * np.sqrt(ROBOSUITE_KP) * task + 2 * np.sqrt(ROBOSUITE_POSTURE) * free
    stiffness = symmetric(ROBOSUITE_KP * Lp), symmetric(ROBOSUITE_KP * R.T @ Lo @ R)
    return Twin(spring="spring", parameters=stiffness, posture=ROBOSUITE_POSTURE * free, damping=damping)


# Isaac Lab and Newton: OperationalSpaceController with full decoupling and unequal gains

ISAAC_KP = np.repeat([150.0, 100.0], 3)  # 1/s^2
ISAAC_POSTURE = 10.0


def isaac(goal: State, state: State) -> Array:
    """Return J^T L (Kp e - 2 sqrt(Kp) J dq) + (I - J^T L J M^-1) M (k (q_d - q) - 2 sqrt(k) dq)."""
    lever, inverse = mobility(state)  # M^-1 J^T, and L^-1
    wanted = ISAAC_KP * pose_error(goal, state) - 2 * np.sqrt(ISAAC_KP) * times(state.J, state.dq)
    posture = ISAAC_POSTURE * (goal.q - state.q) - 2 * np.sqrt(ISAAC_POSTURE) * state.dq
    posture = times(state.M, posture)
    wrench = solved(inverse, wanted - times(transposed(lever), posture))
    return times(transposed(state.J), wrench) + posture


def isaac_twin(goal: State) -> Twin:
    """Return the coupled spring with the symmetric part of L Kp, in the axes of the equilibrium."""
    L = np.linalg.inv(mobility(goal)[1])
    axes = np.kron(np.eye(2), goal.pose[:3, :3])  # blkdiag(R, R)
    free = symmetric(np.asarray(goal.M - goal.J.T @ L @ goal.J))  # mass of the self-motion
    damping = positive(goal.J.T @ (L * 2 * np.sqrt(ISAAC_KP)) @ goal.J + 2 * np.sqrt(ISAAC_POSTURE) * free)
    coupled = axes.T @ symmetric(L * ISAAC_KP) @ axes
    return Twin(spring="spring_coupled", parameters=(coupled,), posture=ISAAC_POSTURE * free, damping=damping)


LAWS = {
    "polymetis": Law(polymetis, polymetis_twin),
    "SERL": Law(serl, serl_twin),
    "CRISP": Law(crisp, crisp_twin),
    "robosuite": Law(robosuite, robosuite_twin),
    "Isaac Lab": Law(isaac, isaac_twin),
}


def torques(robot: ModuleType, law: Law, goal: State) -> tuple[Callable[[State], Array], Callable[[State], Array]]:
    """Return law and twin at a goal as functions of the state."""
    return partial(law.torque, goal), partial(law.twin(goal).torque, robot, goal)


def tangent(robot: ModuleType, torque: Callable[[State], Array], q: Array, step: float = 2e-4) -> Array:
    """Differentiate a torque at rest: -d torque/dq (n, n), by differences of sixth order."""
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # f'(0) = sum of w_k (f(k h) - f(-k h)) / h, up to h^6
    slopes = np.zeros((len(q), len(q)))  # row i: derivative with respect to joint i
    for k, weight in weights.items():
        moved = k * step * np.eye(len(q))
        slopes += weight * (torque(State.of(robot, q + moved)) - torque(State.of(robot, q - moved))) / step
    return -slopes.T


def orbit_work(
    robot: ModuleType, law: Law, radius: float, count: int, seed: int = 0, nodes: int = 256
) -> tuple[Array, Array]:
    """Return the works (count) [J] of law and twin on circles in joint space, about a point one radius from the goal.

    The sign is that of the direction that gains energy.
    """
    random, t = np.random.default_rng(seed), np.linspace(0, 2 * np.pi, nodes, endpoint=False)
    found = np.zeros((2, count))
    for k in range(count):
        orthonormal, _ = np.linalg.qr(random.normal(size=(7, 3)))
        across, up, to_centre = orthonormal.T  # two axes of the circle's plane, and one from the goal to its centre
        goal = State.of(robot, HOME + random.uniform(-0.3, 0.3, 7))
        q = goal.q + radius * (to_centre + np.outer(np.cos(t), across) + np.outer(np.sin(t), up))
        rate = radius * (np.outer(np.cos(t), up) - np.outer(np.sin(t), across))  # dq/dt
        state = State.of(robot, q)
        for row, torque in enumerate(torques(robot, law, goal)):
            power = (torque(state) * rate).sum(-1)
            found[row, k] = abs(power.mean() * 2 * np.pi)  # integral over t, exact but for harmonics from `nodes` on
    return found[0], found[1]


def recorded() -> Array:
    """Return the motion of a guided arm in the paper's parkour, about HOME (k, 7) [rad], 5 ms apart."""
    from examples.parkour import trajectory

    q = trajectory.recorded()
    return np.asarray(HOME + q - q.mean(0))


TorqueAt = Callable[[State], Callable[[State], Array]]
"""Torque (n) [N m] of a state, at a goal."""


def replay(robot: ModuleType, torque_at: TorqueAt, motion: Array, rotors: ArrayLike = 0.0) -> Array:
    """Let an arm follow a motion with goals at 16.7 Hz (every 60 ms); return its joint positions, 5 ms apart.

    The law runs at 1 kHz; gravity and Coriolis forces are compensated. ``rotors`` (n) [kg m^2] are the motors' inertia.
    """
    step, steps_per_sample, samples_per_goal = 1e-3, 5, 12  # [s]
    q, dq, found = motion[0].copy(), np.zeros(7), []
    motors = np.diag(np.broadcast_to(rotors, 7))
    for k in range(len(motion)):
        if k % samples_per_goal == 0:
            torque = torque_at(State.of(robot, motion[k]))
        for _ in range(steps_per_sample):
            state = State.of(robot, q, dq)
            dq = dq + step * np.linalg.solve(state.M + motors, torque(state))
            q = q + step * dq
        found.append(q)
    return np.array(found)


def replayed_difference(robot: ModuleType, law: Law, motion: Array) -> tuple[float, float, float]:
    """Return rms of tip to goal under the law, rms and maximum between tips under law and twin [m]."""
    of_law = _replayed_tips(robot, _of_law(law), motion)
    of_twin = _replayed_tips(robot, lambda goal: torques(robot, law, goal)[1], motion)
    lag = of_law - _tips(robot, motion)
    apart = np.linalg.norm(of_law - of_twin, axis=1)
    return float(np.sqrt((lag**2).sum(1).mean())), float(np.sqrt((apart**2).mean())), float(apart.max())


def _of_law(law: Law) -> TorqueAt:
    return lambda goal: partial(law.torque, goal)


def _tips(robot: ModuleType, q: Array) -> Array:
    """Return the positions of the tip (k, 3) [m] at joint positions (k, n)."""
    return np.asarray(robot.forward_kinematics(q)[:, :3, 3])


def _replayed_tips(robot: ModuleType, torque_at: TorqueAt, motion: Array, rotors: ArrayLike = 0.0) -> Array:
    """Return the positions of the tip (k, 3) [m] of an arm that follows a motion (:func:`replay`)."""
    return _tips(robot, replay(robot, torque_at, motion, rotors))


PRESETS = {"droid": "polymetis", "serl": "SERL", "crisp": "CRISP"}
"""Presets (:func:`stiffgen.law_preset`), and their laws."""
ROTORS: Array = np.array([0.605721456] * 2 + [0.462474144] * 2 + [0.205544064] * 3)
"""Inertia of the FR3's motors at the joints [kg m^2], which Franka states."""
HEAVIEST = (100.0, 30.0)
"""Heaviest force [N] and moment [N m] of the controller's springs on the way."""


def controller(robot: ModuleType, preset: str) -> tuple[Any, dict[str, Any]]:
    """Return the controller with a preset's fields, and the springs to command at every step."""
    fields, springs = stiffgen.law_preset(preset)
    arm = {"sample_time": 1e-3, "delay_samples": 0, "motor_inertia": ROTORS, "heaviest_wrench": HEAVIEST}
    return robot.Impedance(**arm, **fields), springs


def serve(robot: ModuleType, preset: str) -> TorqueAt:
    """Return the controller with a preset, in place of a law; poses of goals go through policy port and Follow."""
    law, springs = controller(robot, preset)
    makers: list[Any] = []
    steps = 0

    def torque_at(goal: State) -> Callable[[State], Array]:
        """Return the torque function of a goal; the first goal places policy and follower."""
        if not makers:  # the first goal is the arm's
            makers[:] = robot.Policy(pose=goal.pose, now=0.0), robot.Follow(goal.q, sample_time=1e-3)
        port, follow = makers
        refused = port.propose(now=1e-3 * steps, time=1e-3 * steps, pose=goal.pose)
        if refused:
            raise ArithmeticError(f"the port refuses {refused}")

        def torque(state: State) -> Array:
            nonlocal steps
            steps += 1
            q0 = follow.step(pose=port.command(1e-3 * steps).pose, posture=goal.q).q0
            output = law.step(q=state.q, dq=state.dq, q0=q0, shaped=True, counter=steps, **springs)
            return np.asarray(output.torque)

        return torque

    return torque_at


def served_rows(robot: ModuleType, samples: int = 1200) -> list[tuple[str, ...]]:
    """Return the table of presets: lags of law and of controller, and rms and maximum between their tips."""
    made: list[tuple[str, ...]] = []
    motion = recorded()[:samples]
    wanted = _tips(robot, motion)
    for preset, name in PRESETS.items():
        law = _replayed_tips(robot, _of_law(LAWS[name]), motion, ROTORS)
        served = _replayed_tips(robot, serve(robot, preset), motion, ROTORS)
        squares = [((a - b) ** 2).sum(1) for a, b in ((law, wanted), (served, wanted), (law, served))]  # [m^2]
        lengths = [*(np.sqrt(each.mean()) for each in squares), np.sqrt(squares[-1].max())]
        made.append((f'"{preset}"', name, *(f"{1e3 * each:.1f} mm" for each in lengths)))
    return made


def turned(robot: ModuleType, law: Law, angles: ArrayLike) -> tuple[Array, Array]:
    """Return the torques of joint 7 [N m] of law and twin, joint 7 turned beyond the goal by angles [rad]."""
    goal = State.of(robot, np.append(HOME[:6], -2.6))  # joint 7 near its lower limit, so that it can turn far
    state = State.of(robot, goal.q + np.multiply.outer(np.asarray(angles), np.eye(7)[6]))
    one, other = (torque(state)[..., 6] for torque in torques(robot, law, goal))
    return one, other


def panda() -> ModuleType:
    """Return the module of the Panda with the springs of the twins."""
    return stiffgen.load(PANDA, **OPTIONS).module


QUANTITIES = (
    "law", "asymmetric at rest", "work a lap, median", "work a lap, largest", "twin's, largest", "tip to goal, rms",
    "twin apart, rms", "twin apart, largest", "joint 7 at 90, 170, 190 deg", "the twin's",
)  # fmt: skip


def rows(robot: ModuleType, orbits: int = 300, samples: int = 1200) -> list[tuple[str, ...]]:
    """Return the table: a column for each law, with units in the entries."""
    motion = recorded()[:samples]
    columns = [QUANTITIES, *(_column(robot, name, law, orbits, motion) for name, law in LAWS.items())]
    return list(zip(*columns, strict=True))


def _column(robot: ModuleType, name: str, law: Law, orbits: int, motion: Array) -> tuple[str, ...]:
    """Return the entries of a law, in the order of QUANTITIES."""
    K = tangent(robot, torques(robot, law, State.of(robot, HOME))[0], HOME)
    antisymmetric = np.linalg.norm(K - K.T, 2) / 2
    works, twins = orbit_work(robot, law, 0.2, orbits)
    lag, rms, largest = replayed_difference(robot, law, motion)
    one, other = turned(robot, law, np.radians([90, 170, 190]))
    return (
        name,
        "below 1e-6 N m/rad" if antisymmetric < 1e-6 else f"{antisymmetric:.2g} N m/rad",
        f"{np.median(works):.2g} J", f"{works.max():.2g} J",
        "below 1e-10 J" if twins.max() < 1e-10 else f"{twins.max():.1e} J",
        f"{1e3 * lag:.1f} mm", f"{1e3 * rms:.2f} mm", f"{1e3 * largest:.2f} mm",
        ", ".join(f"{each:.3g}" for each in one) + " N m", ", ".join(f"{each:.3g}" for each in other) + " N m",
    )  # fmt: skip


def main() -> None:
    """Print both tables."""
    robot = panda()
    for row in (*rows(robot), *served_rows(robot)):
        print(" | ".join(row))


if __name__ == "__main__":
    main()
