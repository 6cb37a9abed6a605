# SPDX-License-Identifier: MIT
"""Simulate the quadruped on its contact springs; MuJoCo reads the URDF, independent of stiffgen.

The contacts are springs, not MuJoCo's soft constraints: a force K (p0 - p) on every foot, with the foot's position from
MuJoCo's own kinematics. The ground is therefore exactly as the prediction assumes, and only the prediction is tested.
A wall in front of a foot, if there is one, pushes back in proportion to the depth, and never pulls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from examples.whole_body.stance import FEET, GRAVITY
from stiffgen import StiffgenError

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array], Array]
"""(base_pose (4, 4), q (12), dq (12)) -> torques of the joints (12) [N m]."""

URDF = Path(__file__).resolve().parents[2] / "tests" / "data" / "solo12.urdf"
TIMESTEP = 0.0002
"""[s] of the physics; the law is played at every step, so that its hold costs no damping that could be seen."""


@dataclass(frozen=True)
class Wall:
    """A wall across x: a foot beyond ``at`` [m] is pushed back with ``stiffness`` [N/m]."""

    foot: str
    at: float
    stiffness: float


class Plant:
    """Robot in the world.

    Args:
        base_pose: (4, 4) pose of the base link at the start [m].
        q: (12) joint positions at the start [rad]; at rest.
        contacts: foot to (place (3) [m], stiffness (3, 3) [N/m]) of its contact spring.
        load: constant force on the base link's origin, world axes [N].
        wall: what a foot can press on.

    """

    def __init__(
        self,
        base_pose: Array,
        q: Array,
        contacts: dict[str, tuple[Array, Array]],
        load: Array | None = None,
        wall: Wall | None = None,
    ) -> None:
        """Place base (4, 4) and joints, with a spring per foot: place (3) [m] and stiffness (3, 3) [N/m]."""
        self.model = _model()
        self.data = mujoco.MjData(self.model)
        self._sites = np.array([self.model.site(foot).id for foot in FEET])
        self._bodies = self.model.site_bodyid[self._sites]
        self._base = self.model.body("base_link").id
        self._places, self._springs = np.zeros((len(FEET), 3)), np.zeros((len(FEET), 3, 3))
        for foot, (place, stiffness) in contacts.items():
            self._places[FEET.index(foot)], self._springs[FEET.index(foot)] = place, stiffness
        self.load, self._wall = np.zeros(3) if load is None else load, wall
        self.data.qpos[:3] = base_pose[:3, 3]
        self.data.qpos[3:7] = Rotation.from_matrix(base_pose[:3, :3]).as_quat(scalar_first=True)
        self.data.qpos[7:] = q
        self.ground = np.zeros((len(FEET), 3))
        self.wall = np.zeros(3)
        mujoco.mj_forward(self.model, self.data)

    @property
    def base_pose(self) -> Array:
        """(4, 4) of the base link in the world [m]."""
        pose = np.eye(4)
        pose[:3, :3] = self.data.xmat[self._base].reshape(3, 3)
        pose[:3, 3] = self.data.xpos[self._base]
        return pose

    @property
    def q(self) -> Array:
        """Joint positions (12) [rad]."""
        return np.array(self.data.qpos[7:])

    @property
    def rates(self) -> Array:
        """(18): body twist of the base link, linear first, and the joints' rates."""
        turn = self.base_pose[:3, :3]
        return np.concatenate([turn.T @ self.data.qvel[:3], self.data.qvel[3:]])

    def kick(self, momentum: Array) -> None:
        """Change the rates by an impulse (18), a generalised force for a moment [N s, N m s]."""
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        turn = self.base_pose[:3, :3]
        in_world = np.concatenate([turn @ momentum[:3], momentum[3:]])
        self.data.qvel += np.linalg.solve(full, in_world)

    def step(self, law: Law, push: Array | None = None) -> None:
        """Advance one TIMESTEP; ``push``: a force on the base link's origin beside the load, world axes [N].

        Leaves in ``ground`` (feet, 3) and ``wall`` (3) the forces that acted on the feet [N].
        """
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        places = data.site_xpos[self._sites]
        self.ground = np.einsum("fij,fj->fi", self._springs, self._places - places)
        on_feet = self.ground.copy()
        if self._wall is not None:
            foot = FEET.index(self._wall.foot)
            depth = max(0.0, places[foot, 0] - self._wall.at)  # [m] behind the wall's surface
            self.wall = np.array([-self._wall.stiffness * depth, 0.0, 0.0])
            on_feet[foot] += self.wall
        on_base = self.load if push is None else self.load + push
        force = np.zeros(model.nv)  # generalised
        for body, point, each in zip(self._bodies, places, on_feet, strict=True):
            mujoco.mj_applyFT(model, data, each, np.zeros(3), point, body, force)
        mujoco.mj_applyFT(model, data, on_base, np.zeros(3), data.xpos[self._base], self._base, force)
        force[6:] += law(self.base_pose, self.q, np.array(data.qvel[6:]))
        data.qfrc_applied[:] = force
        mujoco.mj_step2(model, data)

    def acceleration(self, law: Law) -> Array:
        """Return the gradient of the total energy (18) at this state: zero at rest."""
        state = np.array(self.data.qpos), np.array(self.data.qvel)
        self.step(law)
        found = np.array(self.data.qacc)
        self.data.qpos[:], self.data.qvel[:] = state
        mujoco.mj_forward(self.model, self.data)
        return found


def _model() -> mujoco.MjModel:
    """Return MuJoCo's model of the quadruped with a free base and sites at its feet."""
    if not URDF.is_file():
        raise StiffgenError(f"{URDF.name} is not in tests/data/; run the example from a checkout of the repository")
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False  # the base stays a body, to which the free joint goes
    spec.body("base_link").add_freejoint()
    for foot in FEET:
        spec.body(foot).add_site(name=foot)
    spec.option.timestep = TIMESTEP
    spec.option.gravity = GRAVITY
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # with no damping: semi-implicit, keeps the energy
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return spec.compile()
