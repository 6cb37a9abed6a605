# SPDX-License-Identifier: MIT
"""Analyse the stability of a stance on the generated kernels alone: configuration of rest, and modes.

The energies are functions of the configuration (base_pose, q):

    contacts   a spring between every foot and the ground; a point contact has no rotational stiffness
    legs       a spring between every foot and the base, which the motors apply
    gravity    of all masses
    load       a constant force on the base link's origin, as of a long rope

Their gradients add up, and so do their Hessians along the coordinates of docs/whole_body.md; the sum of the Hessians
is Kq. At rest the gradient is zero. The modes solve Kq v = lambda M v with the angular frequency sqrt(lambda). If
lambda < 0, the robot falls in the direction v.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stiffgen import StiffgenError

Array = NDArray[np.float64]

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
BASE_DIRECTIONS = ("x", "y", "z", "roll", "pitch", "yaw")
GRAVITY: Array = np.array([0.0, 0.0, -9.81])
"""Acceleration of free fall [m/s^2]."""
POSTURE: Array = np.array([0.0, 0.8, -1.6] * 2 + [0.0, -0.8, 1.6] * 2)
"""Joint positions round which the robot stands [rad]: front knees forward, hind knees back."""
MOTIONLESS = np.eye(4)


@dataclass(frozen=True)
class Springs:
    """A spring at every foot.

    Args:
        equilibria: (feet, 4, 4) poses at which they are at rest, in the world or, of the legs, in the base.
        translation: (feet, 3, 3) stiffnesses [N/m], same axes.
        rotation: (feet, 3, 3) stiffnesses [N m/rad], axes of the equilibrium.

    """

    equilibria: Array
    translation: Array
    rotation: Array

    @property
    def parameters(self) -> tuple[Array, Array, Array]:
        """Return the springs as arguments of the kernels of all tips: (feet, 4, 4), (feet, 3, 3), (feet, 3, 3)."""
        return self.equilibria, self.translation, self.rotation


@dataclass(frozen=True)
class Mode:
    """A direction v (18) with Kq v = eigenvalue M v, v^T M v = 1; real part, where the eigenvalue is not real."""

    eigenvalue: complex
    direction: Array

    @property
    def frequency(self) -> float:
        """[Hz]; of an unstable direction minus its growth rate over 2 pi."""
        real = self.eigenvalue.real
        return float(np.copysign(np.sqrt(abs(real)), real) / (2 * np.pi))


@dataclass(frozen=True)
class Stance:
    """A robot that stands, its springs and its load; ``base_pose`` (4, 4) and ``q`` say where it is.

    Args:
        robot: the generated module.
        contacts: springs between feet and ground.
        legs: springs between feet and base.
        base_pose: pose of the base link in the world [m].
        q: joint positions [rad].
        load: constant force on the base link's origin, world axes [N].

    """

    robot: ModuleType
    contacts: Springs
    legs: Springs
    base_pose: Array
    q: Array
    load: Array

    def contact_gradient(self) -> Array:
        """Return dU of the contacts (18): the first six entries are the wrench that holds the base against them."""
        where = self.base_pose, self.q
        return np.asarray(-self.robot.spring.torque_total(*where, *self.contacts.parameters))

    def leg_torque(self) -> Array:
        """Return the joint torques (12) of the legs' springs, which the motors apply.

        A spring between foot and base pulls the foot and pushes the base: its six entries of the base are zero, and the
        joints' entries do not depend on the base's pose.
        """
        return np.asarray(self.robot.spring.torque_total(MOTIONLESS, self.q, *self.legs.parameters)[6:])

    def gravity_gradient(self) -> Array:
        """Return dU of gravity (18)."""
        return np.asarray(self.robot.gravity.gradient(self.base_pose, self.q, GRAVITY))

    def load_gradient(self) -> Array:
        """Return dU of the load (18), U = -load . p."""
        return np.concatenate([-self.base_pose[:3, :3].T @ self.load, np.zeros(15)])

    def gradient(self) -> Array:
        """Return the gradient of the total energy (18): zero at rest."""
        legs = np.concatenate([np.zeros(6), -self.leg_torque()])
        return np.asarray(self.contact_gradient() + legs + self.gravity_gradient() + self.load_gradient())

    def stiffness(self) -> Array:
        """Return Kq (18, 18) of all energies. The load contributes nothing: p + R v is linear in v."""
        legs = np.zeros((18, 18))
        legs[6:, 6:] = self.robot.spring.joint_stiffness_total(MOTIONLESS, self.q, *self.legs.parameters)[6:, 6:]
        contacts = self.robot.spring.joint_stiffness_total(self.base_pose, self.q, *self.contacts.parameters)
        return np.asarray(contacts + legs + self.robot.gravity.joint_stiffness(self.base_pose, self.q, GRAVITY))

    def base_term(self, gradient: Array) -> Array:
        """Return the base's connection term (18, 18), which an arm's formula lacks: Gamma of the wrench on the base."""
        term = np.zeros((18, 18))
        term[:6, :6] = self.robot.FL_FOOT.body.connection_correction(gradient[:6])
        return term

    def stiffness_without_base_term(self) -> Array:
        """Return Kq of all energies without the base's connection term."""
        return np.asarray(self.stiffness() + self.base_term(self.contact_gradient() + self.gravity_gradient()))

    def contacts_without_base_term(self) -> Array:
        """Return Kq without the base's connection term of the contacts, but with that of gravity."""
        return np.asarray(self.stiffness() + self.base_term(self.contact_gradient()))

    def without_gravity(self) -> Array:
        """Return Kq of the springs alone."""
        return np.asarray(self.stiffness() - self.robot.gravity.joint_stiffness(self.base_pose, self.q, GRAVITY))

    def mass_matrix(self) -> Array:
        """Return M (18, 18)."""
        return np.asarray(self.robot.mass_matrix(self.q))

    def moved(self, x: Array) -> Stance:
        """Return the stance after the motion x (18): the base along its exponential, the joints by addition."""
        pose = self.base_pose.copy()
        pose[:3, 3] += pose[:3, :3] @ x[:3]
        # A product of rounded rotations drifts from a rotation: project it back.
        pose[:3, :3] = Rotation.from_matrix(pose[:3, :3] @ Rotation.from_rotvec(x[3:6]).as_matrix()).as_matrix()
        return replace(self, base_pose=pose, q=self.q + x[6:])

    def at_rest(self, tolerance: float = 1e-11) -> Stance:
        """Find a rest, where the gradient is zero, by Newton's method; unstable ones are found as well.

        Raises:
            StiffgenError: it does not come to rest near where it stands.

        """
        stance = self
        for _ in range(50):
            gradient = stance.gradient()
            if np.abs(gradient).max() < tolerance * max(1.0, np.abs(stance.contact_gradient()).max()):
                return stance
            step = -np.linalg.solve(stance.stiffness(), gradient)
            stance = stance.moved(step * min(1.0, 0.1 / np.abs(step).max()))
        raise StiffgenError("the stance has no rest near its posture: take stiffer springs, or a smaller load")

    def modes(self, stiffness: Array | None = None) -> list[Mode]:
        """Return the modes of Kq, or of another ``stiffness`` (18, 18) that may be asymmetric; softest first."""
        K, M = self.stiffness() if stiffness is None else stiffness, self.mass_matrix()
        if np.array_equal(K, K.T):
            eigenvalues, vectors = scipy.linalg.eigh(K, M)
        else:
            eigenvalues, vectors = scipy.linalg.eig(K, M)
            order = np.argsort(eigenvalues.real, kind="stable")
            eigenvalues, vectors = eigenvalues[order], vectors[:, order]
        modes = []
        for eigenvalue, vector in zip(eigenvalues, vectors.T, strict=True):
            direction = _largest_positive(np.real(vector * np.exp(-1j * np.angle(vector[np.abs(vector).argmax()]))))
            modes.append(Mode(complex(eigenvalue), direction / np.sqrt(direction @ M @ direction)))
        return modes


def _largest_positive(direction: Array) -> Array:
    """Return v or -v, whichever has a positive largest entry on the base, so that pictures repeat."""
    return np.asarray(direction * np.sign(direction[np.abs(direction[:6]).argmax()] or 1.0))


def base_shares(stance: Stance, mode: Mode) -> Array:
    """Return the shares (6) of the base's directions in a mode's motion: m v^2 and I w^2, sum 1."""
    inertia = np.diag(stance.mass_matrix())[:6]
    energy = inertia * mode.direction[:6] ** 2
    return np.asarray(energy / energy.sum())


def feet(robot: ModuleType, base_pose: Array, q: Array) -> Array:
    """Return the poses (feet, 4, 4) of the feet."""
    return np.stack([getattr(robot, foot).forward_kinematics(base_pose, q) for foot in FEET])


def level(poses: Array) -> Array:
    """Return poses (feet, 4, 4) with the axes of the world."""
    return np.stack([np.block([[np.eye(3), pose[:3, 3:]], [np.zeros((1, 3)), 1.0]]) for pose in poses])


GROUND: Array = np.diag([2500.0, 2500.0, 6000.0])
"""Stiffness of the ground under a foot [N/m]: a firm mat."""
LEG: Array = np.diag([120.0, 150.0, 260.0])
"""Stiffness of the spring that the motors play between a foot and the base [N/m]."""
SQUEEZE = 0.02
"""Distance [m] by which the legs' springs pull the feet together; it loads the ground sideways."""


def standing(robot: ModuleType, load: Array | None = None) -> Stance:
    """Return Solo 12 at rest on four point contacts."""
    base = np.eye(4)
    base[2, 3] = -feet(robot, np.eye(4), POSTURE)[:, 2, 3].mean()
    places = level(feet(robot, base, POSTURE))
    hold = level(feet(robot, np.eye(4), POSTURE))
    weight = -float(robot.gravity.gradient(np.eye(4), POSTURE, GRAVITY)[2]) or 0.0
    hold[:, 2, 3] += weight / len(FEET) / LEG[2, 2]  # the legs' springs reach below the feet: they carry the weight
    hold[:, 1, 3] -= SQUEEZE * np.sign(hold[:, 1, 3])
    none = np.zeros((len(FEET), 3, 3))
    contacts = Springs(places, np.stack([GROUND] * len(FEET)), none)
    legs = Springs(hold, np.stack([LEG] * len(FEET)), none)
    start = Stance(robot, contacts, legs, base, POSTURE, np.zeros(3))
    return replace(start.at_rest(), load=np.zeros(3) if load is None else load).at_rest()
