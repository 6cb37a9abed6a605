# SPDX-License-Identifier: MIT
"""Angles and axes a little off a right angle: taken as right up to the one threshold, as written beyond it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.core.robot.geometry import SNAP
from stiffgen.core.symbolic.kernels import KERNELS
from support.chain_checks import value
from support.chains import chain_urdf
from support.exact_tree import chain_mass_matrix, chain_pose

POSE, MASS = (
    next(kernel for kernel in KERNELS if kernel.name == name) for name in ("forward_kinematics", "mass_matrix")
)
Q = np.array([0.7, -1.9, 2.6, 0.4])
TILTS = (1.1 * SNAP, 3e-11, 1e-10, 1e-9, 7e-9, 1e-8, 1.4e-8, 1e-7)


def errors(folder: Path, text: str, meant: str) -> tuple[float, float]:
    """Largest errors of pose and mass matrix against the exact values of ``meant``."""
    file = folder / "robot.urdf"
    file.write_text(text)
    chain = load_chain(file)
    pose = np.abs(value(chain, POSE, q=Q) - chain_pose(meant, Q)).max()
    return pose, np.abs(value(chain, MASS, q=Q) - chain_mass_matrix(meant, Q)).max()


def robot(axis: str, rpy: str = "0.1 0.2 0.3") -> str:
    """Four turning joints with one axis and one orientation."""
    text = chain_urdf("rrrr").replace("0.1 0.2 0.3", rpy)
    for other in ("0 0 1", "0 1 0", "0.6 0 0.8"):
        text = text.replace(f'<axis xyz="{other}"/>', f'<axis xyz="{axis}"/>')
    return text


@pytest.mark.parametrize(
    "tilt", [pytest.param(tilt, marks=() if tilt in (TILTS[0], 1e-10, 1e-8) else pytest.mark.wide) for tilt in TILTS]
)
@pytest.mark.parametrize("axis", ["{t} 0 1", "0 1 -{t}", "-1 {t} {t}", "0.6 {t} 0.8"])
def test_a_tilted_axis_is_tilted(tilt, axis, tmp_path):
    text = robot(axis.format(t=repr(tilt)))
    assert max(errors(tmp_path, text, text)) < 1e-14


@pytest.mark.parametrize("tilt", TILTS)
def test_an_angle_off_a_right_one_is_off(tilt, tmp_path):
    text = robot("0 0 1", rpy=f"{tilt!r} 0 {-tilt!r}")
    assert max(errors(tmp_path, text, text)) < 1e-14


@pytest.mark.parametrize("tilt", [0.9 * SNAP, 1e-13, 1e-16])
def test_below_the_threshold_axis_and_angle_are_right(tilt, tmp_path):
    tilted = robot(f"0 {tilt!r} 1", rpy=f"{tilt!r} 0 0")
    assert max(errors(tmp_path, tilted, robot("0 0 1", rpy="0 0 0"))) < 1e-14
    chain = load_chain(tmp_path / "robot.urdf")
    assert {joint.axis for joint in chain.joints} == {(0.0, 0.0, 1.0)}
    assert {joint.rotation for joint in chain.joints} == {((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))}


@pytest.mark.parametrize(("length", "kept"), [(1e-15, 0.0), (1.1e-15, 1.1e-15)])
def test_a_length_of_at_most_1e_15_metres_is_zero(length, kept, tmp_path):
    """Read lengths about 1e-15 m: up to there they are rounding and become zero, as docs/wrench.md says."""
    file = tmp_path / "robot.urdf"
    file.write_text(
        '<robot name="tiny"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        f'<child link="b"/><origin xyz="0 {length!r} 0.3"/><axis xyz="0 0 1"/></joint></robot>'
    )
    assert load_chain(file, masses=False).joints[0].translation == (0.0, kept, 0.3)
