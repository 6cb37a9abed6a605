# SPDX-License-Identifier: MIT
"""State the optimal control problem: configurations and task stiffnesses for a desired joint stiffness.

At every knot k of the trajectory the unknowns are the joint positions q_k and a task stiffness K_k (6, 6). The tool's
pose leaves q_k one degree of freedom, the elbow's. The joint stiffness under the load F_k is

    S_k = Kq(q_k, F_k, K_k) + Kp,    Kp = POSTURE_STIFFNESS I.

The cost is the distance to the desired joint stiffness W, every entry relative to the diagonal entries of its joints,

    sum_k sum_ij (S_k - W)_ij^2 / (W_ii W_jj)  +  cost of changes of q and K from knot to knot.

The constraints are:

- The tool has the pose of the trajectory.
- S_k - LEAST I is positive definite: C_k C_k^T = S_k - LEAST I with a lower triangular C_k.
- K_k = D (L_k L_k^T + FLOOR I) D is positive definite by construction (L_k lower triangular, D the usual size of a
  stiffness), and its diagonal stays below a limit.
- Joints stay within their limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from examples.bowl_wiping.trajectory import RECORDED

Array = NDArray[np.float64]

PAPER_STIFFNESS: Array = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
"""The paper's, constant along the trajectory [N/m, N m/rad]."""
POSTURE_STIFFNESS = 5.0
"""[N m/rad] of every joint."""
WANTED: Array = np.diag([200.0, 200.0, 120.0, 120.0, 40.0, 30.0, 15.0])
"""[N m/rad]: joints that give way independently of each other, the shoulder stiffer than the wrist."""
LEAST = 2.0
"""[N m/rad] The smallest eigenvalue of the joint stiffness that is allowed."""
SCALE: Array = np.sqrt([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
"""D: square roots of the usual entries."""
FLOOR = 0.05
"""Part of the usual size below which no direction of a task stiffness falls."""
LIMIT: Array = np.array([3000.0, 3000.0, 3000.0, 200.0, 200.0, 200.0])
"""Bounds of the diagonal of a task stiffness [N/m, N m/rad]."""
PRESS, FRICTION = 80.0, 0.3
"""[N] with which the tool presses, along its z axis, and the friction's part of it, against the direction of travel."""
SMOOTH_POSTURE, SMOOTH_STIFFNESS = 0.5, 0.02
"""Costs of a change of the posture beyond the recording's [per rad^2] and of L [per 1] from knot to knot."""
LOWER = np.tril_indices(6)
"""Rows and columns of the lower triangle of a task stiffness."""
SIZE: Array = np.sqrt(np.diag(WANTED))
"""Scale of each joint, by which residuals of stiffness are divided: they are about 1."""
OUTPUT: dict[str, Any] = {
    "print_time": False,
    "record_time": True,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
}
"""Settings of IPOPT's output."""
SETTINGS: dict[str, Any] = {
    "ipopt.max_iter": 3000,
    "ipopt.limited_memory_max_history": 20,
    "ipopt.tol": 1e-5,
    "ipopt.acceptable_tol": 1e-4,
    "ipopt.acceptable_iter": 10,
}
"""Settings of IPOPT's search."""


@dataclass(frozen=True)
class Task:
    """Data at each knot: recorded configurations (N, 7) [rad], tool poses (N, 4, 4), wrenches (N, 6) [N, N m]."""

    recorded: Array
    poses: Array
    wrenches: Array


@dataclass(frozen=True)
class Solution:
    """Postures (N, 7) [rad], task stiffnesses (N, 6, 6), the cost, and how the solver found them."""

    q: Array
    task_stiffness: Array
    cost: float
    iterations: int
    seconds: float
    evaluating: float
    """Part of these seconds in the functions and their derivatives [s]."""


def bowl_task(robot: Any, knots: int) -> Task:
    """Return the recorded bowl trajectory at equally spaced samples of its way there; ``robot`` is the NumPy module."""
    recorded = np.loadtxt(RECORDED, delimiter=",").T
    half = recorded[: len(recorded) // 2]
    samples = np.linspace(0, len(half) - 1, knots).round().astype(int)
    q = half[samples]
    poses = np.asarray(robot.forward_kinematics(q))
    ahead = robot.forward_kinematics(half[np.minimum(samples + 40, len(half) - 1)])
    behind = robot.forward_kinematics(half[np.maximum(samples - 40, 0)])
    travel = ahead[:, :3, 3] - behind[:, :3, 3]
    travel /= np.linalg.norm(travel, axis=1)[:, None]
    force = -PRESS * (poses[:, :3, 2] + FRICTION * travel)  # of the bowl on the tool
    return Task(q, poses, np.concatenate([force, np.zeros_like(force)], axis=1))


def joint_stiffness(robot: Any, task: Task, q: Array, task_stiffness: Array) -> Array:
    """Return S of every knot (N, 7, 7) [N m/rad]; ``robot`` is the NumPy module."""
    return np.asarray(robot.hybrid.joint_stiffness(q, task.wrenches, task_stiffness) + POSTURE_STIFFNESS * np.eye(7))


def distance(stiffness: Array) -> Array:
    """Return the distance to the desired joint stiffness, as in the cost, of matrices (..., 7, 7)."""
    return np.asarray((((stiffness - WANTED) / np.outer(SIZE, SIZE)) ** 2).sum((-1, -2)))


def _upper(matrix: Any) -> Any:
    """Return the entries of a symmetric matrix from the diagonal up, as a vector."""
    rows, columns = np.triu_indices(matrix.shape[0])
    return ca.vertcat(*(matrix[int(i), int(j)] for i, j in zip(rows, columns, strict=True)))


def _triangle(entries: Any, size: int) -> Any:
    """Return the lower triangular matrix of entries, row by row."""
    matrix = ca.MX(size, size)
    for e, (i, j) in enumerate(zip(*np.tril_indices(size), strict=True)):
        matrix[int(i), int(j)] = entries[e]
    return matrix


@dataclass(frozen=True)
class Knot:
    """Unknowns of a knot: posture (7) [rad], entries of L (21), and entries of C (28), its rows divided by SIZE.

    ``stiffness`` is S (7, 7) as an expression of them.
    """

    q: Any
    entries: Any
    square: Any
    stiffness: Any


def _add_knot(opti: Any, functions: Any, robot: Any, task: Task, k: int) -> Knot:
    """Add the unknowns of knot ``k`` and their constraints to the problem."""
    q, entries, square = opti.variable(7), opti.variable(21), opti.variable(28)
    L, root = _triangle(entries, 6), _triangle(square, 7)
    K = ca.DM(np.outer(SCALE, SCALE)) * (ca.mtimes(L, L.T) + FLOOR * ca.DM.eye(6))
    S = functions.hybrid.joint_stiffness(q, task.wrenches[k], K) + POSTURE_STIFFNESS * ca.DM.eye(7)
    pose = functions.forward_kinematics(q)
    turn = ca.mtimes(pose[:3, :3].T, ca.DM(task.poses[k, :3, :3]))
    # the tip is at the task's pose; 0.1 m counts as much as a turn whose sine is 1/2
    opti.subject_to(10 * (pose[:3, 3] - task.poses[k, :3, 3]) == 0)
    opti.subject_to(ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) == 0)
    C = ca.mtimes(ca.DM(np.diag(SIZE)), root)
    weight = ca.DM(1 / np.outer(SIZE, SIZE))
    opti.subject_to(_upper(weight * (S - LEAST * ca.DM.eye(7) - ca.mtimes(C, C.T))) == 0)
    opti.subject_to(opti.bounded(robot.LOWER, q, robot.UPPER))
    opti.subject_to(ca.diag(K) / LIMIT <= 1)
    return Knot(q, entries, square, S)


def solve(
    functions: Any, robot: Any, task: Task, *, exact_hessian: bool = False, options: dict[str, Any] | None = None
) -> Solution:
    """Solve the problem.

    Args:
        functions: forward_kinematics and hybrid.joint_stiffness as ``casadi.Function``: a ``StiffnessModel``, whose
            functions are graphs that CasADi differentiates, or ``NAME.casadi``, compiled with their products.
        robot: the NumPy module.
        task: what is given.
        exact_hessian: of the Lagrangian, which needs second derivatives; else IPOPT builds one up from gradients.
        options: IPOPT's, further ones.

    Raises:
        RuntimeError: IPOPT did not converge.

    """
    opti, starts = ca.Opti(), _starting_roots(robot, task)
    weight = ca.DM(1 / np.outer(SIZE, SIZE))
    cost: Any = 0
    knots: list[Knot] = []
    for k, recorded in enumerate(task.recorded):
        knot = _add_knot(opti, functions, robot, task, k)
        # stiffness near the wanted one, and small steps from knot to knot
        cost += ca.sumsqr(ca.sqrt(weight) * (knot.stiffness - WANTED) * ca.sqrt(weight))
        if knots:
            step, recorded_step = knot.q - knots[-1].q, recorded - task.recorded[k - 1]
            cost += SMOOTH_POSTURE * len(task.recorded) * ca.sumsqr(step - recorded_step)
            cost += SMOOTH_STIFFNESS * len(task.recorded) * ca.sumsqr(knot.entries - knots[-1].entries)
        opti.set_initial(knot.q, recorded)
        opti.set_initial(knot.entries, np.eye(6)[LOWER])
        opti.set_initial(knot.square, starts[k])
        knots.append(knot)
    opti.minimize(cost)
    hessian = {} if exact_hessian else {"ipopt.hessian_approximation": "limited-memory"}
    opti.solver("ipopt", {**OUTPUT, **hessian, **SETTINGS, **(options or {})})
    found = opti.solve()
    statistics = opti.stats()
    L = np.zeros((len(knots), 6, 6))  # lower triangles of the scaled task stiffness
    for k, knot in enumerate(knots):
        L[k][LOWER] = found.value(knot.entries)
    return Solution(
        q=np.array([found.value(knot.q) for knot in knots]),
        task_stiffness=np.outer(SCALE, SCALE) * (L @ L.swapaxes(-1, -2) + FLOOR * np.eye(6)),
        cost=float(found.value(cost)),
        iterations=int(statistics["iter_count"]),
        seconds=float(statistics["t_proc_total"]),
        evaluating=float(sum(value for name, value in statistics.items() if name.startswith("t_proc_nlp_"))),
    )


def _starting_roots(robot: Any, task: Task) -> Array:
    """Return the entries of C from which the search starts (N, 28), at the recorded postures with a stiff spring."""
    knots = len(task.recorded)
    stiff = np.broadcast_to(3 * PAPER_STIFFNESS, (knots, 6, 6))
    C = np.linalg.cholesky(joint_stiffness(robot, task, task.recorded, stiff) + 30.0 * np.eye(7))
    rows, columns = np.tril_indices(7)
    return np.asarray((C / SIZE[:, None])[:, rows, columns])
