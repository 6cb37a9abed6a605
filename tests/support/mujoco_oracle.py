# SPDX-License-Identifier: MIT
"""Evaluate a chain of an MJCF file with MuJoCo, independent of stiffgen: MuJoCo reads the file, joints go by name.

Coordinates are joints of the model. A constraint between joints that is linear determines the position of one joint
from another; all other joints stand at zero (ball joints at their reference).
"""

from __future__ import annotations

import copy
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from support.pinocchio_oracle import State

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@lru_cache(maxsize=1)
def _model(file: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(file)


def _index(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Return the number of a body, site or joint; -1 if there is none.

    An element without a name is called by kind and number, and a site with the name of a body has "_site" behind it.
    """
    type_ = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "joint": mujoco.mjtObj.mjOBJ_JOINT}
    found = int(mujoco.mj_name2id(model, type_[kind], name))
    if found < 0 and kind == "site" and name.endswith("_site"):
        found = int(mujoco.mj_name2id(model, type_[kind], name.removesuffix("_site")))
    number = name.removeprefix(kind)
    if found < 0 and number.isdigit() and mujoco.mj_id2name(model, type_[kind], int(number)) in (None, ""):
        found = int(number)
    return found


class MujocoChain:
    """Chain between two bodies (or from a body to a site) of a model; ``coordinates`` are names of joints."""

    def __init__(self, file: str | Path, tip: str, base: str, coordinates: list[str]) -> None:
        """Load the model without armature, which the chain counts separately, and find tip, base and joints."""
        self.model = copy.deepcopy(_model(str(file)))
        self.data = mujoco.MjData(self.model)
        self.coordinates = coordinates
        m = self.model
        self.armature = m.dof_armature.copy()
        m.dof_armature[:] = 0
        m.tendon_armature[:] = 0
        m.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        mujoco.mj_setConst(m, self.data)  # the masses that MuJoCo stores for single bodies contain the armature
        body = _index(m, "body", tip)
        self.site = _index(m, "site", tip) if body < 0 else -1
        assert body >= 0 or self.site >= 0, tip
        self.body = m.site_bodyid[self.site] if body < 0 else body
        self.base = _index(m, "body", base)
        assert self.base >= 0, base
        self.joints = [_index(m, "joint", name) for name in coordinates]
        assert min(self.joints) >= 0, coordinates
        self.relations = self._constraints()
        self.offsets = self._positions(np.zeros(len(coordinates)))
        steps = [self._positions(row) - self.offsets for row in np.eye(len(coordinates))]
        self.rates = np.zeros((m.nv, len(coordinates)))
        for column, step in enumerate(steps):
            self.rates[m.jnt_dofadr[self._scalar], column] = step[self._scalar]
        self.motor_inertia = np.diag(self.rates.T @ np.diag(self.armature) @ self.rates)

    @property
    def _scalar(self) -> np.ndarray:
        return np.flatnonzero(np.isin(self.model.jnt_type, (HINGE, SLIDE)))

    def _constraints(self) -> list[tuple[dict[int, float], float]]:
        """Return rates and constants of the constraints that are linear: sum of rates * positions = constant."""
        m, found = self.model, []
        reference = np.array([m.qpos0[address] for address in m.jnt_qposadr])
        for k in range(m.neq):
            polynomial, one, two = m.eq_data[k][:5], m.eq_obj1id[k], m.eq_obj2id[k]
            if not m.eq_active0[k] or (two >= 0 and polynomial[2:].any()):
                continue
            if m.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
                sides = [{int(one): 1.0}, {} if two < 0 else {int(two): 1.0}]
            elif m.eq_type[k] == mujoco.mjtEq.mjEQ_TENDON:
                sides = [self._tendon(one), {} if two < 0 else self._tendon(two)]
            else:
                continue
            rates: dict[int, float] = {}
            for side, factor in zip(sides, (1.0, -polynomial[1]), strict=True):
                for joint, rate in side.items():
                    rates[joint] = rates.get(joint, 0.0) + factor * rate
            found.append((rates, polynomial[0] + sum(rate * reference[joint] for joint, rate in rates.items())))
        return found

    def _tendon(self, tendon: int) -> dict[int, float]:
        m = self.model
        wraps = range(m.tendon_adr[tendon], m.tendon_adr[tendon] + m.tendon_num[tendon])
        return {int(m.wrap_objid[k]): float(m.wrap_prm[k]) for k in wraps}

    def _positions(self, q: np.ndarray) -> np.ndarray:
        """Return the positions of all joints: coordinates, joints that constraints determine, zeros."""
        known = dict(zip(self.joints, q, strict=True))
        pending = list(self.relations)
        while pending:
            ready = [each for each in pending if len(each[0].keys() - known.keys()) <= 1]
            if not ready:  # beside the chain: a joint that others follow, and that follows none, stands at zero
                followers = {next(iter(rates)) for rates, _ in pending}
                known[next(k for rates, _ in pending for k in rates if k not in {*followers, *known})] = 0.0
                continue
            pending.remove(ready[0])
            rates, constant = ready[0]
            for joint in rates.keys() - known.keys():
                others = sum(rate * known[k] for k, rate in rates.items() if k != joint)
                known[joint] = (constant - others) / rates[joint]
        return np.array([known.get(k, 0.0) for k in range(self.model.njnt)])

    def _update(self, q: np.ndarray, velocity: np.ndarray) -> None:
        """Move MuJoCo's model to q and velocity, and update what its functions read."""
        m, d = self.model, self.data
        d.qpos[:] = m.qpos0
        positions = self._positions(q)
        d.qpos[m.jnt_qposadr[self._scalar]] = positions[self._scalar]
        d.qvel[:] = self.rates @ velocity
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb, mujoco.mj_comVel):
            step(m, d)

    def _frame(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the base's rotation, rotation and position of the tip in the base, and the tip's point."""
        d = self.data
        R, p = (d.site_xmat, d.site_xpos) if self.site >= 0 else (d.xmat, d.xpos)
        index = self.site if self.site >= 0 else self.body
        base = d.xmat[self.base].reshape(3, 3)
        return base, base.T @ R[index].reshape(3, 3), base.T @ (p[index] - d.xpos[self.base]), p[index].copy()

    def at(self, q: np.ndarray) -> State:
        """Return pose, masses, and Jacobians with derivatives at positions q (n), by MuJoCo."""
        m, d = self.model, self.data
        self._update(q, np.zeros(len(q)))
        base, R, p, point = self._frame()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, p
        mass = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, mass)
        parts = np.zeros((2, 3, m.nv))
        mujoco.mj_jac(m, d, parts[0], parts[1], point, self.body)
        J = np.vstack([base.T @ part @ self.rates for part in parts])
        derivative: dict[str, list[np.ndarray]] = {"body": [], "spatial": [], "hybrid": []}
        for k, unit in enumerate(np.eye(len(q))):
            self._update(q, unit)
            mujoco.mj_jacDot(m, d, parts[0], parts[1], point, self.body)
            dJ = np.vstack([base.T @ part @ self.rates for part in parts])
            omega, v = _cross(J[3:, k]), J[:3, k]
            turn = np.kron(np.eye(2), R.T)
            derivative["hybrid"].append(dJ)
            derivative["body"].append(turn @ (dJ - np.kron(np.eye(2), omega) @ J))
            shifted = dJ.copy()
            shifted[:3] += _cross(v) @ J[3:] + _cross(p) @ dJ[3:]
            derivative["spatial"].append(shifted)
        spatial = J.copy()
        spatial[:3] += _cross(p) @ J[3:]
        jacobian = {"body": np.kron(np.eye(2), R.T) @ J, "spatial": spatial, "hybrid": J}
        stacked = {name: np.stack(values) for name, values in derivative.items()}
        return State(pose, self.rates.T @ mass @ self.rates, jacobian, stacked)

    def forces(self, q: np.ndarray, velocity: np.ndarray, gravity: np.ndarray) -> dict[str, np.ndarray]:
        """Return bias forces and the gradient of gravity's potential, for free fall in base axes."""
        found = {}
        for name, rates in (("bias_forces", velocity), ("gravity_gradient", np.zeros(len(q)))):
            self._update(q, rates)
            self.model.opt.gravity[:] = self._frame()[0] @ gravity
            result = np.zeros(self.model.nv)
            mujoco.mj_rne(self.model, self.data, 0, result)
            found[name] = self.rates.T @ result
        return found


def _cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
