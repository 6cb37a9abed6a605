# SPDX-License-Identifier: MIT
"""Compute mass matrix, bias forces and gravity from the URDF file, read with the standard library alone.

No reader and no derivation of stiffgen takes part: links and joints come from the XML, poses of all links from products
of 4x4 matrices in floating-point numbers, and velocities and accelerations from differences of poses. A body with the
matrix P of its second moments (4x4) and the pose H has, by d'Alembert's principle,

    M[i, j] = trace(dH/dx_i P dH/dx_j^T),    b[i] = trace(dH/dx_i P (d2H/dt2 - A)^T)

where x are the velocity coordinates, the motion has a constant rate, and A moves every point with gravity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from stiffgen.core.errors import printable
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import BASE_POSE, GRAVITY, VELOCITY, Q
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.core.verify.result import Check, Kernels, left_out, relative_errors

_BOUND = 1e-8
"""Tolerance relative to the largest entry: differences of poses lose digits."""
_STEP = 0.02
"""Step of the fastest coordinate [rad or m]: longer ones leave ninth derivatives, shorter ones rounding."""
_FIRST = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Weights of the eighth-order central difference of a first derivative, by the number of steps from the centre."""
_CENTRE = -205 / 72
_SECOND = {1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}
"""Weights of the eighth-order central difference of a second derivative; the centre has ``_CENTRE``."""
_MOVING = ("revolute", "continuous", "prismatic")
ORACLE = "URDF's XML, differences of poses"


def check_masses(
    kernels: Kernels, table: tuple[Kernel, ...], chain: Chain, urdf: Path, samples: Samples, count: int = 5
) -> list[Check]:
    """Compare the kernels of a robot's masses with the bodies of the URDF file.

    Args:
        kernels: functions, which take stacks.
        table: their records.
        chain: the robot: names of base, tip and coordinates, locked joints and the tool are taken from it.
        urdf: the file.
        samples: values of arguments.
        count: number of states.

    Returns:
        One row per kernel. For a file of another kind (xacro, MJCF), a joint type with several axes, or a robot without
        masses, one row with the reason why nothing is compared.

    """
    if any(each.is_nearest for each in chain.accepted):
        return [left_out("masses", "the nearest possible tensors take the place of the file's inertias")]
    model = _Model.read(urdf, chain) if chain.masses else "the folder was generated without masses"
    if isinstance(model, str):
        return [left_out("masses", model)]
    states = [
        model.dynamics(
            samples[Q][k], base_pose=samples[BASE_POSE][k], rates=samples[VELOCITY][k], gravity=samples[GRAVITY][k]
        )
        for k in range(count)
    ]
    checks = []
    for kernel in table:
        name = kernel.qualified_name
        if name in states[0]:
            stacks = [samples[argument][:count] for argument in kernel.arguments]
            reference = np.array([of_state[name] for of_state in states])
            errors = relative_errors(kernels[name](*stacks), reference)
            checks.append(Check(name, ORACLE, float(errors.max()), _BOUND, errors=errors))
    return checks


class _Model:
    """Links and joints of a URDF file, as its elements state them."""

    def __init__(self, root: ElementTree.Element, chain: Chain) -> None:
        """Read bodies and the tree of joints from the file; the tool's body is added to the tip's link."""
        self.chain = chain
        self.joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
        self.below: dict[str, list[str]] = {}  # joints below each link
        for name, joint in self.joints.items():
            self.below.setdefault(_link(joint, "parent"), []).append(name)
        self.bodies = {link.get("name", ""): _second_moments(link) for link in root.findall("link")}
        if chain.tool is not None:
            tool, link = chain.tool, chain.tips[0].link
            xx, xy, xz, yy, yz, zz = tool.inertia
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            self.bodies[link] = self.bodies[link] + _moments(tool.mass, np.array(tool.com), tensor)

    @staticmethod
    def read(urdf: Path, chain: Chain) -> _Model | str:
        """Read a file; return a reason in place of the model if this reader cannot."""
        text = urdf.read_bytes()
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError:
            return "the file is no XML"
        if root.tag != "robot" or b"xacro" in text:
            return "the file is a xacro" if root.tag == "robot" else "the file is of another format"
        others = {str(joint.get("type")) for joint in root.findall("joint")} - {"fixed", *_MOVING}
        if others:
            return f"the file has a joint of type {printable(min(others))}"
        return _Model(root, chain)

    def position(self, name: str, q: Mapping[str, float]) -> float:
        """Return the position of a joint: a coordinate, locked, a mimic of another joint, or zero."""
        if name in q:
            return q[name]
        mimic = self.joints[name].find("mimic")
        if mimic is None:
            return 0.0
        master = self.position(mimic.get("joint", ""), q)
        return float(mimic.get("multiplier", "1")) * master + float(mimic.get("offset", "0"))

    def poses(self, q: FloatArray, base_pose: FloatArray) -> FloatArray:
        """Return the poses (4x4) of all links that hang on the base link, the base link first."""
        named = dict(self.chain.locked) | {c.name: float(x) for c, x in zip(self.chain.coordinates, q, strict=True)}
        poses, open_links = [], [(self.chain.base, base_pose)]
        while open_links:
            link, pose = open_links.pop()
            poses.append(pose)
            for name in self.below.get(link, []):
                joint = self.joints[name]
                moved = pose @ _origin(joint) @ _motion(joint, self.position(name, named))
                open_links.append((_link(joint, "child"), moved))
        return np.array(poses)

    def links(self) -> list[str]:
        """Return the links in the order of their poses."""
        names, open_links = [], [self.chain.base]
        while open_links:
            names.append(open_links.pop())
            open_links += [_link(self.joints[name], "child") for name in self.below.get(names[-1], [])]
        return names

    def dynamics(
        self, q: FloatArray, *, base_pose: FloatArray, rates: FloatArray, gravity: FloatArray
    ) -> dict[str, FloatArray]:
        """Return mass matrix, bias forces and gravity gradient at a state, by the formulas of the module's head."""
        base_joints = self.chain.base_joints
        start = base_pose if base_joints else np.eye(4)

        def moved(x: FloatArray) -> FloatArray:
            """Return the poses (links, 4, 4) after a motion x of all velocity coordinates from the state."""
            base = start @ _exponential(x[:base_joints]) if base_joints else start
            return self.poses(q + x[base_joints:], base)

        units = np.eye(len(rates))
        columns = np.array([_first_derivative(moved, unit) for unit in units])  # dH/dx_i, (n, links, 4, 4)
        accelerations = _second_derivative(moved, rates)  # d2H/dt2, (links, 4, 4)
        bodies = np.array([self.bodies[link] for link in self.links()])  # P, (links, 4, 4)
        momenta = columns @ bodies  # dH/dx_i P
        falling = np.zeros((4, 4))  # A: a point (x, 1) accelerates by gravity
        falling[:3, 3] = gravity
        # trace(X Y^T) is the sum of X_ab Y_ab; i and j are coordinates, l is a link.
        inertia = np.einsum("ilab,lab->i", momenta, accelerations)
        weight = -np.einsum("ilab,ab->i", momenta, falling)
        matrix = np.einsum("ilab,jlab->ij", momenta, columns)
        return {"mass_matrix": matrix, "bias_forces": inertia + weight, "gravity_gradient": weight}


_MovedPoses = Callable[[FloatArray], FloatArray]
"""Function that returns the poses (links, 4, 4) after a motion of the velocity coordinates (n)."""


def _step(direction: FloatArray) -> float:
    """Return the factor with which the fastest coordinate of a direction moves by ``_STEP`` at most."""
    return _STEP / max(1.0, float(np.abs(direction).max()))


def _first_derivative(moved: _MovedPoses, direction: FloatArray) -> FloatArray:
    """Return the first derivative of the poses along a direction, by central differences."""
    step = _step(direction)
    changes = (weight * (moved(k * step * direction) - moved(-k * step * direction)) for k, weight in _FIRST.items())
    return np.asarray(sum(changes) / step)


def _second_derivative(moved: _MovedPoses, direction: FloatArray) -> FloatArray:
    """Return the second derivative of the poses along a direction, by central differences."""
    step = _step(direction)
    pairs = (weight * (moved(k * step * direction) + moved(-k * step * direction)) for k, weight in _SECOND.items())
    return np.asarray((_CENTRE * moved(0.0 * direction) + sum(pairs)) / step**2)


def _link(joint: ElementTree.Element, which: str) -> str:
    """Return the name of a joint's "parent" or "child"."""
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _numbers(element: ElementTree.Element | None, name: str, default: str) -> FloatArray:
    """Return the numbers of an attribute; ``default`` where the element or the attribute is missing."""
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()])


def _origin(element: ElementTree.Element) -> FloatArray:
    """Return the pose (4x4) [m] in an element's <origin>, from roll, pitch and yaw or a quaternion.

    Without the element, the pose is the identity.
    """
    origin, pose = element.find("origin"), np.eye(4)
    pose[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    if origin is not None and origin.get("quat_xyzw") is not None:  # URDF 1.1
        quaternion = _numbers(origin, "quat_xyzw", "")
        x, y, z, w = quaternion / np.linalg.norm(quaternion)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        pose[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        return pose
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0")
    about_x, about_y, about_z = np.eye(6)[3:]  # unit twists, linear first
    return pose @ _exponential(yaw * about_z) @ _exponential(pitch * about_y) @ _exponential(roll * about_x)


def _motion(joint: ElementTree.Element, position: float) -> FloatArray:
    """Return the motion of a joint at a position."""
    if joint.get("type") not in _MOVING:
        return np.eye(4)
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
    along_axis = position * axis / np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        return _exponential(np.concatenate([along_axis, np.zeros(3)]))
    return _exponential(np.concatenate([np.zeros(3), along_axis]))


def _exponential(motion: FloatArray) -> FloatArray:
    """Return the motion exp of a constant twist (v, w), by Rodrigues' formulas.

    With the angle a = |w|, the rotation is I + sin(a)/a [w] + (1 - cos a)/a^2 [w]^2, and the translation is
    v + (1 - cos a)/a^2 [w] v + (a - sin a)/a^3 [w]^2 v. Up to 1e-3 rad the last factor is its series, since the
    difference cancels.
    """
    v, w = motion[:3], motion[3:]
    angle = float(np.linalg.norm(w))
    x, y, z = w
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])  # [w]
    sine = np.sinc(angle / math.pi)  # sin(a)/a: NumPy's sinc(x) is sin(pi x)/(pi x)
    cosine = 0.5 * np.sinc(angle / (2 * math.pi)) ** 2  # (1 - cos a)/a^2 = 2 sin(a/2)^2/a^2
    remainder = (1.0 - sine) / angle**2 if angle > 1e-3 else 1 / 6 - angle**2 / 120  # (a - sin a)/a^3
    pose = np.eye(4)
    pose[:3, :3] += sine * cross + cosine * (cross @ cross)
    pose[:3, 3] = v + cosine * (cross @ v) + remainder * (cross @ cross @ v)
    return pose


def _second_moments(link: ElementTree.Element) -> FloatArray:
    """Return the matrix P (4x4) of a link's second moments, first moment and mass; zero without <inertial>."""
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros((4, 4))
    pose, inertia = _origin(inertial), inertial.find("inertia")
    mass = float(_numbers(inertial.find("mass"), "value", "0")[0])
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (float(_numbers(inertia, name, "0")[0]) for name in names)
    # [kg m^2] about the centre of mass, in the link's axes
    tensor = pose[:3, :3] @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ pose[:3, :3].T
    return _moments(mass, pose[:3, 3], tensor)


def _moments(mass: float, centre: FloatArray, tensor: FloatArray) -> FloatArray:
    """Return P of a body with an inertia tensor about its centre of mass."""
    result = np.zeros((4, 4))
    result[:3, :3] = np.trace(tensor) / 2 * np.eye(3) - tensor + mass * np.outer(centre, centre)
    result[:3, 3] = result[3, :3] = mass * centre
    result[3, 3] = mass
    return result
