# SPDX-License-Identifier: MIT
"""Evaluate a chain of a URDF with Pinocchio, independent of stiffgen: ElementTree reads tree, mimic joints and order.

Pinocchio ignores ``<mimic>`` here (its default): every joint is free, and the follower's relation to its master comes
in through the coupling matrix, positions = C q + offset. Joints off the chain stand at their offsets, but those that
follow a coordinate of the chain move with it.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from support.chains import child_of

MOVING = ("revolute", "continuous", "prismatic")
FRAMES = {"body": pin.LOCAL, "spatial": pin.WORLD, "hybrid": pin.LOCAL_WORLD_ALIGNED}


@dataclass
class State:
    """Pinocchio's values at one q: pose (4,4), mass matrix (n,n), and by representation J (6,n) and dJ/dq (n,6,n)."""

    pose: np.ndarray
    mass_matrix: np.ndarray
    jacobian: dict[str, np.ndarray]
    derivative: dict[str, np.ndarray]

    def joint_stiffness(self, representation: str, wrench: np.ndarray, corrected_stiffness: np.ndarray) -> np.ndarray:
        """Return dJ^T/dq F + J^T (K + Gamma F) J, for a known K + Gamma F."""
        J = self.jacobian[representation]
        kinematic = np.stack([dJ.T @ wrench for dJ in self.derivative[representation]], axis=1)
        return np.asarray(kinematic + J.T @ corrected_stiffness @ J)


def with_exact_right_angles(text: str) -> str:
    """Return a URDF with rounded right angles in full: stiffgen takes 1.57079632679 as pi/2, Pinocchio as written."""
    text = re.sub(r"1\.570796326\d*", repr(math.pi / 2), text)
    return re.sub(r"3\.1415926535\d*", repr(math.pi), text)


def readable_by_pinocchio(xml: str | bytes, masses: bool = True) -> ET.Element:
    """Return the tree with links, inertials (on request) and joints alone, and the limits that urdfdom insists on."""
    source = ET.fromstring(xml)
    robot = ET.Element("robot", {"name": source.get("name") or "robot"})
    for link in source.findall("link"):
        kept = ET.SubElement(robot, "link", {"name": link.get("name", "")})
        inertial = link.find("inertial")
        if inertial is not None and masses:
            for number in inertial:  # urdfdom drops an inertial for a blank behind a number
                number.attrib.update({key: value.strip() for key, value in number.attrib.items()})
            kept.append(inertial)
    for joint in source.findall("joint"):
        kept = ET.SubElement(robot, "joint", dict(joint.attrib))
        moving = joint.get("type") in MOVING
        for tag in ("origin", "parent", "child", "mimic", *(("axis",) if moving else ())):
            child = joint.find(tag)
            if child is not None:
                kept.append(child)
        if moving:
            ET.SubElement(kept, "limit", {"lower": "-9", "upper": "9", "velocity": "9", "effort": "9"})
    return robot


class PinocchioChain:
    """Chain in Pinocchio; ValueError if Pinocchio cannot read the robot, or if a mimic relation is broken."""

    def __init__(self, xml: str | bytes, tip: str, base: str | None = None, *, masses: bool = True) -> None:
        """Build Pinocchio's model of the URDF, and the matrix from coordinates to moving joints."""
        self.xml = readable_by_pinocchio(xml, masses)
        self.joints = {joint.get("name", ""): joint for joint in self.xml.findall("joint")}
        above = {child_of(joint, "child").get("link"): joint for joint in self.joints.values()}
        path, link = [], tip
        while link in above and link != base:
            path.append(above[link])
            link = child_of(above[link], "parent").get("link", "")
        assert base in (None, link), f"{base} is no ancestor of {tip}"
        self.base, self.tip = link, tip
        try:
            self.model = self._model()
        except ValueError:  # a fault beside the chain; what the chain does not use is cut away
            self._prune(path, masses)
            self.model = self._model()
        self.data = self.model.createData()
        on_path = [joint.get("name", "") for joint in reversed(path) if joint.get("type") in MOVING]
        others = [name for name, joint in self.joints.items() if joint.get("type") in MOVING and name not in on_path]
        others = [name for name in others if masses and self.model.existJointName(name)]
        relations = {name: self._relation(name) for name in (*on_path, *others)}
        self.coordinates = list(dict.fromkeys(relations[name][0] for name in on_path if relations[name][1] != 0))
        self.moving = [name for name, (master, rate, _) in relations.items() if rate and master in self.coordinates]
        self.coupling = np.zeros((len(self.moving), len(self.coordinates)))
        for row, name in enumerate(self.moving):
            master, multiplier, _ = relations[name]
            self.coupling[row, self.coordinates.index(master)] = multiplier
        self.columns = [self._column(name) for name in self.moving]
        self.offsets = np.zeros(self.model.nv)
        for name, joint in self.joints.items():
            if joint.get("type") in MOVING and self.model.existJointName(name) and (masses or name in on_path):
                self.offsets[self._column(name)] = self._relation(name)[2]

    def _model(self) -> pin.Model:
        return pin.buildModelFromXML(ET.tostring(self.xml, encoding="unicode"))

    def _prune(self, path: list[ET.Element], masses: bool) -> None:
        """Remove the links and joints that the chain does not use."""
        kept = {self.base, *(child_of(joint, "child").get("link") for joint in path)}
        first = next(joint for joint in reversed(path) if joint.get("type") in MOVING)
        beyond = [child_of(first, "child").get("link")] if masses else []
        while beyond:
            link = beyond.pop()
            kept.add(link)
            beyond += [
                child_of(j, "child").get("link")
                for j in self.joints.values()
                if child_of(j, "parent").get("link") == link
            ]
        for element in list(self.xml):
            child = element.find("child")
            link = element.get("name") if child is None else child.get("link")
            if link not in kept or (child is not None and link == self.base):
                self.xml.remove(element)

    def _column(self, joint: str) -> int:
        return int(self.model.joints[self.model.getJointId(joint)].idx_v)

    def _relation(self, joint: str) -> tuple[str, float, float]:
        """Return the joint that moves another one through mimic relations, with multiplier and offset."""
        multiplier, offset, steps = 1.0, 0.0, 0
        while (mimic := self.joints[joint].find("mimic")) is not None:
            if self.joints[joint].get("type") not in MOVING:
                break
            offset += multiplier * float(mimic.get("offset", 0))
            multiplier *= float(mimic.get("multiplier", 1))
            joint = mimic.get("joint", "")
            if (steps := steps + 1) > len(self.joints) or joint not in self.joints:
                raise ValueError("broken mimic")
        return joint, multiplier if self.joints[joint].get("type") in MOVING else 0.0, offset

    def at(self, q: np.ndarray) -> State:
        """Return pose, masses, and Jacobians with derivatives at positions q (n), by Pinocchio."""
        model, data = self.model, self.data
        rates, positions = self._at(q)
        mass = pin.crba(model, data, positions).reshape(model.nv, -1)
        mass = np.triu(mass) + np.triu(mass, 1).T
        tip, base = (model.getFrameId(link, pin.FrameType.BODY) for link in (self.tip, self.base))
        derivative: dict[str, list[np.ndarray]] = {name: [] for name in FRAMES}
        for rate in rates.T:
            pin.computeJointJacobiansTimeVariation(model, data, positions, np.ascontiguousarray(rate))
            pin.updateFramePlacements(model, data)
            into_base = data.oMf[base].inverse()
            for name, frame in FRAMES.items():
                change = pin.getFrameJacobianTimeVariation(model, data, tip, frame).reshape(6, -1)
                derivative[name].append(_seen_from(name, into_base) @ change @ rates)
        jacobian = {
            name: _seen_from(name, into_base) @ pin.getFrameJacobian(model, data, tip, frame).reshape(6, -1) @ rates
            for name, frame in FRAMES.items()
        }
        pose = (into_base * data.oMf[tip]).homogeneous
        if not np.isfinite(mass).all():  # inertias near 1e308 in links that the chain does not even carry
            raise ValueError("Pinocchio itself overflows")
        stacked = {name: np.stack(values) for name, values in derivative.items()}
        return State(pose, rates.T @ mass @ rates, jacobian, stacked)

    def _at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the coordinates' rates as Pinocchio's rates, and the positions of all joints."""
        rates = np.zeros((self.model.nv, len(self.coordinates)))
        rates[self.columns] = self.coupling
        return rates, pin.integrate(self.model, pin.neutral(self.model), self.offsets + rates @ q)

    def forces(self, q: np.ndarray, velocity: np.ndarray, gravity: np.ndarray) -> dict[str, np.ndarray]:
        """Return bias forces, gradient and Hessian of gravity's potential, for free fall in base axes."""
        model, data = self.model, self.data
        rates, positions = self._at(q)
        pin.framesForwardKinematics(model, data, positions)
        base = data.oMf[model.getFrameId(self.base, pin.FrameType.BODY)]
        model.gravity.linear = base.rotation @ gravity
        return {
            "bias_forces": rates.T @ pin.nonLinearEffects(model, data, positions, rates @ velocity),
            "gravity_gradient": rates.T @ pin.computeGeneralizedGravity(model, data, positions),
            "gravity_joint_stiffness": rates.T
            @ pin.computeGeneralizedGravityDerivatives(model, data, positions).reshape(model.nv, model.nv)
            @ rates,
        }


def _seen_from(representation: str, into_base: pin.SE3) -> np.ndarray:
    """Return the matrix that turns a twist in the root frame into one in the base frame."""
    if representation == "spatial":
        return np.asarray(into_base.action)
    turn = np.eye(6)
    if representation == "hybrid":
        turn[:3, :3] = turn[3:, 3:] = into_base.rotation
    return turn
