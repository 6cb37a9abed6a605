# SPDX-License-Identifier: MIT
"""The C++ client against the simulated robot, in lockstep over UDP: determinism, the torque on the wire, and faults."""

from __future__ import annotations

import argparse
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fri.robot import demo
from fri.robot.__main__ import RefusedError
from fri.robot.messages import VERSIONS, SessionState
from fri.support.python_client import free_port
from fri.support.run import Run, newest
from support.pictures import difference
from support.project import ROOT

CLIENT = ROOT / "fri" / "client"
TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
LOCKSTEP = ("--lockstep", "--bowl", "--send-period", 5)
EARLY = 3
"""Exit code of the client when the robot ends the session before the trajectory's end."""
TOLERANT = ("--thresholds", 0.6, 0.5, 0.3)
"""Quality that lets a session go on at a tenth of its datagrams lost each way."""


@newest
def test_repeated_sessions_are_equal_and_the_torque_is_the_controllers(
    session: Callable[..., Run], plate: ModuleType, version: str
) -> None:
    """Run a session twice: equal digests, and torques that the controller repeats from the log."""
    first, second = (session(version, *LOCKSTEP, "--duration", 1.5) for _ in range(2))
    for run in (first, second):
        assert (run.robot.code, run.code, run.error.count("\n")) == (0, EARLY, 1)
        assert run.robot.summary["missing_answers"] == 0
        assert run.faults["lost_cycles"] == run.faults["bad_datagrams"] == 0
    assert first.robot.summary["digest"] == second.robot.summary["digest"]
    first.check(plate)
    assert first.client is not None
    assert len(first.client) == 300  # 1.5 s of 5 ms each
    assert np.ptp(first.robot.log["command_torque"][first.robot.log["has_torque"]]) > 5.0  # N m


# What the robot puts in, against the client's names for what it meets. Each row is one session.
COUNTED = [
    {"garbage": "datagram_frame", "empty": "datagram_empty", "identifier": "datagram_identifier",
     "missing": "datagram_decode", "crc": "datagram_checksum", "six": "datagram_joint_count"},
    {"drop": "lost_messages"},
    {"duplicate": "datagram_duplicate", "reorder": "datagram_out_of_order"},
    {"delay": "datagram_out_of_order", "nan": "missing_fields"},
]  # fmt: skip


def counted_in(version: str) -> list[Any]:
    """Return the rows for a version of the FRI; outside 2.7 only bytes that are no message meet other code."""
    slow, wide = pytest.mark.slow, pytest.mark.wide
    of_garbage, of_others = {"2.7": ((), ()), "1.15": (slow, wide)}.get(version, (wide, wide))
    return [
        pytest.param(version, kinds, id=f"{name}-{version}", marks=of_garbage if name == "garbage" else of_others)
        for name, kinds in zip(map(next, map(iter, COUNTED)), COUNTED, strict=True)
    ]


@pytest.mark.parametrize(("version", "kinds"), [row for version in VERSIONS for row in counted_in(version)])
def test_faults_are_counted_and_harmless(
    session: Callable[..., Run], version: str, plate: ModuleType, kinds: dict[str, str]
) -> None:
    """Inject faults of several kinds: the client counts as many as were put in, and its torques stay the
    controller's.
    """
    if version != "2.7":  # no frame, no checksum
        kinds = {kind: name.replace("frame", "decode") for kind, name in kinds.items() if kind != "crc"}
    faults = ",".join([f"robot.{kind}=0.04@1.2-2" for kind in kinds] + ["client.drop=0.02@1.2-2"])
    run = session(version, *LOCKSTEP, *TOLERANT, "--duration", 1.0, "--faults", faults)
    assert (run.robot.code, run.code, run.error.count("\n")) == (0, EARLY, 1)
    run.check(plate)
    put_in = run.robot.summary["faults"]
    for name in kinds.values():
        assert run.faults[name] == sum(put_in["robot"][kind] for kind in kinds if kinds[kind] == name) > 0
    assert put_in["client"]["drop"] == run.faults["lost_answers"] > 0


@pytest.mark.slow
@newest
def test_random_loss_both_ways(session: Callable[..., Run], version: str, plate: ModuleType) -> None:
    """Lose 10 % of messages and answers: both counts agree with the emulator's, and the run can be repeated."""
    options = (*LOCKSTEP, *TOLERANT, "--duration", 2.0, "--seed", 1, "--faults", "drop=0.1@0.1-3")
    run = session(version, *options)
    assert (run.robot.code, run.code) == (0, EARLY)
    run.check(plate)
    counts = run.robot.summary["faults"]
    assert run.faults["lost_messages"] == counts["robot"]["drop"] > 0
    assert run.faults["lost_answers"] == counts["client"]["drop"] > 0
    assert session(version, *options).robot.summary["digest"] == run.robot.summary["digest"]


@pytest.mark.slow
@newest
def test_loss_that_quality_does_not_bear_ends_with_a_reason(session: Callable[..., Run], version: str) -> None:
    run = session(version, *LOCKSTEP, "--duration", 2.0, "--faults", "drop=0.1")
    assert run.robot.code == 1
    assert "without commanding, which needs GOOD" in run.robot.summary["end"]
    assert SessionState.COMMANDING_ACTIVE not in run.robot.log["state"]


@pytest.mark.slow
@newest
def test_silence_is_survived(session: Callable[..., Run], version: str, plate: ModuleType) -> None:
    """Let the robot be silent for 0.2 s (40 messages): the motion breaks off and starts again."""
    run = session(version, *LOCKSTEP, "--duration", 1.5, "--faults", "robot.silence@1.5-1.7")
    assert (run.robot.code, run.code) == (0, EARLY)
    run.check(plate)
    assert run.robot.summary["motions_broken_off"] == 1
    assert (
        run.faults["lost_messages"]
        == run.faults["lost_cycles"]
        == run.robot.summary["faults"]["robot"]["silence"]
        == 40
    )


@pytest.mark.slow
@newest
def test_state_drops_while_commanding(session: Callable[..., Run], version: str, plate: ModuleType) -> None:
    """Force the robot out of COMMANDING_ACTIVE three times: the client goes on each time and counts the drops."""
    drops = "state@1.3:monitoring_wait,state@2.6:monitoring_ready,state@3.9:commanding_wait"
    run = session(version, *LOCKSTEP, "--duration", 2.0, "--faults", drops)
    assert (run.robot.code, run.code) == (0, EARLY)
    run.check(plate)
    active = run.robot.log["state"] == SessionState.COMMANDING_ACTIVE
    assert np.count_nonzero(np.diff(active.astype(int)) == 1) == 4
    assert run.faults["state_drops"] == 4  # the drops, and the end before the trajectory's


# ---- the demo -------------------------------------------------------------------------------------------------------


def demo_options(folder: Path, robot: Path, port: int) -> argparse.Namespace:
    given = ["--port", str(port), "--robot", str(robot), "--output", str(folder)]
    return demo.arguments().parse_args(given)


@pytest.mark.slow
def test_the_demo_says_that_the_port_is_taken(
    tmp_path: Path, plate_folder: Path, client_program: Callable[[str], Path]
) -> None:
    """Start the demo on a port in use: it refuses with the reason instead of waiting."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        options = demo_options(tmp_path, plate_folder, taken.getsockname()[1])
        with pytest.raises(RefusedError, match="cannot be opened"):
            demo.run_session(options, client_program("2.7"))


@pytest.mark.slow
def test_the_demo_ends_with_its_client(tmp_path: Path, plate_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the client by /bin/false: the demo ends and leaves no process behind."""
    children = []
    popen = subprocess.Popen

    def remember(*given: Any, **more: Any) -> Any:
        children.append(popen(*given, **more))
        return children[-1]

    monkeypatch.setattr(demo.subprocess, "Popen", remember)
    with pytest.raises(demo.BrokenOffError, match="exit code of the client 1"):
        demo.run_session(demo_options(tmp_path, plate_folder, free_port()), Path("/bin/false"))
    assert len(children) == 2
    assert all(child.poll() is not None for child in children)


@pytest.mark.slow
def test_the_demos_figure(session: Callable[..., Run], plate: ModuleType) -> None:
    """Compare the drawn antisymmetric part with its closed form J^T [m]_x J / 2, and look for the figure's labels."""
    run = session("2.7", *LOCKSTEP, "--duration", 1.0)
    assert run.client is not None
    parts = demo.antisymmetric_parts(plate, run.client)
    assert np.max(parts[0]) == 0.0
    J, m = plate.hybrid.jacobian(run.client["q"])[:, 3:], run.client["wrench"][:, 3:]
    cross = np.cross(np.eye(3), m[:, None, :])  # [m]_x up to its sign
    closed = np.swapaxes(J, 1, 2) @ cross @ J / 2
    np.testing.assert_allclose(parts[1], np.linalg.norm(closed, 2, axis=(1, 2)), atol=1e-9)
    svg = demo.draw(run.client, run.robot.log, parts)
    assert svg.startswith("<svg")
    for text in ("joint torques that the robot received", "[N m]", "corrected", "time [s]"):
        assert text in svg


@pytest.mark.wide(instead="test_the_demos_figure")
def test_the_pages_figure(session: Callable[..., Run], plate: ModuleType) -> None:
    """Draw the demo's session anew: the page's figure, but for noise in contact, some points of 684."""
    whole = demo.APPROACH + demo.TRAJECTORY_TIME + demo.REST
    run = session("2.7", *LOCKSTEP, "--duration", whole, client=("--approach", demo.APPROACH))
    assert run.client is not None and run.client.summary["trajectory_done"]
    svg = demo.draw(run.client, run.robot.log, demo.antisymmetric_parts(plate, run.client))
    assert difference(svg, (ROOT / "docs" / "fri_session.svg").read_text(), within=3.0) == ""
