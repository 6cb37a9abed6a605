# SPDX-License-Identifier: MIT
"""A folder with a force-torque sensor: header, docstrings, NumPy functions, manifest, and no trace without one."""

from __future__ import annotations

import inspect
import subprocess

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.verify.folder.files import check_urdf
from stiffgen.lab.calibrate.calibration import Calibration
from support.c_program import STRICT
from support.chains import chain_urdf

OPTIONS = tuple(word for value in ("l2", "xyz=0,0,0.05", "rpy=0,0,0.4", "sign=robot") for word in ("--sensor", value))


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
        assert "reports the wrench that the robot applies to the tool (--sensor sign=robot)" in text
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
    assert check_urdf(robot.chain, file).passed
    options = ["generate", file, "--name", "felt", "--output", tmp_path, "--no-controller", "--no-build"]
    plain = [str(each) for each in options]
    assert main([*plain, *OPTIONS]) == 0
    assert main(plain) == 2  # programs that call felt_sensor_tip_wrench would no longer link
    assert "sensor l2 robot" in capsys.readouterr().err
    stiffgen.generate(file, name="felt", output=tmp_path, controller=False, build=False, force=True)
    for made in tmp_path.rglob("felt*"):
        assert not made.is_file() or "sensor_tip_wrench" not in made.read_text(encoding="utf-8", errors="replace")


@pytest.mark.usefixtures("unoptimised")
def test_a_links_name_ends_no_comment(tmp_path):
    """Names of a file are any text; header, module and docstring hold this one as a word."""
    (tmp_path / "arm.urdf").write_text(chain_urdf("rp").replace('"l2"', '"l2*/ int x; {{x}} \\ &quot;"'))
    link = stiffgen.load_chain(tmp_path / "arm.urdf").tip
    options = {"kernels": "sensor", "controller": False, "batches": False, "masses": False}
    folder = stiffgen.generate(tmp_path / "arm.urdf", output=tmp_path, sensor=stiffgen.Sensor(link), **options)
    assert "on link l2_/ int x; {{x}} _ _, " in " ".join((folder / "chain.h").read_text().replace("\n * ", " ").split())
    assert "on link l2_/ int x;" in stiffgen.open_robot(folder).module.sensor.tip_wrench.__doc__


def test_covariance_at_the_tip(robot):
    """Covariances of 20000 drawn readings."""
    random, q = np.random.default_rng(0), np.array([0.3, -0.2])
    root = np.diag([0.5, 0.5, 1.0, 0.02, 0.02, 0.03]) @ (np.eye(6) + 0.3 * random.normal(size=(6, 6)))
    readings = random.normal(size=(20000, 6)) @ root.T
    drawn = np.cov(robot.module.sensor.tip_wrench(q, readings, np.ones(6), np.ones(4)).T)
    found = stiffgen.tip_covariance(robot.module, np.stack([0 * q, q]), root @ root.T)[1]
    scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(drawn / np.outer(scale, scale), found / np.outer(scale, scale), atol=0.04)


PROGRAM = r"""
#include "felt_sensor.h"
#include <stdio.h>
int main(int argc, char **argv)
{
    felt_filter filters[3];
    double x[6], bias[6], payload[4];
    if (!felt_low_pass_1(&filters[0], 10.0, 0.001) || !felt_low_pass_2(&filters[1], 10.0, 0.001) ||
        !felt_notch(&filters[2], 50.0, 5.0, 0.001) || felt_low_pass_1(filters, 500.0, 0.001) ||
        felt_low_pass_2(filters, 0.0, 0.001) || felt_notch(filters, 50.0, 0.0, 0.001)) {
        return 1;
    }
    for (int f = 0; f < 3; ++f) {
        felt_filter filter = filters[f];
        for (int k = 0; k < 3000; ++k) { /* ramp, then sines of 10 and of 50 Hz, and a constant */
            x[0] = k;
            x[1] = sin(6.283185307179586 * 10.0 * 0.001 * k);
            x[2] = sin(6.283185307179586 * 50.0 * 0.001 * k);
            x[3] = x[4] = x[5] = 7.0;
            felt_filter_step(&filter, x);
            printf("%.17g %.17g %.17g %.17g\n", x[0], x[1], x[2], x[3]);
        }
        printf("%.17g 0 0 0\n", filter.delay);
    }
    x[0] = NAN;
    felt_filter_step(&filters[0], x);
    if (!isnan(x[0]) || !isnan(x[5])) {
        return 2;
    }
    x[0] = x[1] = x[2] = x[3] = x[4] = x[5] = 1.0;
    felt_filter_step(&filters[0], x);
    if (argc != 2 || fabs(x[0] - 1.0) > 1e-12 || !felt_read_calibration(argv[1], bias, payload)) {
        return 3;
    }
    printf("%.17g %.17g %.17g %.17g\n", bias[0], bias[5], payload[0], payload[3]);
    return felt_read_calibration("{\"bias\": [1, 2], \"payload\": [1, 2, 3, 4]}", bias, payload) ||
                   felt_read_calibration("{\"bias\": [1, 2, 3, 4, 5, 6]}", bias, payload)
               ? 4
               : 0;
}
"""


@pytest.mark.parametrize("compiler", ["gcc", "g++"])
def test_filters_and_reader_in_c(robot, tmp_path, compiler):
    """Delays of a ramp, gains of sines, a constant from the first sample on, a NaN, and the file read in C."""
    suffix = {"gcc": ".c", "g++": ".cpp"}[compiler]
    source, program = tmp_path / f"filters{suffix}", tmp_path / "filters"
    source.write_text(PROGRAM)
    flags = [flag for flag in STRICT if not flag.startswith("-std")]
    standard = {"gcc": "-std=c99", "g++": "-std=c++11"}[compiler]
    command = [compiler, standard, *flags, f"-I{robot.folder}", str(source), "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    bias, payload = tuple(np.linspace(-1, 2, 6)), (1.3, 0.01, -2e-5, 0.117)
    text = Calibration("felt", "l2", bias, payload, bias, payload, bias, bias, (0.0,) * 3, (0.1,) * 3, 9).to_json()
    done = subprocess.run([str(program), text], check=True, capture_output=True, text=True)
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    for f, gains in enumerate([(np.sqrt(0.5), None), (np.sqrt(0.5), None), (None, 0.0)]):
        outputs, delay = rows[3001 * f : 3001 * f + 3000], rows[3001 * f + 3000, 0]
        np.testing.assert_allclose(2999 - outputs[-1, 0], delay, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(outputs[:, 3], 7.0, rtol=1e-12)
        for column, gain in zip((1, 2), gains, strict=True):
            if gain is not None:
                amplitude = np.sqrt(2 * np.mean(outputs[2000:, column] ** 2))
                assert amplitude == pytest.approx(gain, abs=0.02 if f == 0 else 1e-6)
    np.testing.assert_array_equal(rows[-1], [bias[0], bias[5], payload[0], payload[3]])


LOW_PASS = r"""
#include "felt_sensor.h"
#include <stdio.h>
int main(void)
{
    const double corners[3] = {20.0, 100.0, 250.0};
    for (int c = 0; c < 3; ++c) {
        felt_filter step, wave;
        if (!felt_low_pass_1(&step, corners[c], 0.001) || !felt_low_pass_1(&wave, corners[c], 0.001)) {
            return 1;
        }
        for (int k = 0; k < 4000; ++k) {
            double x[6] = {k > 0, 0.0, 0.0, 0.0, 0.0, 0.0}, y[6] = {0.0};
            y[0] = sin(6.283185307179586 * corners[c] * 0.001 * k + 0.4);
            felt_filter_step(&step, x);
            felt_filter_step(&wave, y);
            printf("%.17g %.17g\n", x[0], y[0]);
        }
    }
    return 0;
}
"""


def test_the_first_order_low_pass_does_what_its_comment_says(robot, tmp_path):
    """A step counts from the sample before on: the continuous filter of a held input is one sample later.

    Before: "exact for an input that is held between samples", which the filter is not.
    """
    source, program = tmp_path / "low_pass.c", tmp_path / "low_pass"
    source.write_text(LOW_PASS)
    command = ["gcc", *STRICT, f"-I{robot.folder}", str(source), "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    text = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    found = np.array([line.split() for line in text.splitlines()], dtype=float).reshape(3, 4000, 2)
    for corner, gain, (step, wave) in zip((20, 100, 250), (np.sqrt(0.5), 0.719, 0.776), found.mT, strict=True):
        # the step begins after sample 0, and reading k is filtered as if k sample times had passed
        np.testing.assert_allclose(step, 1 - np.exp(-2 * np.pi * corner * 0.001 * np.arange(4000)), atol=1e-14)
        assert np.sqrt(2 * np.mean(wave[2000:] ** 2)) == pytest.approx(gain, rel=1e-3)
    assert "held between samples" not in (robot.folder / "felt_sensor.h").read_text()
