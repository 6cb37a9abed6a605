# SPDX-License-Identifier: MIT
"""Find the configuration of rest of an arm on springs under a load, without the controller and its spring kernels.

The energy of the spring at the tip is written out here (trace form; p, R the tip, p0, R0 the equilibrium):

    U = (p - p0)^T Kt (p - p0) / 2 + tr(G (I - R0^T R)) + k |q - posture|^2 / 2,    G = tr(Ko)/2 I - Ko

Its gradient is checked by differences of U (tests/control/test_plant.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def random_stiffness(random: np.random.Generator, least: float, most: float) -> Array:
    """Draw a random symmetric 3 x 3 matrix with eigenvalues between two bounds, evenly in their logarithms."""
    Q = np.linalg.qr(random.normal(size=(3, 3)))[0]
    A = Q @ np.diag(np.exp(random.uniform(np.log(least), np.log(most), 3))) @ Q.T
    return np.asarray((A + A.T) / 2)


@dataclass(frozen=True)
class Springs:
    """Springs at the tip and over the joints.

    Args:
        pose: (4, 4) of the tip at q, metres, base axes.
        jacobian: (6, n) at q, hybrid.
        equilibrium: (4, 4).
        posture: (n) [rad].
        translation: (3, 3) [N/m], base axes.
        rotation: (3, 3) [N m/rad], axes of the tip at the equilibrium.
        joint: [N m/rad] of the springs over the joints.
        zone: lower edges, upper edges (n) [rad] and stiffness (n) [N m/rad] of a limit avoidance, where there is one.

    """

    pose: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]
    equilibrium: Array
    posture: Array
    translation: Array
    rotation: Array
    joint: float
    zone: tuple[Array, Array, Array] | None = None

    @property
    def _G(self) -> Array:
        return np.asarray(np.trace(self.rotation) / 2 * np.eye(3) - self.rotation)

    def energy(self, q: Array) -> float:
        """U [J]."""
        H, e = self.pose(q), q - self.posture
        away = H[:3, 3] - self.equilibrium[:3, 3]
        turn = self.equilibrium[:3, :3].T @ H[:3, :3]
        rotational = np.trace(self._G @ (np.eye(3) - turn))
        return float(away @ self.translation @ away / 2 + rotational + self.joint / 2 * e @ e)

    def gradient(self, q: Array) -> Array:
        """Return dU/dq (n) [N m] at positions q (n)."""
        H = self.pose(q)
        A = H[:3, :3] @ self._G @ self.equilibrium[:3, :3].T
        moment = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
        force = self.translation @ (H[:3, 3] - self.equilibrium[:3, 3])
        slope = self.jacobian(q).T @ np.concatenate([force, moment]) + self.joint * (q - self.posture)
        if self.zone is not None:
            lower, upper, stiffness = self.zone
            slope = slope + stiffness * (np.maximum(q - upper, 0) + np.minimum(q - lower, 0))
        return np.asarray(slope)

    def near(self, q: Array, load: Array) -> Array | None:
        """Return the stable configuration at rest under a load (6) that Newton finds within 0.1 rad of q, or None."""
        found = q.copy()
        for _ in range(30):
            error = self._left(found, load, np.zeros(len(q)))
            if np.abs(error).max() < 1e-9:
                slope = self._slope(found, load, np.zeros(len(q)))
                return found if np.linalg.eigvalsh((slope + slope.T) / 2)[0] > 0 else None
            move = np.linalg.solve(self._slope(found, load, np.zeros(len(q))), error)
            found = found + move * min(1.0, 0.03 / np.abs(move).max())
            if np.abs(found - q).max() > 0.1:
                break
        return None

    def rest(self, load: Array, bias: Array, steps: int = 10) -> tuple[Array, Array] | None:
        """Find the configuration of rest under a load at the tip and a torque over the joints, both grown from zero.

        Args:
            load: (6) [N, N m] what the environment applies to the robot, base axes.
            bias: (n) [N m].
            steps: number of increments; Newton's method solves each.

        Returns:
            The configuration and the eigenvalues of the symmetric part of -d torque/dq there [N m/rad]; None if the
            branch ends or loses stability on the way.

        """
        q = self.posture.copy()
        for share in np.linspace(0, 1, steps + 1)[1:]:
            for _ in range(30):
                error = self._left(q, share * load, share * bias)
                if np.abs(error).max() < 1e-10:
                    break
                move = np.linalg.solve(self._slope(q, share * load, share * bias), error)
                q = q + move * min(1.0, 0.3 / np.abs(move).max())
            else:
                return None
            slope = self._slope(q, share * load, share * bias)
            values = np.linalg.eigvalsh((slope + slope.T) / 2)
            if values[0] <= 0:
                return None
        return q, np.asarray(values, dtype=float)

    def _left(self, q: Array, load: Array, bias: Array) -> Array:
        return np.asarray(self.jacobian(q).T @ load + bias - self.gradient(q))

    def _slope(self, q: Array, load: Array, bias: Array) -> Array:
        steps = 1e-6 * np.eye(len(q))
        columns = [self._left(q - d, load, bias) - self._left(q + d, load, bias) for d in steps]
        return np.array(columns).T / 2e-6
