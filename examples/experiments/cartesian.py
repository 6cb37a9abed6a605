# SPDX-License-Identifier: MIT
"""The Cartesian impedance law in common use: tau = J^T (K e - B J dq) + N (k (q0 - q) - d dq).

e is the position error and the rotation vector of the error rotation, in base axes; N = I - J^T (J^T)^+ projects the
posture's torque into the nullspace. The law measures no wrench. Its rotational part is no gradient of an energy:
docs/theory.md.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
DIFFERENCE = 1e-5
"""[rad] of the central differences."""


class CartesianLaw:
    """Cartesian impedance law with a projected nullspace.

    Args:
        robot: generated module of the arm with its tool.
        task_stiffness: K (6, 6) [N/m, N m/rad], hybrid frame.
        task_damping: B (6, 6) [N s/m, N m s/rad], hybrid frame.
        posture_stiffness: k [N m/rad].
        joint_damping: d [N m s/rad].

    """

    def __init__(
        self,
        robot: ModuleType,
        task_stiffness: Array,
        task_damping: Array,
        posture_stiffness: float,
        joint_damping: float,
    ) -> None:
        self._robot = robot
        self._K, self._B = task_stiffness, task_damping
        self._posture, self._damping = posture_stiffness, joint_damping

    def spring_torque(self, q: Array, q0: Array) -> Array:
        """Return the torque at rest [N m] at configurations q (N, n) with the equilibrium q0 (n,) [rad]."""
        robot = self._robot
        here, there = robot.forward_kinematics(q), robot.forward_kinematics(q0)
        turn = Rotation.from_matrix(there[:3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)).as_rotvec()
        error = np.concatenate([there[:3, 3] - here[:, :3, 3], turn], axis=1)
        J = np.asarray(robot.hybrid.jacobian(q))
        task = np.einsum("nij,ni->nj", J, error @ self._K.T)
        return np.asarray(task + np.einsum("nij,nj->ni", projector(J), self._posture * (q0 - q)))

    def torques(self, q: Array, dq: Array, q0: Array) -> tuple[Array, Array]:
        """Return the torques of spring and damper [N m] at one state."""
        J = np.asarray(self._robot.hybrid.jacobian(q[None]))
        damping = -J[0].T @ self._B @ (J[0] @ dq) - projector(J)[0] @ (self._damping * dq)
        return self.spring_torque(q[None], q0)[0], damping

    def stiffness(self, q: Array, q0: Array) -> Array:
        """Return -d torque/dq (n, n) at rest [N m/rad], by central differences."""
        steps = DIFFERENCE * np.eye(len(q))
        behind, ahead = np.split(self.spring_torque(np.concatenate([q - steps, q + steps]), q0), 2)
        return np.asarray((behind - ahead).T / (2 * DIFFERENCE))


def projector(J: Array) -> Array:
    """Return I - J^T (J^T)^+ (N, n, n) of Jacobians (N, 6, n)."""
    transposed = np.swapaxes(J, 1, 2)
    return np.asarray(np.eye(J.shape[2]) - transposed @ np.linalg.pinv(transposed))
