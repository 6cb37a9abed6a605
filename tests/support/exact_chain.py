# SPDX-License-Identifier: MIT
"""Pose and mass matrix of a serial chain with 60 digits, straight from the numbers in the file.

M = sum over the links of J_k^T I_k J_k: no composites, no link axes, no Steiner terms; angles and axes as written.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import mpmath
import numpy as np

from support.chains import child_of

mp = mpmath.mp.clone()
mp.dps = 60


def numbers(text: str | None, default: str) -> list[mpmath.mpf]:
    return [mp.mpf(word) for word in (text or default).split()]


def cross(a: Sequence[Any], b: Sequence[Any]) -> mpmath.matrix:
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turn(axis: Sequence[Any], angle: Any) -> mpmath.matrix:
    K = mp.matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return mp.eye(3) + mp.sin(angle) * K + (1 - mp.cos(angle)) * K * K


def origin(element: ET.Element) -> tuple[mpmath.matrix, mpmath.matrix]:
    found = element.find("origin")
    given = {} if found is None else found.attrib
    roll, pitch, yaw = numbers(given.get("rpy"), "0 0 0")
    rotation = turn((0, 0, 1), yaw) * turn((0, 1, 0), pitch) * turn((1, 0, 0), roll)
    return rotation, mp.matrix(numbers(given.get("xyz"), "0 0 0"))


def _exact(text: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    robot = ET.fromstring(text)
    links = {link.get("name"): link for link in robot.findall("link")}
    rotation, place, columns, coordinate = mp.eye(3), mp.matrix([0, 0, 0]), [], 0
    mass_matrix = mp.zeros(len(q))
    for joint in robot.findall("joint"):
        own_rotation, own_place = origin(joint)
        place, rotation = place + rotation * own_place, rotation * own_rotation
        if joint.get("type") != "fixed":
            mimic, at, multiplier, offset = joint.find("mimic"), coordinate, mp.mpf(1), mp.mpf(0)
            if mimic is None:
                coordinate += 1
            else:
                at, multiplier, offset = 0, mp.mpf(mimic.get("multiplier")), mp.mpf(mimic.get("offset"))
            position = multiplier * mp.mpf(float(q[at])) + offset
            axis = mp.matrix(numbers(child_of(joint, "axis").get("xyz"), ""))
            axis /= mp.norm(axis)
            if joint.get("type") == "prismatic":
                place = place + rotation * axis * position
            else:
                rotation = rotation * turn(axis, position)
            columns.append((at, multiplier * (rotation * axis), joint.get("type") == "prismatic", place))
        inertial = links[child_of(joint, "child").get("link")].find("inertial")
        if inertial is None:
            continue
        mass, i = mp.mpf(child_of(inertial, "mass").get("value")), child_of(inertial, "inertia").attrib
        xx, xy, xz, yy, yz, zz = (mp.mpf(i[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        com_rotation, com = origin(inertial)
        axes = rotation * com_rotation
        tensor = axes * mp.matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) * axes.T
        center = place + rotation * com
        jacobians = [(a, z if slides else cross(z, center - p), 0 * z if slides else z) for a, z, slides, p in columns]
        for a, v, w in jacobians:
            for b, other_v, other_w in jacobians:
                mass_matrix[a, b] += mass * (v.T * other_v)[0] + (w.T * tensor * other_w)[0]
    pose = np.eye(4)
    pose[:3, 3] = [float(v) for v in place]
    pose[:3, :3] = [[float(rotation[r, c]) for c in range(3)] for r in range(3)]
    return pose, np.array([[float(mass_matrix[r, c]) for c in range(len(q))] for r in range(len(q))])


def exact_pose(text: str, q: np.ndarray) -> np.ndarray:
    """Pose (4,4) of the last link in the first.

    The chain is serial, its joints stand in order in the file, and a mimic joint follows the first one.
    """
    return _exact(text, q)[0]


def exact_mass_matrix(text: str, q: np.ndarray) -> np.ndarray:
    """Mass matrix (n,n) of the same chain."""
    return _exact(text, q)[1]
