# SPDX-License-Identifier: MIT
"""Arm simulated by MuJoCo. The arm compensates gravity and Coriolis forces itself, as an LBR or a Panda does."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class SimulatedArm:
    """Arm at rest at ``start``; each :meth:`step` holds a torque for ``timestep``.

    Args:
        file: URDF or MJCF, without its actuators and sensors. Links do not collide.
        joints: names of the joints, in the order of q. Other joints of the file, as of a hand, are fixed,
            and couplings between joints then removed.
        start: joint positions [rad].
        motor_inertia: inertia of each rotor, seen at its joint [kg m^2].
        timestep: duration of a step [s].

    Raises:
        ValueError: MuJoCo cannot read the file, or the file lacks a joint.

    """

    def __init__(
        self, file: Path, joints: list[str], start: ArrayLike, motor_inertia: ArrayLike, timestep: float
    ) -> None:
        """Build the arm alone from a URDF or MJCF file: other joints, actuators and contacts are removed."""
        spec = mujoco.MjSpec.from_file(str(file))
        missing = set(joints) - {joint.name for joint in spec.joints}
        if missing:
            raise ValueError(f"{file}: has no joint {', '.join(sorted(missing))}; set model to a file of this robot")
        others = [joint for joint in spec.joints if joint.name not in joints]
        for couplings in (spec.equalities, spec.tendons) if others else ():
            for coupling in list(couplings):
                spec.delete(coupling)
        for element in [*spec.actuators, *spec.sensors, *spec.keys, *others]:
            spec.delete(element)
        spec.compiler.fusestatic = False
        for geom in list(spec.geoms):
            if file.suffix == ".urdf" and geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geom)  # a URDF states its inertias, and its meshes often lie elsewhere
            else:
                geom.contype, geom.conaffinity = 0, 0
        spec.option.timestep = timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        ids = [self.model.joint(name).id for name in joints]
        self._q, self._dq = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]
        self.model.dof_armature[self._dq] = motor_inertia
        self.data.qpos[self._q] = start
        mujoco.mj_forward(self.model, self.data)

    @property
    def q(self) -> Array:
        """Joint positions [rad]."""
        return np.array(self.data.qpos[self._q])

    @property
    def dq(self) -> Array:
        """Joint velocities [rad/s]."""
        return np.array(self.data.qvel[self._dq])

    def step(self, torque: Array) -> None:
        """Advance by a timestep under a held torque [N m], compensation not included."""
        mujoco.mj_step1(self.model, self.data)
        self.data.qfrc_applied[:] = self.data.qfrc_bias
        self.data.qfrc_applied[self._dq] += torque
        mujoco.mj_step2(self.model, self.data)

    def brake(self) -> None:
        """Close the brakes: the arm stops where it is."""
        self.data.qvel[:] = 0.0


def rotation_vector(rotation: Array) -> Array:
    """Return axis times angle [rad] of a rotation matrix; the angle is at most pi."""
    quaternion, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def pose_matrix(position: ArrayLike, vector: ArrayLike) -> Array:
    """Return the pose (4, 4) of a position [m] and a rotation vector [rad]; NaN for a vector that is not finite."""
    turn = np.asarray(vector, float)
    angle = float(np.linalg.norm(turn))
    if not np.isfinite(angle):
        return np.full((4, 4), np.nan)
    quaternion, rotation, pose = np.empty(4), np.empty(9), np.eye(4)
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
    mujoco.mju_quat2Mat(rotation, quaternion)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose
