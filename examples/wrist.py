# SPDX-License-Identifier: MIT
"""Hold a hand's orientation by laws of operational space, on a ball wrist in MuJoCo: lightly damped, they flutter.

The moment of a law is a matrix times the rotation vector e from the hand to its target, in base axes. Of two forms

    fixed gains (SERL, CRISP)                          K e - D w
    gains times inertia (robosuite, Isaac Lab, Newton) L (Kp e - Kd w), L = (J M^-1 J^T)^-1

the first is no gradient if the gains are unequal. At a rest with e about the axis of K1 the antisymmetric part of the
stiffness is (K2 + K3 - 2 K1) |e| / 4 between the other two axes, for small e. It feeds a motion round the rest, as that
of three drives does (examples/flutter.py). A hose that pulls at the hand is enough for such a rest. The second is none
either, even with equal gains: L turns with the hand. With unequal gains it has an antisymmetric part at e = 0, too,
which shows where the hand holds a rod that the law's inertia lacks.

With a damping ratio of 1 all come to rest. The rows have the ratio below which they
flutter, from eigenvalues of MuJoCo's own accelerations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from stiffgen import drive

Array = NDArray[np.float64]

MODEL = Path(__file__).with_name("wrist.xml")
PUSH = 0.027  # rad, out of the rest
XYZW = [1, 2, 3, 0]  # the order of stiffgen.drive, from MuJoCo's (w, x, y, z)


@dataclass(frozen=True)
class Case:
    """Law, and what acts on the hand.

    Attributes:
        name: words of the table.
        gains: about the base's axes: 1/s^2 with ``weighted``, else N m/rad.
        weighted: whether the law multiplies gains by the inertia.
        tilt: rotation of the target about the base's y axis [rad].
        hose: whether the hose pulls.
        rod: whether the hand holds a rod, of which the law does not know.
        ratio: damping ratio that is simulated.

    """

    name: str
    gains: tuple[float, float, float]
    weighted: bool
    tilt: float
    hose: bool
    rod: bool
    ratio: float


CASES = (
    Case("fixed gains, hose", (0.2, 2.0, 2.0), False, 0.0, True, False, 0.05),
    Case("gains times inertia, hose", (20.0, 150.0, 150.0), True, 0.0, True, False, 0.05),
    Case("equal gains times inertia, hose", (150.0, 150.0, 150.0), True, 0.0, True, False, 0.02),
    Case("gains times inertia, unknown rod", (20.0, 150.0, 150.0), True, np.pi / 3, False, True, 0.2),
)
LAW, GRADIENT = "law", "gradient"


def _built(case: Case) -> mujoco.MjModel:
    """Return the model of a case: the hand, with or without rod and hose."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    if not case.rod:
        spec.delete(spec.body("rod"))
    if not case.hose:
        spec.tendon("hose").stiffness[:] = 0.0
    return spec.compile()


class Wrist:
    """A case in MuJoCo under its law, or under the gradient with the law's stiffness and damping at the target."""

    def __init__(self, case: Case, law: str, ratio: float) -> None:
        """Build the wrist of a case, and the torque of the law or of the gradient with the same stiffness at rest."""
        self.model = _built(case)
        self.data = mujoco.MjData(self.model)
        self.target = np.array([np.cos(case.tilt / 2), 0.0, np.sin(case.tilt / 2), 0.0])
        self.data.qpos[:] = self.target
        principal, gains = self.model.body("hand").inertia, np.array(case.gains)
        # Weighted laws multiply by the inertia afterwards, so that their gains are [1/s^2] and [1/s].
        weight = np.diag(principal) if case.weighted else np.eye(3)
        stiffness = np.diag(gains)
        damping = 2 * ratio * np.diag(np.sqrt(gains if case.weighted else gains * principal))
        R0 = matrix(self.target)
        at_rest = [weight @ R0.T @ each @ R0 for each in (stiffness, damping)]
        K0, D0 = ((each + each.T) / 2 for each in at_rest)  # symmetric parts, in the body's axes at the target

        def of_law(R: Array, rate: Array) -> Array:
            e = rotation_vector(self.target, self.data.qpos)
            return np.asarray(weight @ R.T @ (stiffness @ (R @ e) - damping @ (R @ rate)))

        def of_gradient(R: Array, rate: Array) -> Array:
            torque = drive.torque(self.data.qpos[XYZW], self.target[XYZW], K0, "log")
            return np.asarray(torque - D0 @ rate)

        self.torque: Callable[[Array, Array], Array] = of_law if law == LAW else of_gradient

    def apply(self) -> None:
        """Apply the torque of the state, in the hand's axes."""
        self.data.qfrc_applied[:] = self.torque(matrix(self.data.qpos), self.data.qvel)

    def acceleration(self) -> Array:
        """Return the hand's angular acceleration (3) [rad/s^2]."""
        self.apply()
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qacc)

    def settle(self, steps: int = 4000) -> Array:
        """Move the hand along its acceleration until it is at rest; return its quaternion (4)."""
        self.data.qvel[:] = 0.0
        for _ in range(steps):
            mujoco.mj_integratePos(self.model, self.data.qpos, self.acceleration() / 300, 1.0)
        if np.linalg.norm(self.acceleration()) > 1e-6:
            raise ArithmeticError("the hand finds no rest")
        return np.array(self.data.qpos)

    def growth(self, rest: Array, step: float = 1e-5) -> float:
        """Return the largest real part [1/s] of the eigenvalues at a rest: positive if a push grows."""
        columns = []
        for k in range(6):
            both = []
            for sign in (1, -1):
                self.data.qpos[:], self.data.qvel[:] = rest, 0.0
                if k < 3:
                    mujoco.mj_integratePos(self.model, self.data.qpos, sign * step * np.eye(3)[k], 1.0)
                else:
                    self.data.qvel[k - 3] = sign * step
                both.append(self.acceleration())
            columns.append((both[0] - both[1]) / (2 * step))
        system = np.block([[np.zeros((3, 3)), np.eye(3)], [np.column_stack(columns)]])
        return float(np.linalg.eigvals(system).real.max())


def matrix(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)


def rotation_vector(target: Array, quaternion: Array) -> Array:
    """Return the rotation vector (3) [rad] from an orientation to the target, in the axes of the orientation."""
    e = np.zeros(3)
    mujoco.mju_subQuat(e, target, quaternion)
    return e


def limit(case: Case) -> float:
    """Return the damping ratio below which a case flutters, to 1e-3; 0 if it never does."""
    rest = Wrist(case, LAW, 1.0).settle()
    lower, upper = 0.0, 2.0
    while upper - lower > 1e-3:
        middle = (lower + upper) / 2
        lower, upper = (middle, upper) if Wrist(case, LAW, middle).growth(rest) > 0 else (lower, middle)
    return lower


def watch(case: Case, law: str, ratio: float, seconds: float = 12.0, window: float = 2.0) -> tuple[float, float]:
    """Push the hand out of its rest by PUSH about (1, 1, 1); return rest and swing.

    Returns:
        Angle between rest and target [rad], and the largest angle to the rest in the last ``window`` [s].

    """
    rest = Wrist(case, law, 1.0).settle()
    wrist = Wrist(case, law, ratio)
    wrist.data.qpos[:] = rest
    mujoco.mj_integratePos(wrist.model, wrist.data.qpos, np.full(3, PUSH / np.sqrt(3)), 1.0)
    count, swing = round(seconds / wrist.model.opt.timestep), 0.0
    for step in range(count):
        wrist.apply()
        mujoco.mj_step(wrist.model, wrist.data)
        if step > count - window / wrist.model.opt.timestep and step % 20 == 0:
            swing = max(swing, float(np.linalg.norm(rotation_vector(rest, wrist.data.qpos))))
    return float(np.linalg.norm(rotation_vector(wrist.target, rest))), swing


def rows() -> list[tuple[str, ...]]:
    """Return the table: law, gains, rest, limit of the ratio, ratio, swing of law and gradient."""
    made = []
    for case in CASES:
        away, swing = watch(case, LAW, case.ratio)
        others = watch(case, GRADIENT, case.ratio)[1]
        words = ", ".join(f"{gain:g}" for gain in case.gains) + (" 1/s^2" if case.weighted else " N m/rad")
        swings = ("below 1e-3 rad" if each < 1e-3 else f"{each:.2g} rad" for each in (swing, others))
        made.append((case.name, words, f"{away:.2f} rad", f"{limit(case):.2f}", f"{case.ratio:g}", *swings))
    return made


def main() -> None:
    """Print the table."""
    for row in rows():
        print(" | ".join(row))


if __name__ == "__main__":
    main()
