# SPDX-License-Identifier: MIT
"""Acceleration limits of URDF 1.2 reach the governor: the equilibrium of the controller keeps within them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.control.page import config_of
from stiffgen.core.opened import open_robot

LIMIT = 'lower="-2" upper="2" velocity="{}" effort="60"'
INERTIAL = '<inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0"'


def arm(folder: Path, limits: tuple[str, str], version: str = "1.2") -> Path:
    """Write an arm of two joints with these attributes of <limit>."""
    text = f'<robot name="two" version="{version}"><link name="base"/>'
    for k, limit in enumerate(limits):
        text += (
            f'<link name="l{k}">{INERTIAL} iyz="0"/></inertial></link><joint name="j{k}" type="revolute">'
            f'<parent link="{"base" if k == 0 else "l0"}"/><child link="l{k}"/><origin xyz="0.3 0 0"/>'
            f'<axis xyz="0 0 1"/><limit {limit}/></joint>'
        )
    (folder / "two.urdf").write_text(text + "</robot>")
    return folder / "two.urdf"


def ramp_time(file: Path) -> float:
    (field,) = (each for each in config_of(stiffgen.load_chain(file)) if each.name == "ramp_time")
    return float(field.default)


def test_the_slowest_joint_decides(tmp_path: Path) -> None:
    """0.9 of the velocity limit over the smaller of the two limits, for each joint; never below the usual 0.05 s."""
    fast, slow = f'{LIMIT.format(1)} acceleration="90"', f'{LIMIT.format(2)} acceleration="9" deceleration="6" jerk="1"'
    assert ramp_time(arm(tmp_path, (fast, slow))) == 0.3
    assert ramp_time(arm(tmp_path, (fast, fast))) == 0.05
    assert ramp_time(arm(tmp_path, (slow, slow), version="1.1")) == 0.05
    assert ramp_time(arm(tmp_path, (fast, f'{LIMIT.format("inf")} acceleration="1"'))) == 0.05


@pytest.mark.slow
def test_the_equilibrium_keeps_within_the_limits(tmp_path: Path, unoptimised: None) -> None:
    """Accelerations of the reference on the way to a command and back, against the smaller limit of each joint."""
    limits = (f'{LIMIT.format(1.5)} acceleration="3" deceleration="2.5"', f'{LIMIT.format(2)} acceleration="4"')
    folder = stiffgen.generate(arm(tmp_path, limits), output=tmp_path, kernels="hybrid,spring")
    controller = open_robot(folder).module.Impedance(sample_time=1e-3)
    q, references = np.array([0.3, 0.4]), []
    stiffness = {"translation_stiffness": np.eye(3) * 100, "rotation_stiffness": np.eye(3) * 10}
    for step in range(3000):
        out = controller.step(q=q, dq=np.zeros(2), q0=q + (0.5 if 300 < step < 1500 else 0.0), **stiffness)
        references.append(out.reference.copy())
    rates = np.diff(references, axis=0) / 1e-3
    assert np.abs(rates).max() > 0.1
    accelerations = np.abs(np.diff(rates, axis=0)).max(axis=0) / 1e-3
    assert (accelerations <= np.array([2.5, 4.0]) * 1.001).all(), accelerations
