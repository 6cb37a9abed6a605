# SPDX-License-Identifier: MIT
"""A known weight at the tip, which a user can hang on a real arm, shows faults of the client's wrench.

The client holds one posture of the simulated robot, and its spring carries the weight. ``stiffgen calibrate --check``
judges the wrenches in its log. MuJoCo's force and torque sensor makes the readings.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import ninja
import numpy as np
import pytest

from fri.support.python_client import free_port
from fri.support.run import Run
from fri.support.session import POSTURE, Programs
from stiffgen.cli import main
from support.calibrations import calibration_text
from support.plate import PAYLOAD
from support.project import ROOT, Once

SOURCE = ROOT / "fri" / "client" / "wrench.cpp"
CALLS = (
    "robot::tip_wrench(q, reading_, calibration_.bias, calibration_.payload, wrench);",
    "robot::external_wrench(q, torque, damping_, wrench);",
)
FAULTS = {
    "the sign": "seeded::scaled(wrench, 6, -1.0);",
    "the axes": "seeded::exchanged(wrench);",
    "the lever": "double pose[16]; robot::pose(q, pose); seeded::left_at_sensor(pose, wrench);",
}
"""Faults of what the client computes, by name, in its code behind the two calls."""
OF_SENSOR = {
    "the payload twice": "double payload[4]; std::copy(calibration_.payload, calibration_.payload + 4, payload);"
    " seeded::scaled(payload, 4, 2.0); robot::tip_wrench(q, reading_, calibration_.bias, payload, wrench);",
    "the sensor's axes": "double reading[6]; std::copy(reading_, reading_ + 6, reading); seeded::exchanged(reading);"
    " robot::tip_wrench(q, reading, calibration_.bias, calibration_.payload, wrench);",
}
"""Further faults of what becomes of a reading."""
HELPERS = """
#include <algorithm>
#include <cstdlib>
#include <cstring>
namespace seeded {
bool is(const char *fault) { return std::getenv("SEEDED") != NULL && std::strcmp(std::getenv("SEEDED"), fault) == 0; }
void scaled(double *values, int count, double factor) { for (int i = 0; i < count; ++i) { values[i] *= factor; } }
void left_at_sensor(const double *pose, double *wrench)
{
    const double x = 0.24 * pose[2], y = 0.24 * pose[6], z = 0.24 * pose[10];
    wrench[3] += y * wrench[2] - z * wrench[1];
    wrench[4] += z * wrench[0] - x * wrench[2];
    wrench[5] += x * wrench[1] - y * wrench[0];
}
void exchanged(double *values) { std::swap(values[1], values[2]); std::swap(values[4], values[5]); }
}
"""
WEIGHT = 2.0
SENSOR, TORQUE = "sensor", "external-torque"


@pytest.fixture(scope="module")
def seeded(once: Once, make_programs: Callable[[str], Programs]) -> Path:
    """Return the client with all faults in it, of which the environment's variable SEEDED chooses one."""
    programs = make_programs("2.7")

    def make(folder: Path) -> None:
        """Build the client with all faults in wrench.cpp, each behind an environment variable."""
        text = SOURCE.read_text()
        for call, faults in zip(CALLS, (FAULTS | OF_SENSOR, FAULTS), strict=True):
            assert text.count(call) == 1
            text = text.replace(call, call + "".join(f'if (seeded::is("{k}")) {{ {v} }}\n' for k, v in faults.items()))
        source, made, client = folder / "wrench.cpp", folder / "wrench.o", folder / "fri_wiping"
        source.write_text('#include "wrench.h"\n' + HELPERS + text)
        tool = Path(ninja.BIN_DIR) / "ninja"
        listed = [tool, "-C", programs.folder, "-t", "commands", "client/fri_wiping"]
        commands = subprocess.run(listed, check=True, capture_output=True, text=True).stdout.splitlines()
        (compile_it,) = (each for each in commands if each.endswith("wrench.cpp"))
        compile_it = re.sub(r"-M[DTF]\S*( \S+\.(o|d))?|-Werror", "", compile_it)
        compile_it = re.sub(r"-o \S+ -c \S+", f"-o {made} -c {source}", compile_it)
        link_it = re.sub(r"-o \S+", f"-o {client} {made}", commands[-1])
        for command in (compile_it, link_it):
            done = subprocess.run(command, shell=True, cwd=programs.folder, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr

    return once("fri-seeded", make) / "fri_wiping"


@pytest.fixture
def check(
    seeded: Path, session: Callable[..., Run], plate_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., tuple[int, str]]:  # fmt: skip
    """Run a session with a hanging weight; return exit code and words of ``calibrate --check`` on its log."""

    def run(wrench: str, fault: str = "") -> tuple[int, str]:
        """Record the hanging weight with the seeded client, and return exit code and output of the check."""
        monkeypatch.setenv("FRI_CLIENT", str(seeded))
        monkeypatch.setenv("SEEDED", fault)
        np.savetxt(tmp_path / "still.csv", np.tile(POSTURE, (300, 1)), delimiter=",")
        options = ["--approach", "0.5", "--wrench", wrench]
        port = free_port()
        if wrench == SENSOR:
            (tmp_path / "sensor.json").write_text(calibration_text(plate_folder, payload=PAYLOAD))
            options += ["--calibration", str(tmp_path / "sensor.json"), "--sensor-port", str(port)]
        hung = ("--weight", WEIGHT, "--sensor-port", port * (wrench == SENSOR))
        held = session("2.7", "--lockstep", "--duration", 2.0, *hung, client=options, trajectory=tmp_path / "still.csv")
        assert (held.robot.code, held.code) == (0, 0), held.error
        (log,) = tmp_path.glob("client-*.csv")
        capsys.readouterr()
        arguments = ["calibrate", log, "--robot", plate_folder, "--reading", "tip:wrench_", "--check", WEIGHT]
        return main([str(each) for each in arguments]), capsys.readouterr().out

    return run


@pytest.mark.slow
@pytest.mark.parametrize("wrench", [SENSOR, TORQUE])
def test_the_clients_wrench_passes(check: Callable[..., tuple[int, str]], wrench: str) -> None:
    code, said = check(wrench)
    assert code == 0 and "passed" in said
    force, moment = map(float, re.findall(r"within ([\d.]+)", said))
    assert force < (0.1 if wrench == SENSOR else 1.0) and moment < (0.1 if wrench == SENSOR else 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrench", "fault"), [*((SENSOR, fault) for fault in (*FAULTS, *OF_SENSOR)), *((TORQUE, fault) for fault in FAULTS)]
)
def test_a_weight_shows_each_seeded_fault(check: Callable[..., tuple[int, str]], wrench: str, fault: str) -> None:
    """Seed a fault in the wrench code: `calibrate --check` with a known weight must find it and hint at its cause."""
    code, said = check(wrench, fault)
    hints = {"the sign": "the force points up", "the lever": "the moment alone is wrong"}
    assert code == 1 and hints.get(fault, "look at") in said
