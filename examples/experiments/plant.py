# SPDX-License-Identifier: MIT
"""Simulate the LBR iiwa 14 with a tool over a surface: MuJoCo behind a torque interface.

The arm comes from urdf/iiwa14.urdf through MuJoCo's own URDF reader. Its kinematics and masses are therefore
independent of stiffgen's, and the tests compare the two.

Like KUKA's controller, the plant adds the torques that cancel gravity and Coriolis effects of the arm with its tool. A
zero command lets the arm float.

The motors' inertia at the joints is our choice: the paper does not state it, a URDF has none, and with the links'
inertia alone the paper's damping cannot run at 5 ms. The wrist's light directions would need a sample time 30 times
shorter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from examples.experiments.tool import URDF, WorkingTool
from stiffgen import StiffgenError

Array = NDArray[np.float64]

DOF = 7
FLANGE = "link_ee"
START_POSTURE: Array = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
"""Start configuration of the paper's bowl experiment [rad]."""

MOTOR_INERTIA = 0.2
"""[kg m^2] of each motor as it appears at its joint."""
LONGEST_SUBSTEP = 0.0005
"""[s] of the physics."""
CONTACTS = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
"""The first type of a contact's rows; those of other contacts follow, and nothing else."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Height field that the tool can touch; metres in the base frame.

    Attributes:
        name: of the geometry in the model.
        centre: x and y of the grid's middle.
        half: half of its extent along x and y.
        height: (rows, columns) heights; rows along y, columns along x, both ascending.
        friction: coefficient of sliding friction with the tool.
        softness: time constant of the contact [s]; a hard contact chatters from cell to cell.

    """

    name: str
    centre: tuple[float, float]
    half: tuple[float, float]
    height: Array
    friction: float = 0.5
    softness: float = 0.02


class Plant:
    """Arm, tool and surface. Deterministic: the same torques give the same motion, bit for bit, on one machine.

    Args:
        timestep: [s] that one :meth:`step` advances, the torque held; the physics runs in substeps of at most
            LONGEST_SUBSTEP.
        surface: the surface, or None for free space.
        tool: the tool on the flange. Without one the flange is the tip.
        q: joint positions at the start [rad], at rest.

    Raises:
        StiffgenError: a timestep that is not positive, or a q of another shape.

    """

    def __init__(
        self,
        timestep: float = 0.001,
        *,
        surface: Surface | None = None,
        tool: WorkingTool | None = None,
        q: ArrayLike = START_POSTURE,
    ) -> None:
        """Build the model, whose substeps [s] divide the timestep evenly, and place the arm at q [rad]."""
        if not 0 < timestep < np.inf:
            raise StiffgenError(f"timestep {timestep} s must be positive")
        self._substeps = int(np.ceil(timestep / LONGEST_SUBSTEP * (1 - 1e-12)))
        self.model = _model(surface, tool, timestep / self._substeps)
        self.data = mujoco.MjData(self.model)
        self.timestep = timestep
        self._steps = 0
        self._tip = self.model.site("tip").id
        self._sensor = self.model.site("sensor").id
        addresses = [self.model.sensor(name).adr[0] for name in ("force", "torque")]
        self._reading = np.add.outer(addresses, range(3)).ravel()  # places of both among the sensors' numbers
        self._held = self.model.body("tool" if tool else FLANGE).id  # what the force/torque sensor holds
        self._payload = _payload(self.model, self._held)
        self._weight, self._per_lever, self._hangs = np.zeros(3), np.zeros((3, 3)), False
        self._computed: tuple[bytes, bytes] | None = None
        self.place(np.asarray(q, dtype=float))

    def place(self, q: Array) -> None:
        """Put the arm to a configuration [rad], at rest."""
        if q.shape != (DOF,):
            raise StiffgenError(f"q has shape {q.shape}, not ({DOF},)")
        self.data.qpos[:] = q
        self.data.qvel[:] = 0
        self._forward(np.zeros(DOF))

    def hang(self, mass: float) -> None:
        """Hang a weight [kg] at the tip: a force without inertia."""
        self._weight = mass * np.array(self.model.opt.gravity)
        self._per_lever = np.cross(np.eye(3), self._weight)  # lever @ it is lever x weight
        self._hangs = bool(self._weight.any())
        self._forward(np.zeros(DOF))

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self._steps * self.timestep

    @property
    def q(self) -> Array:
        """Joint positions [rad]."""
        return np.array(self.data.qpos)

    @property
    def dq(self) -> Array:
        """Joint velocities [rad/s]."""
        return np.array(self.data.qvel)

    @property
    def pose(self) -> Array:
        """(4, 4) pose of the tip, the tool point, in the base frame [m]."""
        pose = np.eye(4)
        pose[:3, :3] = self.data.site_xmat[self._tip].reshape(3, 3)
        pose[:3, 3] = self.data.site_xpos[self._tip]
        return pose

    def step(self, torque: ArrayLike) -> None:
        """Advance one timestep under a held torque command, compensation not included [N m]."""
        torque = np.asarray(torque, dtype=float)
        for substep in range(self._substeps):
            if substep or self._computed != self._state():  # else the last step has ended with what mj_step1 computes
                mujoco.mj_step1(self.model, self.data)
                self._pull()
            self.data.qfrc_applied[:] = torque + self.data.qfrc_bias
            mujoco.mj_step2(self.model, self.data)
        self._steps += 1
        self._forward(torque)  # so that all results belong to the new state

    def _forward(self, torque: Array) -> None:
        mujoco.mj_fwdPosition(self.model, self.data)
        self._pull()
        mujoco.mj_fwdVelocity(self.model, self.data)
        self.data.qfrc_applied[:] = torque + self.data.qfrc_bias
        mujoco.mj_forwardSkip(self.model, self.data, mujoco.mjtStage.mjSTAGE_VEL, 0)  # the rest of mj_forward
        self._computed = self._state()

    def _state(self) -> tuple[bytes, bytes]:
        return self.data.qpos.tobytes(), self.data.qvel.tobytes()

    def _pull(self) -> None:
        """Apply the force of a hanging weight at the present position."""
        if self._hangs:
            lever = self.data.site_xpos[self._tip] - self.data.xipos[self._held]
            self.data.xfrc_applied[self._held] = [*self._weight, *(lever @ self._per_lever)]

    @property
    def reading(self) -> Array:
        """Reading (6) of the force/torque sensor between flange and tool, flange axes: robot on tool [N, N m]."""
        return np.array(self.data.sensordata[self._reading])

    def wrench(self, robot: Any) -> Array:
        """Return the wrench (force [N], moment [N m]) of the environment on the robot at the tip, base axes.

        The generated functions of ``robot``, the arm with the tool and :data:`examples.experiments.tool.SENSOR`, take
        the tool's weight and inertia from the sensor's reading, and shift the moment to the tip.
        """
        motion = self.q, self.dq, self.data.qacc
        wrench = robot.sensor.tip_wrench_dynamic(*motion, self.reading, np.zeros(6), self._payload)
        return np.asarray(wrench, dtype=float).ravel()

    def contact_wrench(self) -> Array:
        """Return the sum of the contact forces on the tool, with which :meth:`wrench` must agree."""
        touching, contacts = self._tool_contacts(), self.data.contact
        local = np.empty((len(touching), 6))
        for of_contact, index in zip(local, touching, strict=True):
            mujoco.mj_contactForce(self.model, self.data, index, of_contact)
        # On the second geom of the pair, in the contact's axes (rows of the frame), at its position. MuJoCo orders a
        # pair by the geoms' types: the height field comes first.
        axes = contacts.frame[touching].reshape(-1, 3, 3)
        force, moment = np.moveaxis(local.reshape(-1, 2, 3) @ axes, 1, 0)
        lever = contacts.pos[touching] - self.data.site_xpos[self._tip]
        return np.concatenate([force.sum(axis=0), (moment + np.cross(lever, force)).sum(axis=0)])

    def external_torque(self) -> Array:
        """Joint torques of contacts and hanging weight, J^T wrench [N m]: KUKA's controller estimates these torques."""
        data = self.data
        is_contact = data.efc_type >= CONTACTS
        torque, at_tip = np.zeros(DOF), np.empty((3, DOF))
        mujoco.mj_mulJacTVec(self.model, data, torque, np.where(is_contact, data.efc_force, 0.0))
        mujoco.mj_jacSite(self.model, data, at_tip, None, self._tip)
        return np.asarray(torque + at_tip.T @ self._weight)

    @property
    def in_contact(self) -> bool:
        """Whether the tool touches the surface."""
        return len(self._tool_contacts()) > 0

    @property
    def arm_in_contact(self) -> bool:
        """Whether a link of the arm touches the surface, which it should not."""
        return bool(self.data.ncon > len(self._tool_contacts()))

    def _tool_contacts(self) -> NDArray[np.intp]:
        """Return the indices of the contacts between tool and surface."""
        contacts = self.data.contact  # their fields as arrays: one by one they take longer than a step
        held = (self.model.geom_bodyid[contacts.geom] == self._held).any(axis=1)
        return np.flatnonzero(held & (contacts.efc_address >= 0))


def _payload(model: mujoco.MjModel, body: int) -> Array:
    """Return mass, first moment and inertia (10) of a body about its frame's origin, as sensor functions take them."""
    mass, com, turn = model.body_mass[body], model.body_ipos[body], np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.concatenate([[mass], mass * com, tensor[np.triu_indices(3)]])


def _model(surface: Surface | None, tool: WorkingTool | None, substep: float) -> mujoco.MjModel:
    """Return MuJoCo's model of the iiwa 14 with sensor, and with tool and surface where given; substep in s."""
    if not URDF.is_file():
        raise StiffgenError(f"{URDF.name} is not in urdf/; run the example from a checkout of the repository")
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False  # the tool stays a body of its own, which a sensor can hold
    spec.compiler.discardvisual = False  # the tool's parts that touch nothing are still to be seen
    spec.option.timestep = substep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10  # little creep under friction
    for joint in spec.joints:
        joint.armature = MOTOR_INERTIA
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 1  # the arm's links can touch the surface, not each other
    flange = spec.body(FLANGE)
    held = flange if tool is None else _add_tool(flange, tool)
    held.add_site(name="sensor", pos=[0, 0, 0])
    held.add_site(name="tip", pos=[0, 0, tool.point if tool else 0])
    for name, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    if surface:
        _add_surface(spec, surface)
        sun = spec.worldbody.add_light(pos=[0, 0, 2], dir=[0.4, 0.8, -0.35])  # low, so that obstacles are to be seen
        sun.type, sun.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, False
    return spec.compile()


def _add_tool(flange: mujoco.MjsBody, tool: WorkingTool) -> mujoco.MjsBody:
    """Hang the tool on the flange: a mass that touches by its spheres only."""
    body = flange.add_body(
        name="tool", mass=tool.mass, ipos=[0, 0, tool.com], inertia=tool.inertia, explicitinertial=True
    )
    for part in tool.parts:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            fromto=[0, 0, part.start, 0, 0, part.end],
            size=[part.radius, 0, 0],
            rgba=part.rgba,
            contype=0,
            conaffinity=0,
        )
    for centre in tool.spheres:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=centre,
            size=[tool.sphere_radius, 0, 0],
            rgba=[0.1, 0.45, 0.7, 1],
            contype=0,
            conaffinity=1,
        )
    return body


def _add_surface(spec: mujoco.MjSpec, surface: Surface) -> None:
    """Add the surface as a height field, with its friction and softness."""
    height = surface.height
    rows, columns = height.shape
    spec.add_hfield(
        name=surface.name,
        size=[*surface.half, height.max() - height.min(), 0.03],
        nrow=rows,
        ncol=columns,
        userdata=height.ravel(),
    )
    spec.worldbody.add_geom(
        name=surface.name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=surface.name,
        pos=[*surface.centre, height.min()],
        rgba=[0.85, 0.82, 0.75, 1],
        contype=1,
        conaffinity=1,
        friction=[surface.friction, 0.005, 0.0001],
        priority=1,  # its friction and softness hold, whatever touches it
        solref=[surface.softness, 1.0],
        solimp=[0.5, 0.95, 0.003, 0.5, 2.0],
    )
