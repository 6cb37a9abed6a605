# SPDX-License-Identifier: MIT
"""Caps of a stiffness where the mass matrix is singular: a point mass that a slide carries onto a hinge's axis."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import stiffgen
from stiffgen import open_robot

LIMIT = '<limit lower="-2" upper="2" effort="100" velocity="4"/>'
POINT = (
    '<robot name="point"><link name="base"/><link name="crank"/><link name="mass"><inertial><mass value="2"/>'
    '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
    f'<joint name="hinge" type="revolute"><parent link="base"/><child link="crank"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
    f'<joint name="slide" type="prismatic"><parent link="crank"/><child link="mass"/><axis xyz="1 0 0"/>{LIMIT}</joint>'
    "</robot>"
)


def test_capped_springs_stay_where_the_mass_matrix_is_singular(tmp_path: Path) -> None:
    """No command is accepted there, and mobilities have no number: the stiffness in force stays. Before, it fell."""
    (tmp_path / "point.urdf").write_text(POINT)
    arm = open_robot(stiffgen.generate(tmp_path / "point.urdf", tip="mass", output=tmp_path)).module
    controller = arm.Impedance(
        stiffness_cap="accept", motor_inertia=0.0, stiffness_time=0.01, limit_stiffness=0.0, errors="ignore"
    )
    springs = {"translation_stiffness": 300 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
    rest, axis = np.array([0.1, 0.003]), np.array([0.1, 0.0])
    for k in range(200):
        out = controller.step(q=rest, dq=np.full(2, 1e-6 * (-1) ** k), q0=rest, **springs)
    assert out.status & arm.Status.STIFFNESS_CAPPED
    before = out.rotation_stiffness
    assert 0.1 < before[2, 2] < 2.0  # of 20 N m/rad
    for k in range(40):
        dq = np.array([1e-6 * (-1) ** k, -3.0 * (k == 0)])
        out = controller.step(q=axis, dq=dq, q0=np.full(2, np.nan), **springs)
    assert out.status & arm.Status.COMMAND_REFUSED
    assert not out.fault
    np.testing.assert_array_equal(out.rotation_stiffness, before)
