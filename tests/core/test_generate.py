# SPDX-License-Identifier: MIT
"""Writing a robot's folder: same bytes, swapped in whole or not at all, movable, and never over foreign files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

import stiffgen
from stiffgen.control.companions import COMPANIONS
from stiffgen.core.emit.render import render
from stiffgen.core.errors import BuildError, OutputError, StiffgenError
from stiffgen.core.manifest import chain_from_manifest
from support.generated_c import kernel_text
from support.project import ROOT, URDF

FILES = {
    "iiwa14.h", "iiwa14.hpp", "iiwa14_lanes.h", "iiwa14.c", "iiwa14_batch.c", "iiwa14_dispatch.c",
    "iiwa14_impedance.h", "iiwa14_impedance.c", "iiwa14_sensor.h",
    "CMakeLists.txt", "__init__.py", "__init__.pyi", "py.typed", "README.md", "pyproject.toml",
    "manifest.json", "python/iiwa14_python.c", "python/_structs.py",
    "python/impedance.py", "python/impedance.pyi",
    "python/casadi.py", "python/jax.py", "python/torch.py",
    *(f"iiwa14_{name}.{ending}" for name in COMPANIONS for ending in ("h", "c")),
    *(f"python/{name}.{ending}" for name in COMPANIONS for ending in ("py", "pyi")),
}  # fmt: skip


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def listing(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


SMALL = {"kernels": "hybrid.jacobian", "controller": False, "masses": False}


@pytest.fixture(scope="module")
def rendered(chain):
    return render(chain, "iiwa14")


def test_same_bytes_in_another_process_and_place(rendered, tmp_path):
    """Another hash seed, working directory and output path."""
    code = f"import stiffgen; stiffgen.generate({str(URDF)!r}, output='deep/er', build=False)"
    environment = {
        "PYTHONHASHSEED": "12345",
        "PYTHONPATH": str(ROOT / "codegen"),
        "PATH": "/usr/bin:/bin",
        "LC_ALL": "C",
    }
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=environment)
    folder = tmp_path / "deep" / "er" / "iiwa14"
    written = {name: (folder / name).read_text(encoding="utf-8") for name in files(folder)}
    assert written == rendered


def test_committed_folder_is_up_to_date(rendered):
    committed = ROOT / "generated" / "iiwa14"
    for file, text in rendered.items():
        assert (committed / file).read_text(encoding="utf-8") == text, f"run 'make generate': iiwa14/{file} differs"


def test_files(robot_folder):
    built = files(robot_folder) - FILES
    assert [name.split(".")[0] for name in built if "__pycache__" not in name] == ["python/iiwa14_python"]


def test_no_traces_of_the_machine(rendered):
    for file, text in rendered.items():
        assert str(ROOT) not in text, file
        assert "/home" not in text and "/tmp" not in text and "http" not in text, file


def test_manifest(chain, robot_folder):
    manifest = json.loads((robot_folder / "manifest.json").read_text())
    assert manifest["urdf"] == {"file": "iiwa14.urdf", "sha256": chain.digest}
    assert set(manifest["versions"]) == {"stiffgen", "casadi", "sympy", "mpmath", "Jinja2"}
    assert manifest["kernels"]["hybrid_joint_stiffness"]["signature"] == "(7),(6),(6,6)->(7,7)"
    assert manifest["kernels"]["hybrid_joint_stiffness"]["operations"]["total"] > 500
    assert chain_from_manifest(manifest) == chain


def test_sine_and_cosine_once_a_joint(robot_folder):
    """Count sines in each function: one call for all joints, each angle once."""
    source = kernel_text(robot_folder, "iiwa14")
    kernels = source[source.index("\n}\n", source.index("void sine_cosine(")) :]
    found = 0
    for body in kernels.split("\n}\n"):
        if "int iiwa14_self_check(" in body:
            continue
        calls = body.count("sine_cosine(")
        found += calls
        assert calls <= 1
        assert "sin(" not in body and "cos(" not in body
        if calls:
            angles = body[body.index("angle[") : body.index("sine_cosine(")]
            assert all(angles.count(f"q[{joint}]") <= 1 for joint in range(7))
    # The columns of three representations, those with the pose, those of gravity; mass matrix, bias forces, pose and
    # static torque: all of them for single calls and in batches.
    assert found == 2 * 9


def test_moved_folder_imports(robot_folder, tmp_path):
    shutil.copytree(robot_folder, tmp_path / "elsewhere" / "arm")
    code = "import arm, numpy; print(arm.hybrid.jacobian(numpy.zeros(7)).shape)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path / "elsewhere", capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "(6, 7)"


def test_unbuilt_folder_says_what_to_do(tmp_path):
    stiffgen.generate(URDF, output=tmp_path, build=False, **SMALL)
    done = subprocess.run(
        [sys.executable, "-c", "import iiwa14"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "make generate" in done.stderr


def umask() -> int:
    """Return the process's mask of permissions, which only setting it tells."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def test_regenerating_replaces_the_folder(tmp_path):
    """Generate over an edited folder: exactly the files of a fresh one, with the permissions of any new folder."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(ROOT / "generated" / "iiwa14", folder, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    (folder / "iiwa14.c").write_text("edited")
    (folder / "python" / "iiwa14_python.cpython-00.so").write_text("old build")
    assert stiffgen.generate(URDF, output=tmp_path, build=False) == folder
    assert files(folder) == FILES
    assert [path.name for path in tmp_path.iterdir()] == ["iiwa14"]
    assert folder.stat().st_mode & 0o777 == 0o777 & ~umask()


@pytest.mark.parametrize("content", [{}, {"notes.txt": "mine"}, {"manifest.json": "{}"}, {"manifest.json": "[1]"}])
def test_foreign_folders_are_never_overwritten(content, tmp_path):
    """Generate over a folder of the user: refused, and nothing in it changes."""
    target = tmp_path / "iiwa14"
    target.mkdir()
    for file, text in content.items():
        (target / file).write_text(text)
    before = listing(tmp_path)
    with pytest.raises(OutputError, match="not written by stiffgen"):
        stiffgen.generate(URDF, output=tmp_path, build=False)
    assert listing(tmp_path) == before


def test_a_users_file_in_a_generated_folder_is_kept(tmp_path):
    folder = stiffgen.generate(URDF, output=tmp_path, build=False, **SMALL)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        stiffgen.generate(URDF, output=tmp_path, build=False, **SMALL)
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_link_or_file_in_the_way(tmp_path):
    (tmp_path / "target").mkdir()
    (tmp_path / "iiwa14").symlink_to(tmp_path / "target")
    with pytest.raises(OutputError, match="not a folder"):
        stiffgen.generate(URDF, output=tmp_path, build=False)
    assert listing(tmp_path / "target") == []


@pytest.mark.parametrize("existing", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_failing_compiler_leaves_nothing_behind(existing, tmp_path, monkeypatch):
    """Let the compiler fail: its words are shown, and the folder stays as it was."""
    output = tmp_path / "out"
    if existing:
        stiffgen.generate(URDF, output=output, build=False, **SMALL)
        (output / "iiwa14" / "iiwa14.c").write_text("as it was")
    before = listing(tmp_path)
    broken = tmp_path / "broken-cc"
    broken.write_text(
        "#!/bin/sh\n"
        "for a in \"$@\"; do case $a in *iiwa14.c) echo 'my last words' >&2; exit 3;; esac; done\n"
        'exec cc "$@"\n'
    )
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(BuildError, match="my last words"):
        stiffgen.generate(URDF, output=output, **SMALL)
    broken.unlink()
    assert listing(tmp_path) == before


def test_a_missing_compiler_is_named(tmp_path, monkeypatch):
    """Generate without a C compiler: refused with the variable to set and the option to build later."""
    monkeypatch.setenv("CC", "no-such-cc")
    with pytest.raises(BuildError, match=r"no-such-cc.*set CC.*build=False"):
        stiffgen.generate(URDF, output=tmp_path, **SMALL)
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError, match="no C compiler"):
        stiffgen.generate(URDF, output=tmp_path, **SMALL)
    assert listing(tmp_path) == []


@pytest.mark.slow
def test_own_flags_come_last(tmp_path, monkeypatch):
    """Give flags with the compiler and in CFLAGS: the first come before the build's -O3, the second behind it."""
    seen = tmp_path / "seen"
    compiler = tmp_path / "compiler"
    compiler.write_text(f'#!/bin/sh\necho "$@" >> {seen}\nexec gcc "$@" -O0\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", f"{compiler} -DFIRST")
    monkeypatch.setenv("CFLAGS", "-O2 '-DOWN=a b'")
    stiffgen.generate(URDF, output=tmp_path / "generated", **SMALL)
    made = [line for line in seen.read_text().splitlines() if "-march=native -c" not in line or "-O3" in line]
    assert all(any(source in line for line in made) for source in ("iiwa14.c", "iiwa14_python.c", "self_check.c"))
    for line in made:
        assert line.index("-DFIRST") < line.index("-O3") < line.index("-O2") < line.index("-DOWN=a b")


@pytest.mark.parametrize("name", ["9arm", "a b", "../up", "", "double", "x/y", "a" * 60, "ärm"])
def test_unusable_names_are_refused(name, tmp_path):
    with pytest.raises(StiffgenError, match="name="):
        stiffgen.generate(URDF, output=tmp_path, name=name, build=False)
    assert listing(tmp_path) == []


@pytest.mark.usefixtures("unoptimised")
def test_another_name_prefixes_everything(tmp_path):
    """Generate under another name: macros and functions have it as prefix, none the old one, and the module works."""
    folder = stiffgen.generate(URDF, output=tmp_path, name="left_arm", controller=False, batches=False)
    header = (folder / "left_arm.h").read_text()
    assert "LEFT_ARM_DOF 7" in header
    assert "left_arm_hybrid_joint_stiffness" in header
    assert "iiwa14_" not in header
    code = "import left_arm, numpy; print(left_arm.body.jacobian(numpy.zeros(7))[2, 0])"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_unwritable_output(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="output="):
        stiffgen.generate(URDF, output=tmp_path / "file", build=False, **SMALL)


USER_SCRIPT = """\
from typing import Any

import numpy as np
from numpy.typing import NDArray

import iiwa14

q, F, K = np.zeros(iiwa14.DOF), np.zeros(6), np.eye(6)
Kq: NDArray[np.float64] = iiwa14.hybrid.joint_stiffness(q, F, K)
Kq = iiwa14.body.joint_stiffness(q=q, wrench=[0, 0, 0, 0, 0, 1], task_stiffness=K, out=np.empty((7, 7)))
pose = iiwa14.forward_kinematics(q)
names: tuple[str, ...] = iiwa14.JOINTS
print(iiwa14.LOWER, iiwa14.TIP, iiwa14.hybrid.jacobian.signature, pose, names)
controller = iiwa14.Impedance(sample_time=0.001, delay_samples=0, motor_inertia=0.1, heaviest_wrench=(50, 9), record=5)
follow, port = iiwa14.Follow(q, sample_time=0.001), iiwa14.Policy(pose=pose, now=0.0, hold_time=0.2)
command = port.command(0.0)
q0 = follow.step(pose=command.pose).q0
Kt, Ko = command.translation_stiffness, command.rotation_stiffness
out = controller.step(q=q, dq=q, q0=q0, translation_stiffness=Kt, rotation_stiffness=Ko, counter=0, shaped=True)
posture: NDArray[np.float64] | None = iiwa14.find_posture(pose, q)
gains = iiwa14.joint_gains(q=q, dq=q, torque=q, joint_stiffness=Kq, damping=Kq, kp_limit=100.0, kd_limit=10.0)
work: float = iiwa14.late_work(q=q, q_des=q, tau_ff=q, kp=gains.kp, kd=gains.kd, velocity_limit=1.0, hold=0.1)
torque: NDArray[np.float64] = out.torque
if out.status & iiwa14.Status.MISSED:
    print(controller.config.sample_time)
wrong: str = iiwa14.hybrid.jacobian(q)  # ERROR
iiwa14.hybrid.joint_stifness(q, F, K)  # ERROR
iiwa14.hybrid.joint_stiffness(q, wrnch=F, task_stiffness=K)  # ERROR
iiwa14.hybrid.jacobian(q, otu=Kq)  # ERROR
iiwa14.Impedence()  # ERROR
iiwa14.Impedance(sample_tme=0.001)  # ERROR
iiwa14.Policy(pose=pose, now=0.0, hold=0.2)  # ERROR
port.command(0.0).poses  # ERROR
iiwa14.PolicyStage.MOVED  # ERROR
out.torqe  # ERROR
iiwa14.Status.MISED  # ERROR
controller.step(qq=q)  # ERROR
"""


@pytest.mark.slow
def test_mypy_finds_a_misspelt_name_and_nothing_else(robot_folder, tmp_path):
    """Strict, on a user's script beside the folder; the stubs themselves are clean, too."""
    shutil.copytree(robot_folder, tmp_path / "iiwa14")
    (tmp_path / "script.py").write_text(USER_SCRIPT)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "script.py", "iiwa14/__init__.pyi"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if ": error:" in line]
    wrong = [k for k, line in enumerate(USER_SCRIPT.splitlines(), 1) if line.endswith("# ERROR")]
    assert sorted({int(error.split(":")[1]) for error in errors if error.startswith("script.py")}) == wrong, done.stdout
    assert all(error.startswith("script.py") for error in errors), done.stdout


def test_an_old_compiled_module_is_not_used(robot_folder, tmp_path):
    """Sources made anew, for another tool, beside a module that was compiled before; and where that one is loaded."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    stiffgen.generate(URDF, output=tmp_path / "new", build=False, tool=stiffgen.Tool(xyz=(0, 0, 0.1)))
    code = (
        "import importlib, shutil, iiwa14\n"
        "shutil.copytree('new/iiwa14', 'iiwa14', dirs_exist_ok=True)\n"
        "importlib.reload(iiwa14)\n"
    )
    for each in (code, "import iiwa14"):
        command = [sys.executable, "-c", each]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "ImportError: iiwa14: its C module was compiled from other sources" in done.stderr
