"""The controller's law again, in NumPy and SciPy, from its equations: an oracle for one step."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import scipy.linalg


def energy(pose: np.ndarray, equilibrium: np.ndarray, Kt: np.ndarray, Ko: np.ndarray) -> float:
    """U = (p - p0)^T Kt (p - p0) / 2 + (1 - cos a) u^T Ko u, u and a the axis and angle of R0^T R [J]."""
    e = pose[:3, 3] - equilibrium[:3, 3]
    R = equilibrium[:3, :3].T @ pose[:3, :3]
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    cosine = (np.trace(R) - 1) / 2
    # (1 - cos a) u^T Ko u = w^T Ko w / (1 + cos a), without dividing by a small sine
    return float(e @ Kt @ e / 2 + w @ Ko @ w / (1 + cosine))


def wrench(pose: np.ndarray, equilibrium: np.ndarray, Kt: np.ndarray, Ko: np.ndarray) -> np.ndarray:
    """dU in hybrid axes, by complex steps of the energy along the six unit twists."""
    h, result = 1e-6, np.empty(6)
    for k in range(6):
        values = []
        for step in (h, -h, 2 * h, -2 * h):
            moved = pose.copy()
            if k < 3:
                moved[k, 3] += step
            else:
                axis = np.zeros((3, 3))
                i, j = [(1, 2), (2, 0), (0, 1)][k - 3]
                axis[j, i], axis[i, j] = 1, -1
                moved[:3, :3] = scipy.linalg.expm(step * axis) @ pose[:3, :3]
            values.append(energy(moved, equilibrium, Kt, Ko))
        result[k] = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h)
    return result


def elastic_torque(robot: ModuleType, q: Any, equilibrium: Any, posture: Any, Kt: Any, Ko: Any, k: Any) -> np.ndarray:
    """- dU/dq of springs and posture potential."""
    F = wrench(robot.forward_kinematics(q), equilibrium, Kt, Ko)
    return np.asarray(-robot.hybrid.jacobian(q).T @ F - k * (q - posture))


def joint_hessian(robot: ModuleType, q: Any, equilibrium: Any, Kt: Any, Ko: Any) -> np.ndarray:
    """d2U/dq2 of the springs, by differences of the torque."""
    h, zero = 1e-4, np.zeros(robot.DOF)
    columns = [
        (elastic_torque(robot, q - step, equilibrium, zero, Kt, Ko, 0.0)
         - elastic_torque(robot, q + step, equilibrium, zero, Kt, Ko, 0.0)) / (2 * h)
        for step in h * np.eye(robot.DOF)
    ]  # fmt: skip
    return np.array(columns).T


def modal_damping(K: np.ndarray, M: np.ndarray, ratio: Any, late: float, most: float, d: float) -> np.ndarray:
    """Damping that gives every mode its ratio where stiffness and damping act late by ``late`` [s], capped."""
    values, V = scipy.linalg.eigh(K, M)
    b = np.empty(len(values))
    for k, (value, zeta) in enumerate(zip(np.abs(values), np.broadcast_to(ratio, len(values)), strict=True)):
        # zeta = (b - l h) / (2 sqrt(l (1 - b h))), solved by bisection
        low, high = value * late, min(1 / late, 1e9) if late else 2 * zeta * np.sqrt(value) + 1e-12
        for _ in range(200):
            middle = (low + high) / 2
            realised = (middle - value * late) - 2 * zeta * np.sqrt(value * max(1 - middle * late, 0))
            low, high = (middle, high) if realised < 0 else (low, middle)
        b[k] = min(low, most - d * np.trace(np.linalg.inv(M)))
    return np.asarray(M @ V @ np.diag(b) @ V.T @ M + d * np.eye(len(M)))
