# SPDX-License-Identifier: MIT
"""Defaults of a robot with a joint of a short range, such as a finger: the controller starts with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.control.page import config_of
from support.chains import replaced
from support.project import URDF


def limit_zone(file: Path) -> float:
    (field,) = (each for each in config_of(stiffgen.load_chain(file)) if each.name == "limit_zone")
    return float(field.default)


@pytest.mark.parametrize(("upper", "zone"), [("0.04", 0.01), ("0.001", 0.00025), ("0.39", 0.098), ("0.4", 0.1)])
def test_both_zones_take_half_of_the_shortest_range(upper: str, zone: float, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(replaced(('lower="0" upper="0.04"', f'lower="0" upper="{upper}"')))
    assert limit_zone(tmp_path / "arm.urdf") == zone
    assert limit_zone(URDF) == 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_a_finger_is_held(tmp_path: Path) -> None:
    """A range of 40 mm: the default configuration was refused, since two zones of 0.1 m did not fit in it."""
    (tmp_path / "arm.urdf").write_text(replaced())
    chosen = {"kernels": "limits", "batches": False}
    module = stiffgen.open_robot(stiffgen.generate(tmp_path / "arm.urdf", output=tmp_path, **chosen)).module
    arm, q = module.Impedance(), [0.3, 0.4, 0.02]
    for _ in range(50):
        out = arm.step(
            q=q, dq=[0, 0, 0], q0=q, translation_stiffness=300 * np.eye(3), rotation_stiffness=20 * np.eye(3)
        )
    assert out.fault == 0 and abs(out.torque).max() < 1e-9
