# SPDX-License-Identifier: MIT
"""A folder with a force-torque sensor: header, docstrings, NumPy functions, manifest, and no trace without one."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from support.chains import chain_urdf

OPTIONS = (
    "--sensor",
    "l2",
    "--sensor-xyz",
    "0",
    "0",
    "0.05",
    "--sensor-rpy",
    "0",
    "0",
    "0.4",
    "--sensor-sign",
    "robot",
)


@pytest.fixture(scope="module")
def robot(once):
    def make(output):
        (output / "arm.urdf").write_text(chain_urdf("rp"))
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", "-O0")
            arguments = [
                "generate",
                output / "arm.urdf",
                "--name",
                "felt",
                "--output",
                output,
                "--no-controller",
                *OPTIONS,
            ]
            assert main([str(each) for each in arguments]) == 0

    return stiffgen.open_robot(once("folder_with_sensor", make) / "felt")


def test_sign_and_place_are_in_header_and_docstring(robot):
    header = " ".join((robot.folder / "felt.h").read_text().replace("\n * ", " ").split())
    for text in (header, " ".join(inspect.getdoc(robot.module.sensor.tip_wrench).split())):
        assert "on link l2, 0.05 m from the tip's origin" in text
        assert "reports the wrench that the robot applies to the tool (--sensor-sign robot)" in text
        assert "(0, 0, -9.81) m/s^2 in base axes" in text


def test_functions_of_stacks(robot):
    """A weight hung at the tip, by hand: the reading of a stack of postures, and the wrench back from it."""
    sensor, random = robot.module.sensor, np.random.default_rng(0)
    q, bias = random.uniform(-0.5, 0.5, (4, 2)), random.normal(size=6)
    payload, wrench = np.array([1.3, 0.1, 0.0, 0.2]), np.array([0.0, 0.0, -9.81 * 2.0, 0.0, 0.0, 0.0])
    reading = sensor.reading(q, wrench, bias, payload)
    assert reading.shape == (4, 6)
    np.testing.assert_allclose(np.linalg.norm((reading - bias)[:, :3], axis=1), 9.81 * 3.3, rtol=1e-12)
    found = sensor.tip_wrench(q, reading, bias, payload)
    np.testing.assert_allclose(found, np.broadcast_to(wrench, (4, 6)), rtol=0, atol=1e-12)
    moving = np.concatenate([payload, [0.02, 0.0, 0.0, 0.02, 0.0, 0.01]])
    at_rest = sensor.tip_wrench_dynamic(q, 0 * q, 0 * q, reading, bias, moving)
    np.testing.assert_allclose(at_rest, found, rtol=0, atol=1e-12)
    K = np.diag([700.0, 700, 800, 30, 30, 30])
    np.testing.assert_allclose(
        sensor.joint_stiffness(q, reading, bias, payload, K), robot.module.hybrid.joint_stiffness(q, found, K),
        rtol=0, atol=1e-10,
    )  # fmt: skip


def test_manifest_and_replacement(robot, tmp_path, capsys):
    file = robot.folder.parent / "arm.urdf"
    sensor = stiffgen.Sensor("l2", (0.0, 0.0, 0.05), (0.0, 0.0, 0.4), "robot")
    assert robot.chain == stiffgen.load_chain(file, sensor=sensor)
    options = ["generate", file, "--name", "felt", "--output", tmp_path, "--no-controller", "--no-build"]
    plain = [str(each) for each in options]
    assert main([*plain, *OPTIONS]) == 0
    assert main(plain) == 2  # programs that call felt_sensor_tip_wrench would no longer link
    assert "sensor l2 robot" in capsys.readouterr().err
    assert main([*plain, "--force"]) == 0
    for made in tmp_path.rglob("felt*"):
        assert not made.is_file() or "sensor_tip_wrench" not in made.read_text(encoding="utf-8", errors="replace")


def test_covariance_at_the_tip(robot):
    """Covariances of 20000 drawn readings."""
    random, q = np.random.default_rng(0), np.array([0.3, -0.2])
    root = np.diag([0.5, 0.5, 1.0, 0.02, 0.02, 0.03]) @ (np.eye(6) + 0.3 * random.normal(size=(6, 6)))
    readings = random.normal(size=(20000, 6)) @ root.T
    drawn = np.cov(robot.module.sensor.tip_wrench(q, readings, np.ones(6), np.ones(4)).T)
    found = stiffgen.tip_covariance(robot.module, np.stack([0 * q, q]), root @ root.T)[1]
    scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(drawn / np.outer(scale, scale), found / np.outer(scale, scale), atol=0.04)
