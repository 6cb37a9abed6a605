# SPDX-License-Identifier: MIT
"""A force-torque sensor on the arm: the package around a robot that was generated with --sensor."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import stiffgen
from support.calibrations import calibration_text

from .building import PACKAGE, ROS2, compile_robot, compile_scenarios

BIAS, PAYLOAD = (1.0, -2.0, 3.0, 0.1, 0.2, -0.3), (1.5, 0.01, -0.02, 0.06)
"""As sensor.cpp has them."""
OTHERS = ("names_what_is_wrong_with_a_sensor", "holds_without_an_allocation")
SCENARIOS = (
    "refuses_the_calibration_of_another_sensor",
    "measures_the_wrench_at_the_tip",
    "goes_on_without_a_reading",
    "presses_on_a_floor_and_stops_where_it_ends",
    "refuses_a_bad_press",
)


@pytest.mark.slow
def test_scenarios_of_a_sensor(tmp_path: Path) -> None:
    """Turn the sensor and move it 0.1 m from the tip: push, bias and the tool's weight are told apart."""
    sensor = stiffgen.Sensor("link_7", xyz=(0.0, 0.02, -0.1), rpy=(0.3, 0.2, 0.1), sign="robot")
    urdf = ROS2.parent / "urdf" / "iiwa14.urdf"
    robot = stiffgen.generate(urdf, name="felt", output=tmp_path / "generated", build=False, sensor=sensor)
    text = calibration_text(robot, BIAS, PAYLOAD)
    (tmp_path / "calibration.json").write_text(text)
    (tmp_path / "other.json").write_text(text.replace("link_7", "link_6"))
    objects = tmp_path / "objects"
    objects.mkdir()
    compile_robot(objects, robot)
    compile_scenarios(tmp_path, PACKAGE, robot, objects, "rolling")
    for name in (*OTHERS, *SCENARIOS):
        done = subprocess.run([tmp_path / "scenarios", name], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.stdout, done.returncode) == ("", 0), name
