# SPDX-License-Identifier: MIT
"""Measured stiffness and the sensor's errors: simulated springs of known stiffness, MuJoCo, real recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import RecordingError, StiffgenError
from stiffgen.lab.calibrate.calibration import Calibration, read_calibration
from stiffgen.lab.measure.fit import fit_stiffness
from stiffgen.lab.measure.measurement import joint_stiffness_deviation, measure_stiffness
from stiffgen.lab.measure.motion import motion
from stiffgen.lab.measure.plan import PlanOptions, plan_excitation
from stiffgen.lab.measure.refusals import refusals
from stiffgen.lab.measure.residual import analyse_residual
from stiffgen.lab.measure.rows import recorded_poses, sensor_poses
from support.project import ROOT, URDF
from support.springs_about_pose import ISOTROPIC, SOFT, STIFF, Fault, Spring, recorded, rotations, wrench

RECORDINGS = ROOT.parent / "shared" / "data" / "recordings"
POSTURE = np.array([0.3, 0.6, -0.2, -1.2, 0.4, 1.0, 0.2])
DEGREE = float(np.radians(1.0))


def unit(seed: int) -> np.ndarray:
    v = np.random.default_rng(seed + 1000).normal(size=3)
    return v / np.linalg.norm(v)


def rates(spring: Spring, runs: int) -> tuple[int, int, int]:
    """Return the false alarms, and the turns of 1 degree and levers of 2 mm that are found, of so many runs each."""
    alarms = turns = levers = 0
    for seed in range(runs):
        v = unit(seed)
        alarms += measure_stiffness(*recorded(seed, spring), has_bias=False).residual.is_alarm
        found = measure_stiffness(*recorded(seed, spring, Fault(turn=tuple(DEGREE * v))), has_bias=False)
        turn, _ = found.residual.errors
        near = np.linalg.norm(turn.value - DEGREE * v) < 0.03 * DEGREE
        turns += bool(found.residual.is_alarm and turn.verdict == "found" and near)
        found = measure_stiffness(*recorded(seed, spring, Fault(lever=tuple(2e-3 * v))), has_bias=False)
        _, lever = found.residual.errors
        near = np.linalg.norm(lever.value - 2e-3 * v) < 1e-3
        levers += bool(found.residual.is_alarm and lever.verdict == "found" and near)
    return alarms, turns, levers


def test_turns_and_levers_are_found() -> None:
    alarms, turns, levers = rates(SOFT, 8)
    assert (turns, levers) == (8, 8)
    assert alarms <= 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "spring", [pytest.param(SOFT, id="soft"), pytest.param(STIFF, id="stiff", marks=pytest.mark.wide)]
)
def test_rates_of_a_hundred(spring: Spring) -> None:
    """Measure 100 recordings: all turns and 95 levers are found, and false alarms are near the stated 5 %."""
    alarms, turns, levers = rates(spring, 100)
    assert (turns, levers >= 95) == (100, True)
    assert 2 <= alarms <= 8


def test_stiffness_and_load_are_within_their_intervals() -> None:
    """Compare stiffness and load with differences of the noiseless model: within their intervals."""
    inside = 0
    for seed in range(10):
        found = measure_stiffness(*recorded(seed), has_bias=False)
        h, steps = 1e-4, np.eye(6)
        random = np.random.default_rng(seed)
        Q, P = rotations(random.normal(size=(2, 3)))
        Kt, Ko = Q @ np.diag(SOFT.translation) @ Q.T, P @ np.diag(SOFT.rotation) @ P.T
        p, R = found.motion.reference[:3, 3], found.motion.reference[:3, :3]

        def reading(twist: np.ndarray, p=p, R=R, Kt=Kt, Ko=Ko) -> np.ndarray:
            return wrench(p + R @ twist[:3], R @ rotations(twist[3:]), Kt, Ko)

        Km = np.stack([(reading(h * e) - reading(-h * e)) / (2 * h) for e in steps], axis=1)
        inside += (np.abs(found.fit.Km - Km) <= found.interval).sum()
    assert inside >= 0.9 * 360


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        (lambda Km: Km.T, "transposed"),
        (lambda Km: Km + half_moment(Km), "the wrong half of [m]"),
    ],
)
def test_a_wrong_formula_is_an_alarm(changed, what: str) -> None:
    """Fit with a wrong formula (transposed, wrong half of the moment): the residual must raise an alarm."""
    fit = fit_stiffness(motion(*recorded(3)))
    assert not analyse_residual(fit, has_bias=False).is_alarm
    assert analyse_residual(replace(fit, Km=changed(fit.Km)), has_bias=False).is_alarm, what


def half_moment(Km: np.ndarray) -> np.ndarray:
    more = np.zeros((6, 6))
    more[3:, 3:] = (Km - Km.T)[3:, 3:] / 2
    return more


def test_base_axes_for_sensor_axes_is_an_alarm() -> None:
    """The pose at the load is turned by 0.05 rad against the base: readings in other axes are turned by as much."""
    assert not measure_stiffness(*recorded(4), has_bias=False).residual.is_alarm
    turn, _ = (found := measure_stiffness(*recorded(4), in_base_axes=True, has_bias=False).residual).errors
    assert found.is_alarm and turn.verdict == "found"


def test_an_isotropic_spring_does_not_separate_lever_and_bias() -> None:
    errors = measure_stiffness(*recorded(1, ISOTROPIC)).residual.errors
    verdicts = {each.name: each.verdict for each in errors}
    assert verdicts["lever"] == verdicts["force bias"] == "not separable"
    assert measure_stiffness(*recorded(1, SOFT)).residual.errors[1].verdict != "not separable"


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (lambda: recorded(1, circle=True), "one-way motion"),
        (lambda: recorded(1, fault=Fault(delay=0.02), circle=True), "one-way motion"),
        (lambda: recorded(1, size=30.0), "too curved"),
        (lambda: recorded(1, Spring((800.0, 700.0, 0.0), (60.0, 40.0, 30.0), (2e-3, 20e-3))), "no spring"),
        (lambda: recorded(1, count=100), "too few"),
    ],
    ids=["circle", "late circle", "large", "sliding", "short"],
)
def test_unusable_recordings_are_refused_by_name(rows, reason: str) -> None:
    """Record motions from which no spring can be estimated: refused with the reason."""
    with pytest.raises(RecordingError, match=reason):
        measure_stiffness(*rows())


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of the paper's group are not committed")
@pytest.mark.parametrize("name", ["Circle", "Free", "LinearTable"])
def test_real_recordings_are_refused_by_name(name: str) -> None:
    """Read real recordings, whole and in parts of 4 s and 2 s: each is refused with its reason."""
    (file,) = RECORDINGS.glob(f"RobotData_{name}_*.txt")
    rows = np.genfromtxt(file, delimiter="\t", skip_header=1)
    places = np.concatenate([rows[:, 7:10], rows[:, 13:16] * rows[:, 16:17]], axis=1)
    time, poses = rows[:, 0], recorded_poses(places, "vector")
    for length in (100.0, 4.0, 2.0):
        for start in np.arange(0, time[-1] - length / 2 if length < 100 else 1, length):
            part = (time >= start) & (time < start + length)
            if part.sum() < 250:
                continue
            made = motion(time[part], poses[part], rows[part, 1:7], in_base_axes=True)
            reasons = {each.partition(":")[0] for each in refusals(made, fit_stiffness(made))}
            assert reasons >= {"one-way motion", "no spring"}, (start, length)


# ---- a robot and its plan --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory):
    folder = stiffgen.generate(
        URDF, tip="link_ee", kernels="hybrid,body", controller=False, name="held",
        output=tmp_path_factory.mktemp("measure"),
    )  # fmt: skip
    return stiffgen.open_robot(folder)


@pytest.mark.slow
def test_a_plan_keeps_its_promise(robot) -> None:
    """Simulate a plan: the pose follows, delays fake nothing, and the deviation is the promised one."""
    options = PlanOptions(np.array([800.0, 700, 500, 60, 40, 30]), deviation=np.radians(0.02), most_wrench=(20.0, 3.0))
    plan = plan_excitation(robot, POSTURE, options)
    first = sensor_poses(robot, np.array([POSTURE]))[0]
    wanted = first @ recorded_poses(plan.twist, "vector")
    np.testing.assert_allclose(sensor_poses(robot, plan.q), wanted, atol=1e-9)
    assert plan.q[0] == pytest.approx(POSTURE) and plan.q[-1] == pytest.approx(POSTURE)
    K = np.diag(options.stiffness)
    errors = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        F = plan.twist @ K + random.normal(size=plan.twist.shape) * np.repeat(options.noise, 3)
        found = measure_stiffness(plan.time, wanted, F, has_bias=False)
        assert found.faked[0] < 1e-4  # [rad]
        errors.append(found.residual.errors[0].value)  # the sensor's turn that was found [rad]; there is none
    # rms of 20 runs
    assert np.sqrt((np.array(errors) ** 2).mean(axis=0)).max() == pytest.approx(plan.deviation, rel=0.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"deviation": -1.0}, "must be positive"),
        ({"stiffness": (1.0,) * 5 + (-1.0,)}, "positive definite"),
        ({"stiffness": np.triu(np.ones((6, 6)))}, "is not symmetric"),
        ({"duration": 0.5}, "40 samples per period"),
    ],
)
def test_a_wrong_plan_is_refused(robot, change, words: str) -> None:
    """Plan with impossible options: refused and named."""
    with pytest.raises(StiffgenError, match=words):
        plan_excitation(robot, POSTURE, PlanOptions(**{"stiffness": (700.0,) * 3 + (40.0,) * 3} | change))


@pytest.mark.slow
def test_joint_stiffness_has_the_deviation_of_repeated_measurements(robot) -> None:
    """Repeat a measurement 60 times with sensor noise (0.05 N, 0.002 N m): the spread is the stated deviation."""
    q, found = POSTURE, [measure_stiffness(*recorded(5, count=1000))]
    stated = joint_stiffness_deviation(found[0], robot.module, q).deviation
    noise, made = np.random.default_rng(0), []
    time, poses, F = recorded(5)
    for _ in range(60):
        other = measure_stiffness(time, poses, F + noise.normal(size=F.shape) * np.repeat([0.05, 0.002], 3))
        made.append(joint_stiffness_deviation(other, robot.module, q).joint_stiffness)
    spread = np.std(made, axis=0)
    assert np.median(spread / stated) == pytest.approx(1.0, abs=0.35)


SENSOR = stiffgen.Sensor("link_ee", xyz=(0.03, -0.02, 0.07), rpy=(0.4, -0.3, 1.1))


@pytest.fixture(scope="module")
def sensing(tmp_path_factory: pytest.TempPathFactory):
    folder = stiffgen.generate(
        URDF, tip="link_ee", kernels="sensor,hybrid,body", controller=False, name="sensing", sensor=SENSOR,
        output=tmp_path_factory.mktemp("measure"),
    )  # fmt: skip
    return stiffgen.open_robot(folder)


@pytest.mark.slow
def test_a_mounted_sensor_is_a_tip_at_its_place(sensing, tmp_path: Path) -> None:
    """Compare the joint stiffness through a mounting with a robot whose tip is at the sensor."""
    link = '<link name="cell"/><joint name="mount" type="fixed"><parent link="link_ee"/><child link="cell"/>'
    place = f'<origin xyz="{" ".join(map(str, SENSOR.xyz))}" rpy="{" ".join(map(str, SENSOR.rpy))}"/></joint></robot>'
    urdf = tmp_path / "cell.urdf"
    urdf.write_text(Path(URDF).read_text().replace("</robot>", link + place))
    folder = stiffgen.generate(
        urdf, tip="cell", kernels="body", controller=False, masses=False, name="cell", output=tmp_path
    )
    found = measure_stiffness(*recorded(5), has_bias=False)
    mounted = joint_stiffness_deviation(found, sensing.module, POSTURE, sensing.chain.sensor)
    expected = joint_stiffness_deviation(found, stiffgen.open_robot(folder).module, POSTURE)
    np.testing.assert_allclose(mounted.joint_stiffness, expected.joint_stiffness, atol=1e-9)
    np.testing.assert_allclose(mounted.deviation, expected.deviation, atol=1e-9)


@pytest.mark.slow
def test_a_calibration_is_corrected(sensing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Bias and payload of the file are taken off; its rotation becomes the turn that was found, and nothing else."""
    monkeypatch.chdir(tmp_path)
    # Bias [N, N m]; payload: mass [kg] and first moment [kg m].
    bias, payload = np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.1]), np.array([0.8, 0.01, -0.02, 0.03])
    none = (0.0,) * 6
    file = Calibration("sensing", sensing.chain.sensor.text, tuple(bias), tuple(payload), none, (0.0,) * 4, none, none,
                       (0.0,) * 3, (0.0,) * 3, 12)  # fmt: skip
    Path("sensor.json").write_text(file.to_json())
    options = PlanOptions(np.array([800.0, 700, 500, 60, 40, 30]), deviation=np.radians(0.02), most_wrench=(20.0, 3.0))
    plan = plan_excitation(sensing, POSTURE, options)
    turned = rotations(np.array([[0.0, DEGREE, 0.0]]))[0]
    F = plan.twist @ np.diag(options.stiffness) + sensor_noise(len(plan.twist), options)
    readings = np.concatenate([F[:, :3] @ turned, F[:, 3:] @ turned], axis=1)
    readings += sensing.module.sensor.reading(plan.q, np.zeros(6), bias, payload)
    names = ["time", *(f"q_{i}" for i in range(7)), *(f"wrench_{i}" for i in range(6))]
    rows = np.column_stack([plan.time, plan.q, readings])
    np.savetxt("log.csv", rows, delimiter=",", header=",".join(names), comments="")
    command = ["measure", "log.csv", "--robot", str(sensing.folder), "--calibration", "sensor.json"]
    assert main([*command, "--correct", "corrected.json"]) == 1
    capsys.readouterr()
    made = read_calibration(Path("corrected.json"))
    assert replace(made, rotation=file.rotation, rotation_interval=file.rotation_interval) == file
    np.testing.assert_allclose(made.rotation, (0.0, DEGREE, 0.0), atol=2e-3)
    assert max(made.rotation_interval) < 2e-3


def sensor_noise(count: int, options: PlanOptions) -> np.ndarray:
    return np.random.default_rng(7).normal(size=(count, 6)) * np.repeat(options.noise, 3)


def test_from_recording_to_page(robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Measure a recording whose tool is turned by 1 deg: page and table state the turn."""
    monkeypatch.chdir(tmp_path)
    time, poses, F = recorded(2, fault=Fault(turn=(0.0, 0.0, DEGREE)))
    quaternion = np.array([from_rotation(R) for R in poses[:, :3, :3]])
    pose = [f"pose_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    names = ["time", *pose, *(f"wrench_{i}" for i in range(6))]
    rows = np.column_stack([time, poses[:, :3, 3], quaternion, F])
    np.savetxt("log.csv", rows, delimiter=",", header=",".join(names), comments="")
    assert main(["measure", "log.csv", "--calibration", "none"]) == 1
    assert "turn: (" in capsys.readouterr().out
    assert "chi-square" in Path("log_measured.html").read_text()
    table = Path("log_measured.csv").read_text()
    assert "turn,z,found,0.017" in table  # [rad] 1 deg


def from_rotation(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (x, y, z, w), w > 0: rotations by less than half a turn."""
    w = np.sqrt(1 + np.trace(R)) / 2
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 4 * w * w]) / (4 * w)


def test_a_plan_is_written(robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Write a plan: its rows, a smaller one for smaller deviations, and refusals of wrong options."""
    monkeypatch.chdir(tmp_path)
    posture = ",".join(map(str, POSTURE))
    command = ["measure", "--plan", "plan.csv", "--robot", str(robot.folder), "--posture", posture]
    assert main([*command, "--stiffness", "800,700,500,60,40,30", "--calibration", "none"]) == 0
    wide = np.loadtxt("plan.csv", delimiter=",")
    assert wide.shape == (4401, 7)
    narrow = [*command, "--stiffness", "800,700,500,60,40,30", "--calibration", "none", "--deviation", "0.1,0.2,0.02"]
    assert main(narrow) == 0
    assert np.ptp(np.loadtxt("plan.csv", delimiter=","), axis=0).max() < 0.5 * np.ptp(wide, axis=0).max()
    assert main([*narrow[:-1], "0.1,1"]) == 2
    assert "--deviation: has 2 numbers" in capsys.readouterr().err
    assert main(command) == 2
    assert "--stiffness" in capsys.readouterr().err
    log = ["measure", "log.csv", "--robot", str(robot.folder), "--calibration", "sensor.json", "--axes", "base"]
    assert main(log) == 2
    assert "readings in sensor axes" in capsys.readouterr().err
    assert json.loads((robot.folder / "manifest.json").read_text())
