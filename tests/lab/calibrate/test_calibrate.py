# SPDX-License-Identifier: MIT
"""``stiffgen calibrate``: a simulated ATI Gamma within its intervals, refusals, the check with a weight, the file."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import RecordingError
from stiffgen.lab.analyze.measures import MEASURES, measured
from stiffgen.lab.analyze.task import SensorTask, Task
from stiffgen.lab.calibrate.estimate import estimate
from support.project import URDF
from support.sensor_recordings import PAYLOAD, SimulatedSensor, held

BASE = np.array([0.3, 0.6, -0.2, -1.3, 0.4, 0.9, 0.1])
TRUE = {"xyz": (0.0, 0.0, 0.03), "rpy": (0.0, 0.0, 0.5)}
FAULTS = {
    "sign": {"sign": "robot"},
    "axes": {"rpy": (0.0, 0.0, 0.5 + np.pi / 2)},
    "upside down": {"rpy": (np.pi, 0.0, 0.5)},
    "place": {"xyz": (0.0, 0.0, -0.05)},
}
"""Four faults of sign and frame: what a user declares instead of TRUE."""


def postures(random, count: int = 12) -> np.ndarray:
    q = np.tile(BASE, (count, 1))
    q[:, 4:] = random.uniform(-1.5, 1.5, (count, 3))
    return q


@pytest.fixture(scope="module")
def robots(once):
    """Return the iiwa 14 with the true sensor, and with the four faults."""

    def make(output):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", "-O0")
            for name, fault in {"truth": {}, **FAULTS}.items():
                sensor = stiffgen.Sensor("link_ee", **TRUE | fault)
                options = {"kernels": "sensor,hybrid", "batches": False, "controller": False, "masses": False}
                stiffgen.generate(URDF, name=name.replace(" ", "_"), output=output, sensor=sensor, **options)

    folder = once("robots_with_sensor", make)
    return {name: folder / name.replace(" ", "_") for name in ("truth", *FAULTS)}


@pytest.fixture(scope="module")
def sensor(robots):
    return stiffgen.open_robot(robots["truth"]).module.sensor


@pytest.mark.slow
def test_within_its_intervals(sensor):
    """Calibrate 100 noisy recordings: all ten numbers within their intervals at once in 95."""
    within, widths = 0, []
    for seed in range(100):
        random = np.random.default_rng(seed)
        simulated = SimulatedSensor(sensor, random)
        found = estimate(sensor, simulated.poses(postures(random))).calibration
        inside = np.abs(np.array(found.payload) - PAYLOAD) <= found.payload_interval
        inside = [*inside, *(np.abs(np.array(found.bias) - simulated.end) <= found.bias_interval)]
        within += all(inside)
        widths.append(found.payload_interval)
    assert within >= 95
    assert np.median(widths, axis=0).max() < 5e-4  # kg, kg m: narrow enough to be of use


UNEXCITED = {
    "one posture": lambda random: np.tile(BASE, (12, 1)),
    "turned about the vertical": lambda random: BASE + np.outer(np.linspace(-1, 1, 12), np.eye(7)[0]),
    "two orientations": lambda random: np.tile(BASE, (12, 1)) + np.outer(np.arange(12) % 2, 0.8 * np.eye(7)[5]),
    "five degrees": lambda random: BASE + random.uniform(-0.09, 0.09, (12, 7)) * [0, 0, 0, 0, 1, 1, 1],
}


@pytest.mark.slow
@pytest.mark.parametrize("case", UNEXCITED)
def test_unexcited_recordings_are_refused(sensor, case):
    """Move too little to tell payload and bias apart: refused, for 25 seeds."""
    for seed in range(25):
        random = np.random.default_rng(seed)
        poses = SimulatedSensor(sensor, random).poses(UNEXCITED[case](random))
        with pytest.raises(RecordingError, match="do not excite the payload"):
            estimate(sensor, poses)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("sign", r"reports the wrench of the other body.*--sensor sign"),
        ("axes", r"rotation vector \(0\.\d, -?0\.\d, -90\.\d\) deg.*--sensor rpy"),
        ("upside down", r"rotation vector \(-?1\d\d\.\d, .*--sensor rpy"),
    ],
)
def test_faults_are_found_without_a_weight(robots, sensor, fault, message):
    """Calibrate with a folder whose sign or axes are wrong: found without a weight."""
    random = np.random.default_rng(0)
    wrong = stiffgen.open_robot(robots[fault]).module.sensor
    with pytest.raises(RecordingError, match=message):
        estimate(wrong, SimulatedSensor(sensor, random).poses(postures(random)))


def write_log(path, sensor, random, extra=0.0, simulated=None):
    """Write a recording of the true sensor; ``extra`` [kg] hangs 40 mm before the tip's origin."""
    simulated = simulated or SimulatedSensor(sensor, random)
    q, time = held(postures(random, 10))
    weight = np.array([0, 0, -9.81 * extra, 0, 0, 0])
    reading = simulated.record(q, time) + sensor.reading(q, weight, np.zeros(6), np.zeros(4))
    names = ["time", *(f"q_{k}" for k in range(7)), *(f"wrench_{k}" for k in range(6))]
    np.savetxt(path, np.column_stack([time, q, reading]), delimiter=",", header=",".join(names), comments="")
    return simulated


@pytest.fixture(scope="module")
def logs(tmp_path_factory, sensor):
    """Return a folder with recordings of a free sensor and of one with a weight of 2 kg, with the same bias."""
    folder, random = tmp_path_factory.mktemp("logs"), np.random.default_rng(5)
    simulated = write_log(folder / "free.csv", sensor, random)
    simulated.drift = 0 * simulated.drift
    simulated.bias = simulated.moved[-1]
    write_log(folder / "weight.csv", sensor, random, 2.0, simulated)
    return folder


@pytest.mark.slow
def test_from_recording_to_file(robots, logs, tmp_path, capsys):
    """Run the whole command: poses found, table printed, file and picture written, and read again."""
    file, picture = tmp_path / "sensor.json", tmp_path / "residuals.svg"
    arguments = ["calibrate", logs / "free.csv", "--robot", robots["truth"], "--output", file, "--output", picture]
    assert main([str(each) for each in arguments]) == 0
    out = capsys.readouterr().out
    assert "residuals of 10 poses" in out and out.count("one more pose at q") == 3
    found = stiffgen.read_calibration(file)
    assert np.abs(np.array(found.payload) - PAYLOAD).max() < 0.01
    np.testing.assert_allclose(found.centre_of_mass, PAYLOAD[1:] / PAYLOAD[0], atol=0.002)
    assert json.loads(file.read_text())["payload"] == list(found.payload)
    assert picture.read_text().startswith("<svg")
    module, q = stiffgen.open_robot(robots["truth"]).module, np.stack([BASE, BASE + 0.2])
    reading = module.sensor.reading(q, np.zeros(6), np.array(found.bias) + 1.5, PAYLOAD)
    np.testing.assert_allclose(
        stiffgen.tare(module.sensor, q, reading, PAYLOAD), np.array(found.bias) + 1.5, atol=1e-12
    )


@pytest.mark.slow
def test_a_picture_that_cannot_be_drawn_leaves_no_file(robots, logs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    file, picture = tmp_path / "sensor.json", tmp_path / "residuals.svg"
    arguments = ["calibrate", logs / "free.csv", "--robot", robots["truth"], "--output", file, "--output", picture]
    assert main([str(each) for each in arguments]) == 2
    assert not file.exists() and not picture.exists()


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["truth", *FAULTS])
def test_a_weight_at_the_tip_shows_each_fault(robots, logs, tmp_path, capsys, fault):
    """Hang 2 kg at the tip, as a user can: each fault of the sensor shows."""
    file = tmp_path / "sensor.json"
    calibrate = ["calibrate", logs / "free.csv", "--robot", robots["truth"], "--output", file]
    assert main([str(each) for each in calibrate]) == 0
    place = stiffgen.open_robot(robots[fault]).chain.sensor.text
    file.write_text(json.dumps(json.loads(file.read_text()) | {"sensor": place}))
    if fault == "sign":  # what somebody with this fault has calibrated
        content = json.loads(file.read_text())
        file.write_text(json.dumps(content | {"payload": [-each for each in content["payload"]]}))
    capsys.readouterr()
    check = ["calibrate", logs / "weight.csv", "--robot", robots[fault], "--output", file, "--check", "2.0"]
    code, out = main([str(each) for each in check]), capsys.readouterr().out
    hints = {"truth": "passed", "sign": "--sensor sign", "place": "the moment alone is wrong: look at --sensor xyz"}
    assert hints.get(fault, "look at") in out
    assert code == int(fault != "truth")


@pytest.mark.slow
def test_a_weight_elsewhere(robots, logs, tmp_path, capsys):
    """Declare the weight 40 mm beside where it hangs: the moment is named."""
    file, log = tmp_path / "sensor.json", str(logs / "weight.csv")
    common = ["--robot", str(robots["truth"]), "--output", str(file)]
    assert main(["calibrate", str(logs / "free.csv"), *common]) == 0
    assert main(["calibrate", log, *common, "--check", "2,0.04,0,0"]) == 1
    assert "the moment alone is wrong" in capsys.readouterr().out
    named = ["--q", ",".join(f"q_{k}" for k in range(7)), "--reading", ",".join(f"wrench_{k}" for k in range(6))]
    assert main(["calibrate", log, *common, *named, "--check", "2.5"]) == 1
    assert "the force has the wrong size" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no calibration by 'stiffgen calibrate'"),
        ("[]", "is no calibration"),
        ('{"generator": "stiffgen calibrate", "bias": [1, 2]}', "is no calibration"),
        ('{"generator": "stiffgen calibrate", "bias": [NaN, 0, 0, 0, 0, 0]}', "is no calibration"),
    ],
)
def test_damaged_files_are_refused(tmp_path, text, message):
    """Read damaged calibrations: refused, instead of a wrong wrench."""
    file = tmp_path / "sensor.json"
    file.write_text(text)
    with pytest.raises(RecordingError, match=message):
        stiffgen.read_calibration(file)
    with pytest.raises(RecordingError, match="cannot be read"):
        stiffgen.read_calibration(tmp_path / "nothing.json")


@pytest.mark.slow
def test_refusals_of_the_command(robots, logs, tmp_path, capsys, robot_folder):
    """Calibrate without a sensor, without poses at rest, or another sensor: refused, nothing written."""
    log, file = str(logs / "free.csv"), tmp_path / "sensor.json"
    assert main(["calibrate", log, "--robot", str(robot_folder), "--output", str(file)]) == 2
    assert "has no force-torque sensor; generate it with --sensor LINK" in capsys.readouterr().err
    moving = tmp_path / "moving.csv"
    rows = np.random.default_rng(0).normal(size=(400, 13))
    names = ",".join([*(f"q_{k}" for k in range(7)), *(f"wrench_{k}" for k in range(6))])
    np.savetxt(moving, rows, delimiter=",", header=names, comments="")
    common = ["--robot", str(robots["truth"]), "--output", str(file)]
    assert main(["calibrate", log, *common, "--output", str(tmp_path / "other.json")]) == 2
    assert "has the same content; give one of the two" in capsys.readouterr().err
    for weight in ("2,0,0", "two"):
        with pytest.raises(SystemExit):
            main(["calibrate", log, *common, "--check", weight])
        assert f"'{weight}' is not KG or KG,X,Y,Z" in capsys.readouterr().err
    assert main(["calibrate", str(moving), *common]) == 2
    assert "stands still at 0 poses" in capsys.readouterr().err
    assert not file.exists()
    assert main(["calibrate", log, *common]) == 0
    wrong = ["--robot", str(robots["place"]), "--output", str(file), "--check", "2"]
    assert main(["calibrate", log, *wrong]) == 2
    assert "is the calibration of another sensor" in capsys.readouterr().err


@pytest.mark.slow
def test_readings_are_analysed(robots, logs, tmp_path, capsys):
    """Analyse readings by ``analyze --calibration``: the weight of two kilograms, and no moment at the tip."""
    file, log = tmp_path / "sensor.json", logs / "weight.csv"
    common = ["--robot", str(robots["truth"])]
    assert main(["calibrate", str(logs / "free.csv"), *common, "--output", str(file)]) == 0
    options = {"task_stiffness": [700, 700, 800, 30, 30, 30], "output": tmp_path / "found", "figures": False}
    found = stiffgen.analyze(log, robots["truth"], calibration=file, **options | {"figures": True}).summary["measures"]
    picture = (tmp_path / "found" / "stiffness.svg").read_text()
    assert all(
        word in picture for word in (">antisymmetric part [N m/rad]<", ">within two standard deviations of the sensor<")
    )
    assert "+- " in (tmp_path / "found" / "report.html").read_text()
    assert found["force"]["median"] == pytest.approx(2 * 9.81, rel=0.02)
    assert found["moment"]["median"] < 0.05
    assert found["antisymmetric_deviation"]["count"] == found["moment"]["count"]
    assert 0.0 < found["antisymmetric_deviation"]["most"] < 0.1
    raw = stiffgen.analyze(log, robots["truth"], **options).summary["measures"]
    assert raw["antisymmetric_deviation"]["count"] == 0
    assert raw["force"]["median"] != pytest.approx(2 * 9.81, rel=0.1)
    for wrong, message in (
        ({"negate_wrench": True}, "leave out negate_wrench=True"),
        ({"representation": "body"}, "hybrid wrenches"),
        ({"robot": robots["sign"]}, "is the calibration of another sensor"),
    ):
        arguments = {"robot": robots["truth"], **options, **wrong}
        with pytest.raises(RecordingError, match=message):
            stiffgen.analyze(log, calibration=file, **arguments)


@pytest.mark.slow
def test_deviations_of_an_analysis_are_those_of_drawn_readings(robots):
    """Analyse 2000 noisy readings each by itself: their spread is the stated deviation."""
    robot = stiffgen.open_robot(robots["truth"]).module
    # [rad]; [N, N m]
    q, reading = np.array([0.3, -0.8, 0.4, 1.1, 0.2, -0.6, 0.1]), np.array([6.0, -9.0, 12.0, 1.2, -1.5, 0.4])
    noise = np.array([0.2, 0.1, 0.3, 0.02, 0.03, 0.01])  # standard deviations [N, N m]
    K = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
    sensor = SensorTask(np.zeros(6), np.array([1.3, 0.0, 0.01, 0.05]), noise)
    task = Task("hybrid", K, False, np.full(7, -np.inf), np.full(7, np.inf), "", sensor)

    def measures(readings):
        postures = np.tile(q, (len(readings), 1))
        found = measured(robot, task, postures, task.wrench_of(robot, postures, readings))
        return dict(zip(MEASURES, found.T, strict=True))

    drawn = measures(reading + noise * np.random.default_rng(1).normal(size=(2000, 6)))
    told = measures(np.tile(reading, (2, 1)))
    for value, deviation in (
        ("singular_value_antisymmetric", "antisymmetric_deviation"),
        ("eigenvalue_smallest", "eigenvalue_smallest_deviation"),
    ):
        # The deviation of 2000 draws is itself known to 1 / sqrt(2 * 2000), 1.6 %.
        assert told[deviation][0] == pytest.approx(drawn[value].std(), rel=0.06)


WRONG = {
    "sign": (-np.eye(3), -np.eye(3), "the force points up: look at the FRI client's --external-torque-sign"),
    "direction": (np.eye(3)[[2, 0, 1]], np.eye(3), "look at the joints' order and the signs of single joints"),
    "size": (1.2 * np.eye(3), 1.2 * np.eye(3), "look at the robot's load data and the external torque's offset"),
    "moment": (np.eye(3), 2.0 * np.eye(3), "look at the tip's link, --tool xyz, and the point of the weight"),
}
"""Matrices on force and moment, and the remedy where no sensor made the wrench."""


@pytest.mark.slow
@pytest.mark.parametrize("fault", WRONG)
def test_no_sensor_is_blamed_on_an_arm_without_one(tmp_path, capsys, robot_folder, robots, fault):
    """Fail a check on an arm without and with a sensor: only the latter's remedy names it."""
    q, time = held(postures(np.random.default_rng(3), 3))
    pose = stiffgen.open_robot(robot_folder).module.forward_kinematics(q)
    force = np.tile([0, 0, -9.81 * 2.0], (len(q), 1))
    moment = np.cross(pose[:, :3, :3] @ [0.1, 0, 0], force)
    of_force, of_moment, remedy = WRONG[fault]
    rows = np.column_stack([time, q, force @ of_force, moment @ of_moment])
    names = ["time", *(f"q_{k}" for k in range(7)), *(f"F_{k}" for k in range(6))]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(names), comments="")

    def said(folder, *more):
        arguments = ["calibrate", tmp_path / "log.csv", "--robot", folder, "--check", "2,0.1,0,0", *more]
        assert main([str(each) for each in arguments]) in (1, 2)
        return "".join(capsys.readouterr())

    alone = said(robot_folder, "--reading", "tip:F_")
    assert remedy in alone and "sensor" not in alone
    both = said(robots["truth"], "--reading", "tip:F_")
    assert "sensor" in both and "external torque" in both
    assert "--reading tip:wrench_" in said(robot_folder)


def test_wrenches_of_another_program_are_checked(tmp_path, capsys, robot_folder):
    """Wrenches by hand, weight beside the tip, of a robot without a sensor; then turned about the vertical."""
    q, time = held(postures(np.random.default_rng(3), 3))
    pose = stiffgen.open_robot(robot_folder).module.forward_kinematics(q)
    force = np.tile([0, 0, -9.81 * 2.0], (len(q), 1))
    moment = np.cross(pose[:, :3, :3] @ [0.1, 0, 0], force)
    names = ["time", *(f"q_{k}" for k in range(7)), *(f"F_{k}" for k in range(6))]
    for file, wrench in (("right", [force, moment]), ("turned", [force, moment[:, [1, 0, 2]] * [-1, 1, 1]])):
        rows = np.column_stack([time, q, *wrench])
        np.savetxt(tmp_path / file, rows, delimiter=",", header=",".join(names), comments="")
        (tmp_path / file).rename(tmp_path / f"{file}.csv")

    def check(file, *more):
        arguments = ["calibrate", tmp_path / f"{file}.csv", "--robot", robot_folder, "--reading", "tip:F_", *more]
        return main([str(each) for each in arguments]), capsys.readouterr()

    code, said = check("right", "--check", "2,0.1,0,0")
    assert code == 0 and "within 0.0 % of the weight" in said.out
    assert check("right", "--check", "2")[0] == 1
    code, said = check("turned", "--check", "2,0.1,0,0")
    assert code == 1 and "the moment alone is wrong" in said.out
    for more in ((), ("--check", "2", "--output", tmp_path / "c.json")):
        code, said = check("right", *more)
        assert code == 2 and "--reading tip:...: goes with --check, without --output" in said.err
