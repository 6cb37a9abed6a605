"""The impedance controller again, in NumPy and SciPy, without energy and tank: an oracle."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import scipy.linalg


def modal_damping(K: np.ndarray, M: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    values, V = scipy.linalg.eigh(K, M)
    return np.asarray(M @ V @ np.diag(2 * ratio * np.sqrt(np.maximum(values, 0))) @ V.T @ M)


def factorised_damping(K: np.ndarray, M: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    def root(A: np.ndarray) -> np.ndarray:
        values, V = np.linalg.eigh(A)
        return np.asarray(V @ np.diag(np.sqrt(np.maximum(values, 0))) @ V.T)

    B = root(M) @ np.diag(ratio) @ root(K) + root(K) @ np.diag(ratio) @ root(M)
    values, V = np.linalg.eigh(B)
    return np.asarray(V @ np.diag(np.maximum(values, 0)) @ V.T)


def projected_stiffness(J: np.ndarray, M: np.ndarray, k: float) -> np.ndarray:
    """Away from singularities."""
    inverse = np.linalg.inv(M)
    N = np.eye(len(M)) - J.T @ np.linalg.inv(J @ inverse @ J.T) @ J @ inverse
    return np.asarray(k * N @ N.T)


class Reference:
    """Steps with the words of a configuration (dict) over the numbers of a controller's ``config`` record."""

    def __init__(self, robot: ModuleType, numbers: Any, **words: str) -> None:
        self.robot, self.c = robot, numbers
        self.words = {
            "representation": "hybrid",
            "stiffness_formula": "corrected",
            "stiffness_sign": "as_is",
            "nullspace": "isotropic",
            "damping_design": "modal",
            "wrench_filter": "first_order",
            **words,
        }
        n = robot.DOF
        self.torque, self.velocity, self.K, self.B = np.zeros(n), np.zeros(n), np.zeros((n, n)), np.eye(n)
        self.B = self.c.joint_damping * np.eye(n)
        self.engaged, self.time, self.missed = False, 0.0, 0
        self.samples: list[np.ndarray] = []

    def believed(self, value: np.ndarray, low: Any, high: Any) -> bool:
        return bool(np.all(np.isfinite(value)) and np.all(value >= low) and np.all(value <= high))

    def step(self, s: Any) -> np.ndarray:
        c, dt = self.c, self.c.sample_time
        if not s.sample_valid:
            self.missed += 1
            if self.missed < c.missed_limit and self.engaged:
                return self.torque
            return self.fall_back(None, None)
        tolerance = c.position_tolerance
        position = c.lower_limit - tolerance, c.upper_limit + tolerance
        q_good = self.believed(s.q, *position)
        dq_good = self.believed(s.dq, -c.velocity_limit, c.velocity_limit)
        with np.errstate(over="ignore"):
            force, moment = np.linalg.norm(s.wrench[:3]), np.linalg.norm(s.wrench[3:])
        K = s.task_stiffness
        good = (
            q_good
            and dq_good
            and self.believed(s.q0, *position)
            and self.believed(s.dq0, -c.velocity_limit, c.velocity_limit)
            and force <= c.force_limit
            and moment <= c.moment_limit
            and self.believed(K, -c.task_stiffness_limit, c.task_stiffness_limit)
            and np.abs(K - K.T).max() <= 1e-9 * np.abs(K).max()
            and np.linalg.eigvalsh(K).min() >= -1e-9 * np.abs(K).max()
        )
        if not good:
            self.missed = 0
            return self.fall_back(s.q if q_good else None, s.dq)
        elapsed, self.missed = dt * (1 + self.missed), 0
        fresh = not self.engaged
        self.engaged = True
        if fresh:
            self.anchor, self.time, self.samples = s.q.copy(), 0.0, []
        else:
            self.time += elapsed
        wrench = self.filtered(s.wrench)
        M, J = self.robot.mass_matrix(s.q), getattr(self.robot, self.words["representation"]).jacobian(s.q)
        target = self.target(s, wrench, M, J)
        change = target - self.K
        norm = np.linalg.norm(change)
        share = 1.0 if fresh or norm == 0 else min(1.0, c.stiffness_rate_limit * elapsed / norm)
        self.K = self.K + share * change if share < 1 else target
        self.B = self.damping(self.K, M, J)
        blend = min(1.0, self.time / c.return_time) if c.return_time > 0 else 1.0
        weight = 3 * blend**2 - 2 * blend**3
        rate = 6 * blend * (1 - blend) / c.return_time if blend < 1 else 0.0
        reference = (1 - weight) * self.anchor + weight * s.q0
        speed = weight * s.dq0 + rate * (s.q0 - self.anchor)
        self.velocity = s.dq
        return self.limited(self.K @ (reference - s.q) + self.B @ (speed - s.dq) + self.avoidance(s.q))

    def filtered(self, wrench: np.ndarray) -> np.ndarray:
        self.samples.append(wrench)
        kind = self.words["wrench_filter"]
        if kind == "off":
            return wrench
        if kind == "moving_average":
            return np.asarray(np.mean(self.samples[-int(self.c.wrench_window) :], axis=0))
        # Solution of tau dy/dt = u - y over all samples since the start, each held for one sample time.
        a = np.exp(-self.c.sample_time / self.c.wrench_time_constant)
        self.low = wrench if len(self.samples) == 1 else a * self.low + (1 - a) * wrench
        return self.low

    def target(self, s: Any, wrench: np.ndarray, M: np.ndarray, J: np.ndarray) -> np.ndarray:
        kernels = getattr(self.robot, self.words["representation"])
        corrected = self.words["stiffness_formula"] == "corrected"
        kernel = kernels.joint_stiffness if corrected else kernels.joint_stiffness_uncorrected
        K = kernel(s.q, wrench, s.task_stiffness)
        k = self.c.nullspace_stiffness
        if self.words["nullspace"] == "isotropic":
            K = K + k * np.eye(len(K))
        elif self.words["nullspace"] == "projected":
            K = K + projected_stiffness(J, M, k)
        if self.words["stiffness_sign"] == "positive_part":
            values, V = scipy.linalg.eigh(K, M)
            K = M @ V @ np.diag(np.maximum(values, 0)) @ V.T @ M
        return np.asarray(K)

    def damping(self, K: np.ndarray, M: np.ndarray, J: np.ndarray) -> np.ndarray:
        K = (K + K.T) / 2
        kind = self.words["damping_design"]
        if kind == "modal":
            B = modal_damping(K, M, self.c.damping_ratio)
        elif kind == "factorised":
            B = factorised_damping(K, M, self.c.damping_ratio)
        else:
            B = J.T @ self.c.task_damping @ J
        return np.asarray(B + self.c.joint_damping * np.eye(len(K)))

    def avoidance(self, q: np.ndarray) -> np.ndarray:
        """Minus the gradient of k/2 depth^2."""
        low, high = self.c.lower_limit + self.c.limit_zone, self.c.upper_limit - self.c.limit_zone
        return np.asarray(self.c.limit_stiffness * (np.maximum(low - q, 0) - np.maximum(q - high, 0)))

    def limited(self, torque: np.ndarray) -> np.ndarray:
        step = self.c.torque_rate_limit * self.c.sample_time
        cut = np.minimum(np.maximum(torque, -self.c.effort_limit), self.c.effort_limit)
        self.torque = self.torque + np.minimum(np.maximum(cut - self.torque, -step), step)
        return self.torque

    def fall_back(self, q: np.ndarray | None, dq: np.ndarray | None) -> np.ndarray:
        self.engaged = False
        fade = np.exp(-self.c.sample_time / self.c.velocity_decay_time)
        limit = self.c.velocity_limit
        if dq is not None and self.believed(dq, -10 * limit, 10 * limit):
            self.velocity = np.clip(dq, -limit, limit)
        else:
            self.velocity = self.velocity * fade
        avoidance = 0.0 if q is None else self.avoidance(q)
        return self.limited(-self.B @ self.velocity + avoidance)
