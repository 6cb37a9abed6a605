# SPDX-License-Identifier: MIT
"""``stiffgen.estimate_friction``: friction from a slow motion there and back, on a model and on a simulated arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import RecordingError
from stiffgen.lab.quantiles import student_quantile
from support.arms.arms import Arm
from support.project import Once

FRICTION = np.array([2.0, 0.5, 0.0])


def recording(**changes: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, dq and torque of three joints that go there and back twice, under gravity and noise."""
    settings = {"way": 0.4, "speed": 0.1, "back": 1.0} | changes  # [rad], [rad/s], share of the speed back
    random, samples = np.random.default_rng(2), 16000
    phase = np.arange(samples) / samples * 4  # two ways there and back
    wave = np.abs((phase % 2.0) - 1.0) - 0.5  # triangles
    q = settings["way"] * wave[:, None] * np.array([1.0, -0.8, 0.5]) + np.array([0.2, 0.5, -0.3])
    side = np.where(phase % 2.0 < 1.0, -1.0, settings["back"])
    dq = settings["speed"] * side[:, None] * np.array([1.0, -0.8, 0.5])
    # up to 30, 15 and 3 N m of gravity
    torque = 30.0 * np.sin(q.sum(axis=1))[:, None] * np.array([1.0, 0.5, 0.1]) + FRICTION * np.sign(dq)
    return q, dq + 1e-3 * random.normal(size=q.shape), torque + 0.1 * random.normal(size=q.shape)


def test_gravity_is_no_friction() -> None:
    """30 N m of gravity, 0.1 N m of noise: friction within 0.05 N m, and a configuration of 90 %."""
    found = stiffgen.estimate_friction(*recording())
    np.testing.assert_allclose(found.mean, FRICTION, atol=0.05)
    assert (found.smallest <= found.mean).all() and (found.mean <= found.largest).all()
    np.testing.assert_allclose(found.fields["coulomb_friction"], 0.9 * FRICTION, atol=0.05)
    assert found.text.startswith("coulomb_friction=[1.") and found.text.endswith("# [N m or N]")


@pytest.mark.slow
def test_intervals_contain_the_friction() -> None:
    """95 % intervals of 600 joints hold 88 to 99 %: noise that lasts 0.3 s, friction that varies along the way or not.

    Each joint goes there and back twice in 20 s, with 30 N m of gravity.
    """
    random, samples = np.random.default_rng(4), 4000
    phase = np.arange(samples) / samples * 4  # two ways there and back, in samples of 5 ms
    q = 0.5 * (np.abs(phase % 2.0 - 1.0) - 0.5)[:, None] + np.zeros(200)
    dq = np.where(phase % 2.0 < 1.0, -0.1, 0.1)[:, None] + np.zeros(200)
    for lasting, ripple, range_ in ((0.0, 0.0, (0.9, 0.99)), (0.3, 0.0, (0.88, 0.99)), (0.3, 0.2, (0.88, 0.99))):
        # Noise whose correlation decays in `lasting` [s], of constant variance.
        noise, kept = random.normal(size=q.shape), np.exp(-0.005 / lasting) if lasting else 0.0
        for k in range(1, samples):
            noise[k] = kept * noise[k - 1] + np.sqrt(1 - kept**2) * noise[k]
        friction = 2.0 + ripple * np.sin(60.0 * q + random.uniform(0, 2 * np.pi, 200))
        found = stiffgen.estimate_friction(q, dq, 30.0 * np.sin(q) + friction * np.sign(dq) + 0.3 * noise)
        held = np.mean(np.abs(found.mean - 2.0) < found.half_width)
        print(f"noise of {lasting} s, ripple {ripple}: held {held:.2f}, half width {found.half_width.mean():.3f} N m")
        assert range_[0] <= held <= range_[1]
        assert found.half_width.mean() < 0.2


def test_quantiles_are_those_of_the_closed_forms() -> None:
    """One degree of freedom is Cauchy's distribution; two have a quantile in closed form."""
    for tail in (0.05, 0.005):
        inside = 1 - tail
        np.testing.assert_allclose(student_quantile(1, tail), np.tan(0.5 * np.pi * inside), rtol=1e-9)
        np.testing.assert_allclose(student_quantile(2, tail), inside * np.sqrt(2 / (1 - inside**2)), rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "match"),
    [({"way": 0.05}, "joint 0 moves by 0.05"), ({"speed": 0.6}, "at most 0.3"), ({"back": -1.0}, "there and back")],
)
def test_what_is_refused(changes: dict[str, float], match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        stiffgen.estimate_friction(*recording(**changes))


def test_two_paths_are_refused() -> None:
    q, dq, torque = recording()
    q[:, 2] += 0.2 * (dq[:, 0] > 0)
    with pytest.raises(RecordingError, match="one path"):
        stiffgen.estimate_friction(q, dq, torque)
    with pytest.raises(RecordingError, match="of one shape"):
        stiffgen.estimate_friction(q, dq[:-1], torque)


LAG = 0.01
"""[s] of the joints behind the planned motion."""


@pytest.fixture
def planned(robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], np.ndarray]:
    """Return the command of a robot, and the motion that it plans; the working folder is a fresh one."""
    monkeypatch.chdir(tmp_path)
    command = ["measure", "--friction", "--robot", str(robot_folder)]
    posture = ("--posture", "0.3,0.6,-0.2,-1.2,0.4,1,0.2")
    assert main([*command, "--plan", "plan.csv", *posture]) == 0
    return command, np.loadtxt("plan.csv", delimiter=",")


def write_log(q: np.ndarray, torque: np.ndarray, name: str = "log.csv") -> None:
    columns = ["time", *(f"q_{k}" for k in range(q.shape[1])), *(f"torque_{k}" for k in range(q.shape[1]))]
    rows = np.column_stack([np.arange(len(q)) / 200.0, q, torque])
    np.savetxt(name, rows, delimiter=",", header=",".join(columns), comments="")


def test_the_planned_motion_is_slow(planned: tuple[list[str], np.ndarray]) -> None:
    """20 s and the turns, at rest at both ends, 0.1 rad/s, twice there and back."""
    _, q = planned
    speed = np.diff(q, axis=0) * 200.0
    assert q.shape == (4101, 7) and np.allclose(q[0], q[-1], atol=1e-6)
    np.testing.assert_allclose(np.ptp(q, axis=0), 0.5, atol=0.02)
    assert np.abs(speed).max() < 0.11 and np.abs(speed[[0, -1]]).max() < 0.01
    assert np.abs(np.diff(speed, axis=0)).max() * 200 < 1.0  # rad/s^2: the joints turn round smoothly


def test_from_plan_to_table(planned: tuple[list[str], np.ndarray], capsys: Any, robot_folder: Path) -> None:
    """Torques with and without gravity give the same friction; joints lag; the table has the printed configuration."""
    command, plan = planned
    robot = stiffgen.open_robot(robot_folder)
    dq = np.gradient(plan, axis=0) * 200.0  # [rad/s], rows at 200 Hz
    q = plan - LAG * dq
    true = np.array([3.0, 4.0, 2.0, 2.5, 1.0, 0.8, 0.6])  # [N m] Coulomb friction
    torque = true * np.tanh(dq / 0.01) + 0.2 * np.random.default_rng(3).normal(size=q.shape)  # [N m] with noise of 0.2
    found = []
    for weight, said in (
        (robot.module.gravity.gradient(q, np.array([0, 0, -9.81])), "is taken off"),
        (0, "no gravity"),
    ):
        write_log(q, torque + weight)
        capsys.readouterr()
        assert main([*command, "log.csv"]) == 0
        printed = capsys.readouterr().out
        table = np.genfromtxt("log_friction.csv", delimiter=",", names=True, dtype=None, encoding=None)
        found.append(table["friction"])
        assert said in printed and printed.splitlines()[-1] == "log_friction.csv"
        assert [f"{value:.3g}" for value in table["coulomb_friction"]] == [
            f"{float(value):.3g}" for value in printed.split("coulomb_friction=[")[1].split("]")[0].split(",")
        ]
        np.testing.assert_allclose(table["friction"], true, atol=0.05)
        inside = np.abs(table["friction"] - true) < table["half_width_95"]
        assert inside.sum() >= 6, inside  # each of 7 is inside in 95 % of draws: one may be out
        np.testing.assert_allclose(table["coulomb_friction"], 0.9 * table["friction"], rtol=1e-4)
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["log.csv", "--window", "0", "1"], "joint 0 "),
        (["log.csv", "--window", "0", "0.02"], "takes seconds"),
        (["log.csv", "--window", "90", "91"], "0 rows, whose time must rise"),
        (["log.csv", "--reading", "tau_"], "--reading tau_: needs 7 columns"),
        (["log.csv", "--reading", "a,b"], "--reading: 2 names, but a row has 7 entries"),
        (["log.csv", "--positions", "a,b"], "--positions: 2 names"),
        (["absent.csv"], "is no file"),
        (["--plan", "p.csv"], "--posture"),
        (["--plan", "p.csv", "--posture", "0,0"], "shape (2,)"),
        (["--plan", "p.csv", "--posture", "0,2,0,0,0,0,0"], "joint 'A2' would leave its range"),
        ([], "give a recording"),
    ],
)
def test_what_the_command_refuses(
    planned: tuple[list[str], np.ndarray], capsys: Any, arguments: list[str], said: str
) -> None:
    """Give recordings and plans that cannot be used: exit code 2, the reason, and no file."""
    command, q = planned
    write_log(q, np.zeros_like(q))
    assert main([*command, *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not list(Path().glob("*_friction.csv")) and not Path("p.csv").exists()


def test_friction_needs_a_robot(capsys: Any) -> None:
    assert main(["measure", "log.csv", "--friction"]) == 2
    assert "--friction: needs --robot" in capsys.readouterr().err


@pytest.mark.slow
def test_a_simulated_arm(once: Once) -> None:
    """Simulate a UR5 with sticking friction under the controller: within 15 % for each joint."""
    arm = Arm("ur5", once("arms-ur5", lambda folder: Arm("ur5", folder)))
    samples = 20000
    wave = 0.5 - np.abs((np.arange(samples) / samples * 4) % 2.0 - 1.0) + 0.5  # two triangles of height 1
    goal = arm.posture + 0.5 * (wave - wave[0])[:, None] * np.array([1.0, -0.6, 0.8, 0.7, 0.7, 1.0])  # [rad]
    rows = arm.run(arm.plant(), samples, arm.config(velocity_noise=5e-3), goal=goal, translation=4000.0, rotation=400.0)
    assert not rows["faulted"].any()
    found = stiffgen.estimate_friction(rows["q"], rows["v"], rows["torque"])
    true = arm.maker.friction * arm.effort
    print("share found:", np.round(found.mean / true, 2))
    np.testing.assert_allclose(found.mean, true, rtol=0.15)
