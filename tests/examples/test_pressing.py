# SPDX-License-Identifier: MIT
"""The bowl wiped at 15 N in MuJoCo: with Press and by the springs alone."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from examples.bowl_wiping import pressing


def rms(found: pressing.Pressed) -> float:
    return float(np.sqrt(np.mean(found.error**2)))


@pytest.mark.slow
def test_the_sensor_finds_a_bowl_that_stands_too_low(plate: ModuleType) -> None:
    """Sweep 2 s over a bowl 5 mm too low: the sensor holds the force, springs alone are off by 800 N/m x 5 mm."""
    alone, pressed = (pressing.wipe(plate, press=press, end=5.0) for press in (False, True))
    assert alone.fault == pressed.fault == 0
    print(pressing.said("springs alone", alone), pressing.said("Press", pressed), sep="\n")
    assert rms(pressed) < 2.0 and abs(pressed.error.mean()) < 0.2 and (pressed.error > -pressing.FORCE).mean() > 0.99
    assert rms(alone) > 5.0
    assert "springs alone" in pressing.draw({"springs alone": alone, "Press": pressed})


def test_the_axis_is_the_bowls_normal_and_the_plate_lies_across_it() -> None:
    """Check poses of the plate: a rotation, its z axis the bowl's normal, its edge on the bowl within 1 mm."""
    for time in (0.0, 2.5, 4.0, 6.0):
        pose, axis = pressing.plate_pose(time, 0.0)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) > 0
        np.testing.assert_allclose(pose[:3, 2], axis, atol=1e-12)
        centre = np.array([*pressing.BELIEVED.centre, pressing.BELIEVED.bottom + pressing.BELIEVED.radius])
        edge = pose[:3, 3] + pressing.EDGE_RADIUS * axis + pressing.PLATE_RADIUS * pose[:3, 0]
        assert np.linalg.norm(edge - centre) == pytest.approx(pressing.BELIEVED.radius, abs=1e-3)
