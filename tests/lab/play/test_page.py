# SPDX-License-Identifier: MIT
"""The playground's page: its kernels and its own mathematics held against Python, its file, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.cli import main
from stiffgen.lab.play import page
from support.chains import chain_urdf
from support.playground import Scripts, random_value, require_wasm
from support.project import ROOT, assert_close, require_program

GAINS = [700.0, 700.0, 800.0, 30.0, 30.0, 30.0]
WRENCH = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])
OTHERS = {
    "six axes": ("rrrrrr", {}),
    "slides and mimics": ("rrpmrr", {}),
    "floating base": ("rrr", {"floating_base": True}),
    "tool at run time": ("rrrr", {"runtime_tool": True}),
    "two tips": (None, {"tip": ["left hand", "right-hand"]}),
}


@pytest.fixture(scope="module")
def scripts(robot_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Scripts:
    return Scripts(open_robot(robot_folder), tmp_path_factory.mktemp("scripts"))


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Scripts]:
    """Return a function that generates another robot and its scripts."""

    def made(name: str) -> Scripts:
        folder, (types, options) = tmp_path_factory.mktemp("other"), OTHERS[name]
        urdf = ROOT / "tests" / "data" / "dual_arm.urdf" if types is None else folder / "arm.urdf"
        if types:
            urdf.write_text(chain_urdf(types))
        (folder / "scripts").mkdir()
        generated = stiffgen.generate(urdf, output=folder, name="arm", batches=False, controller=False, **options)
        return Scripts(open_robot(generated), folder / "scripts")

    return made


def check_kernels(scripts: Scripts, count: int) -> None:
    """Fail unless the page's functions give Python's values, each in `count` random states."""
    robot, random = scripts.robot, np.random.default_rng(3)
    table = {f"{robot.name}_{kernel.qualified_name}": kernel for kernel in robot.table}
    tasks, expected = [], []
    for name in scripts.data["functions"]:
        for _ in range(count):
            given = {each.name: random_value(each, robot, random) for each in table[name].arguments}
            tasks.append({"do": "call", "name": name, "given": {key: value.ravel() for key, value in given.items()}})
            expected.append(robot.kernels[table[name].qualified_name](*given.values()))
    for value, right in zip(scripts.run(tasks), expected, strict=True):
        assert_close(np.reshape(value, np.shape(right)), right)


def check_drawing(scripts: Scripts) -> None:
    """Compare the frames that are drawn, at their ends, with the kernel's poses of the tips, in five postures each."""
    robot, random = scripts.robot, np.random.default_rng(4)
    for index, tip in enumerate(robot.chain.tips):
        kernel = next(
            k for k in robot.table if k.qualified_name.endswith("forward_kinematics") and k.tip in (None, tip)
        )
        given = [{each.name: random_value(each, robot, random) for each in kernel.arguments} for _ in range(5)]
        for each in given:
            each.pop("base_pose", None)
        tasks = [{"do": "frames", "q": g["q"], "tool": g.get("tool_pose", np.eye(4)).ravel()} for g in given]
        for frame, each in zip(scripts.run(tasks, index), given, strict=True):
            base = [np.eye(4)] if robot.chain.floating else []
            pose = np.asarray(robot.kernels[kernel.qualified_name](*base, *each.values()))
            assert_close(np.reshape(frame["rotation"], (3, 3)), pose[:3, :3])
            assert_close(frame["origin"], pose[:3, 3])


def test_kernels_in_webassembly(scripts: Scripts) -> None:
    check_kernels(scripts, 100)
    check_drawing(scripts)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "two tips" else pytest.mark.wide) for name in OTHERS]
)
def test_kernels_of_other_robots(other: Callable[[str], Scripts], name: str) -> None:
    """Compare values and drawings of other robots; the laws with an energy do no work."""
    scripts = other(name)
    check_kernels(scripts, 30)
    check_drawing(scripts)
    (posture,) = scripts.run([{"do": "bent"}])
    for tip in range(len(scripts.data["tips"])):
        found = scripts.run(
            [{"do": "loop", "q": posture, "wrench": WRENCH / 10, "gains": GAINS, "chosen": False,
              "loop": {"kind": "joints", "joints": [0, 1], "radius": 0.1}}], tip,
        )  # fmt: skip
        for law in ("exact", "corrected"):
            assert abs(found[0][law][-1]) < 1e-11


def test_a_links_point_moves_as_its_jacobian_says(scripts: Scripts) -> None:
    """Compare the Jacobian of a point on a link with differences (step 1e-6 rad)."""
    q, point, step = np.array([0.3, -0.5, 0.2, 1.0, 0.4, -0.7, 0.1]), np.array([0.2, 0.1, 0.6]), 1e-6
    tasks = [{"do": "frames", "q": q + sign * step * axis} for axis in np.eye(7) for sign in (1, -1)]
    origin = np.array(scripts.run([{"do": "frames", "q": q}])[0]["origin"])
    (J,) = scripts.run([{"do": "point", "q": q, "joint": 6, "point": origin}])
    ends = np.array([each["origin"] for each in scripts.run(tasks)])
    np.testing.assert_allclose(np.reshape(J, (3, 7)).T, (ends[::2] - ends[1::2]) / (2 * step), atol=1e-9)
    (J,) = scripts.run([{"do": "point", "q": q, "joint": 2, "point": point}])
    assert not np.reshape(J, (3, 7))[:, 3:].any()  # what comes after a link does not move it


def test_matrices(scripts: Scripts, robot: ModuleType) -> None:
    """Ask for the matrices: the spring bears the wrench, exact is the slope of its torque, corrected agrees."""
    q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
    state = {"do": "matrices", "q": q, "wrench": WRENCH, "gains": GAINS}
    own, chosen = scripts.run([state | {"chosen": False}, state | {"chosen": True}])
    spring = [np.reshape(own["spring"][key], (-1, size)) for key, size in
              (("equilibrium", 4), ("translation_stiffness", 3), ("rotation_stiffness", 3))]  # fmt: skip
    np.testing.assert_allclose(robot.spring.wrench(q, *spring), WRENCH, atol=1e-9)
    R0 = spring[0][:3, :3]
    np.testing.assert_allclose(R0 @ spring[2] @ R0.T, np.diag(GAINS[3:]), atol=1e-9)  # gains in base axes at rest
    step = 1e-6 * np.eye(7)  # [rad]
    slope = -(robot.spring.torque(q + step, *spring) - robot.spring.torque(q - step, *spring)) / 2e-6
    exact, corrected, conventional = (np.reshape(own[key], (7, 7)) for key in ("exact", "corrected", "conventional"))
    np.testing.assert_allclose(exact, slope.T, atol=1e-5)
    np.testing.assert_allclose(corrected, exact, atol=1e-10)
    np.testing.assert_allclose(
        np.reshape(own["antisymmetric"], (7, 7)), (conventional - conventional.T) / 2, atol=1e-13
    )
    assert np.abs(own["antisymmetric"]).max() > 1  # [N m/rad] the load matters
    np.testing.assert_allclose(
        np.reshape(chosen["conventional"], (7, 7)), robot.hybrid.joint_stiffness_uncorrected(q, WRENCH, np.diag(GAINS)),
        atol=1e-10,
    )  # fmt: skip
    assert np.abs(np.array(chosen["corrected"]) - chosen["exact"]).max() > 1e-2  # [N m/rad] of the chosen stiffness


def test_no_spring_for_a_moment_that_is_too_large(scripts: Scripts) -> None:
    state = {"do": "matrices", "q": [0.1] * 7, "wrench": [0, 0, 0, 0, 0, 20], "gains": [700] * 3 + [5] * 3}
    (found,) = scripts.run([state | {"chosen": False}])
    assert found["spring"] is None
    assert found["exact"] is None
    assert np.isfinite(found["corrected"]).all()


def test_a_turn_of_the_tip_costs_the_moment_times_the_area(scripts: Scripts) -> None:
    """Turn the tip round a loop of 0.1 rad: the conventional work is -pi r^2 times the moment."""
    q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
    axes = [[0, 1], [1, 2], [2, 0]]
    tasks = [
        {"do": "loop", "q": q, "wrench": WRENCH, "gains": GAINS, "chosen": False,
         "loop": {"kind": "turn", "axes": pair, "radius": 0.1}} for pair in axes
    ]  # fmt: skip
    for works, moment in zip(scripts.run(tasks), WRENCH[[5, 3, 4]], strict=True):
        assert works["conventional"][-1] == pytest.approx(-np.pi * 0.1**2 * moment, abs=1e-5)


def test_the_tip_follows_a_drag_and_postures_are_what_they_say(scripts: Scripts, robot: ModuleType) -> None:
    """Drag the tip by 7 cm: reached within 1 mm; the named postures are within limits, or singular."""
    q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
    pose = np.asarray(robot.forward_kinematics(q))
    place = pose[:3, 3] + [0.05, -0.04, 0.03]  # [m]
    moved, bent, (before, near) = scripts.run(
        [{"do": "follow", "q": q, "place": place, "orientation": pose[:3, :3].ravel()}, {"do": "bent"},
         {"do": "singular", "q": q}]
    )  # fmt: skip
    reached = np.asarray(robot.forward_kinematics(np.array(moved)))
    assert np.linalg.norm(reached[:3, 3] - place) < 1e-3
    assert np.abs(reached[:3, :3] - pose[:3, :3]).max() < 0.02
    limits = [(each.lower, each.upper) for each in scripts.robot.chain.coordinates]
    assert all(low <= x <= high for x, (low, high) in zip(bent, limits, strict=True))
    assert near < 0.2 * before


def test_a_drag_out_of_reach_and_back_does_not_fold_the_elbow_over(scripts: Scripts, robot: ModuleType) -> None:
    """Small steps of the joints, the elbow (A4) on its side, and the tip back where it began."""
    q = np.radians([0, 30, 0, -40, 0, 30, 0])
    pose = np.asarray(robot.forward_kinematics(q))
    way = pose[:3, 3] - [0, 0, 0.36]  # from the shoulder
    parts = np.concatenate([np.linspace(1, 1.4, 40), np.linspace(1.4, 0.9, 50)])
    places = [way * part + [0, 0, 0.36] for part in parts]
    found = scripts.run([{"do": "drag", "q": q, "places": places, "orientation": pose[:3, :3].ravel()}])[0]
    postures = np.array([q, *found])
    assert np.abs(np.diff(postures, axis=0)).max() < 0.3
    assert postures[:, 3].max() < 0 and postures[:, 3].max() > -0.2  # it was straight
    assert np.linalg.norm(np.asarray(robot.forward_kinematics(postures[-1]))[:3, 3] - places[-1]) < 2e-3


@pytest.mark.slow
def test_the_arm_swings_as_an_integration_in_python_does(scripts: Scripts, robot: ModuleType) -> None:
    """Let each law swing from the same start: as by SciPy's integrator, and only the conventional law makes energy."""
    from scipy.integrate import solve_ivp

    q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
    wrench, damping, seconds = np.array([0, 0, 0, 4.0, -3.0, 8.0]), 0.3, 0.2  # [N m], [1/s], [s]
    task = {"do": "swing", "q": q, "wrench": wrench, "gains": GAINS, "damping": damping, "seconds": seconds}
    for swing in scripts.run([task])[0]:
        spring = [np.reshape(swing["spring"][key], (-1, size)) for key, size in
                  (("equilibrium", 4), ("translation_stiffness", 3), ("rotation_stiffness", 3))]  # fmt: skip
        start, task_stiffness = robot.spring.torque(q, *spring), robot.spring.task_stiffness(q, *spring)
        name = "joint_stiffness" + ("_uncorrected" if swing["law"] == "conventional" else "")
        K = getattr(robot.hybrid, name)(q, wrench, task_stiffness)

        def slope(
            time: float, x: np.ndarray, exact: bool = swing["law"] == "exact", spring: list = spring, K: np.ndarray = K,
            start: np.ndarray = start,
        ) -> np.ndarray:  # fmt: skip
            """Return d(q, dq)/dt of the arm on its spring, with damping, for SciPy's integrator."""
            at, velocity = x[:7], x[7:]
            torque = robot.spring.torque(at, *spring) if exact else start - K @ (at - q)
            M, bias = robot.mass_matrix(at), robot.bias_forces(at, velocity, np.zeros(3))
            ddq = np.linalg.solve(M, torque - 20 * (at - q) - bias - damping * M @ velocity)
            return np.concatenate([velocity, ddq])

        right = solve_ivp(slope, (0, seconds), np.concatenate([q, np.zeros(7)]), rtol=1e-10, atol=1e-12).y[:7, -1]
        np.testing.assert_allclose(swing["q"], right, atol=2e-5, err_msg=swing["law"])
        assert np.abs(right - q).max() > 0.01  # [rad] it moves
        assert (abs(swing["made"]) > 1e-4) == (swing["law"] == "conventional"), swing["made"]


@pytest.fixture(scope="module")
def written(scripts: Scripts, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page.write_page(scripts.robot.folder, tmp_path_factory.mktemp("page") / "play.html")


def test_page_is_one_small_file_that_asks_for_nothing(written: Path, tmp_path: Path) -> None:
    """Check the page: below 1 MB, valid script, and nothing loaded from elsewhere."""
    text = written.read_text()
    assert written.stat().st_size < 1_000_000
    assert not re.search(r"https?://|src=|@import|{{", re.sub(r'"wasm">[^<]*<', "<", text))
    assert list(written.parent.iterdir()) == [written]
    script = text.partition('<script type="module">')[2].partition("</script>")[0]
    assert not re.search(r"^(import|export)\b", script, re.MULTILINE)
    (tmp_path / "page.mjs").write_text(script)
    subprocess.run([require_program("node", "nodejs"), "--check", tmp_path / "page.mjs"], check=True)


@pytest.mark.slow
def test_page_is_the_same_every_time(scripts: Scripts, written: Path) -> None:
    assert page.page_text(scripts.robot) == written.read_text()


@pytest.mark.slow
def test_names_from_a_file_cannot_leave_the_data(scripts: Scripts) -> None:
    """Name joints like HTML tags: the page escapes them."""
    robot = scripts.robot
    data = page.page_data(robot)
    assert data["tips"][0]["link"] == "link_ee"
    manifest = json.loads(json.dumps(robot.manifest).replace('"A1"', '"</script><b>"').replace('"link_ee"', '"<!--"'))
    folder = scripts._folder / "hostile"
    folder.mkdir()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    shutil.copyfile(robot.folder / "iiwa14.c", folder / "iiwa14.c")
    for header in ("iiwa14.h", "iiwa14_lanes.h"):
        shutil.copyfile(robot.folder / header, folder / header)
    text = page.page_text(open_robot(folder))
    assert "</script><b>" not in text
    assert '"<!--"' not in text
    assert text.count("</script>") == 3


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(each) for each in arguments])
    return code, *capsys.readouterr()


@pytest.mark.slow
def test_command(
    capsys: pytest.CaptureFixture[str], scripts: Scripts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Write the page by the command: its name on standard output, and the browser opened once."""
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address))
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "play", scripts.robot.folder)
    assert (code, out) == (0, "iiwa14.html\n")
    assert "compiling iiwa14 for WebAssembly" in err
    assert opened == [(tmp_path / "iiwa14.html").as_uri()]
    code, out, _ = run(capsys, "play", scripts.robot.folder, "--output", "new/there.html")
    assert (code, out, len(opened)) == (0, "new/there.html\n", 1)


def test_refusals(
    capsys: pytest.CaptureFixture[str], robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ask for pages that cannot be made: exit code 2, the reason, and no file."""
    require_wasm()
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, "play", tmp_path)
    assert (code, "is not a folder that 'stiffgen generate' wrote" in err) == (2, True)
    code, _, err = run(capsys, "play", robot_folder, "--output", tmp_path)
    assert (code, "is a folder; give the name of a file" in err) == (2, True)
    broken = tmp_path / "robot"
    shutil.copytree(robot_folder, broken)
    (broken / "iiwa14.c").write_text("#error broken\n")
    code, _, err = run(capsys, "play", broken)
    assert (code, "could not make WebAssembly of iiwa14.c" in err, "broken" in err) == (2, True, True)
    (broken / "iiwa14.c").unlink()
    code, _, err = run(capsys, "play", broken)
    assert (code, "iiwa14.c: is missing; generate the folder again" in err) == (2, True)
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = run(capsys, "play", robot_folder)
    assert code == 2
    assert "clang and wasm-ld not found" in err
    assert "apt-get install clang lld" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot"]


@pytest.mark.slow
def test_wheel_holds_the_page(tmp_path: Path) -> None:
    """Build the wheel: the page's files are in it."""
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    subprocess.run([*pip, "wheel", "--no-build-isolation", "--no-deps", "--wheel-dir", tmp_path, ROOT], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {f"stiffgen/lab/play/page/{file}" for file in (*page.SCRIPTS, "page.html", "style.css")} <= names


def test_functions_are_those_of_every_tip(scripts: Scripts) -> None:
    """Every kernel that the page calls is one of the robot's table, once for each tip, those of masses once."""
    assert len(scripts.data["functions"]) == len(page.KERNELS) * len(scripts.robot.chain.tips) + len(page.MASSES)


def test_a_planted_link_is_not_followed(robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever a name could be guessed: the file behind the link keeps its content."""
    monkeypatch.setattr(page, "page_text", lambda robot: "page")
    (tmp_path / "mine").write_text("mine")
    for name in (".play.html.part", "play.html"):
        (tmp_path / name).symlink_to(tmp_path / "mine")
    assert page.write_page(robot_folder, tmp_path / "play.html").read_text() == "page"
    assert (tmp_path / "mine").read_text() == "mine"
