"""The command line: output, exit codes 0, 1 and 2, and messages without tracebacks."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from stiffgen.check.verify import Check
from stiffgen.cli import main
from support.project import ROOT, URDF


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_inspect(capsys):
    code, out, err = run(capsys, "inspect", URDF)
    assert (code, err) == (0, "")
    assert "tips (leaf links): link_ee" in out
    row = next(line for line in out.splitlines() if line.startswith("A4"))
    for cell in ("revolute", "0 -1 0", "-2.0944", "1.309", "176", "link_4", "4.123"):
        assert cell in row


def test_inspect_shows_every_problem(capsys, tmp_path):
    text = (
        URDF.read_text()
        .replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>')
        .replace('mass value="4.', 'mass value="-4.')
    )
    urdf = tmp_path / "bad.urdf"
    urdf.write_text(text)
    code, out, _ = run(capsys, "inspect", urdf)
    assert code == 1
    assert "joint 'A2'" in out and "joint 'A6'" in out and "link 'link_4'" in out


def test_generate_prints_the_folder(capsys, tmp_path):
    code, out, err = run(capsys, "generate", URDF, "--output", tmp_path, "--no-build", "--tip", "link_ee")
    assert (code, out.strip()) == (0, str(tmp_path / "iiwa14"))
    assert "reading" in err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["generate", "no-such.urdf"], "no-such.urdf"),
        (["generate", URDF, "--tip", "hand"], "link_ee"),
        (["generate", URDF, "--base", "floor"], "link_0"),
        (["generate", URDF, "--tip", "link_0"], "link_ee"),
        (["generate", URDF, "--base", "link_ee", "--tip", "link_3"], "link_2"),
        (["generate", URDF, "--name", "1st"], "--name robot_1st"),
        (["verify", "no-such-folder"], "no-such-folder"),
        (["inspect", ROOT / "Makefile"], "Makefile"),
    ],
)
def test_refusals(capsys, tmp_path, monkeypatch, arguments, named):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert named in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_usage_errors_exit_with_2(capsys):
    for arguments in ([], ["paint"], ["generate"], ["verify", "x", "--samples", "0"]):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
    capsys.readouterr()


def test_verify(capsys, robot_folder):
    code, out, err = run(capsys, "verify", robot_folder, "--samples", 20)
    assert code == 0
    assert "53 of 53 comparisons within their bound" in out
    for oracle in (
        "differentiated Jacobian",
        "Hessian of a potential",
        "body form, turned",
        "bitwise symmetry",
        "CasADi",
    ):
        assert oracle in out
    assert "comparing" in err


def test_verify_fails_on_a_wrong_kernel(capsys, robot_folder, tmp_path):
    """One sign in the compiled C, then the real command."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    source = (folder / "iiwa14.c").read_text()
    right = "A[3][4] = K[3][4] + t0;"
    at = source.index(right, source.index("void iiwa14_hybrid_joint_stiffness("))
    (folder / "iiwa14.c").write_text(source[:at] + right.replace("+", "-") + source[at + len(right) :])
    for built in folder.glob("*.so"):
        built.unlink()
    from stiffgen.emit.build import build_module

    build_module(folder, "iiwa14")
    code, out, _ = run(capsys, "verify", folder, "--samples", 20)
    assert code == 1
    failed = [line for line in out.splitlines() if "FAILED" in line]
    # The batch function has a body of its own, which the single one no longer agrees with.
    assert failed and all(
        line.startswith(("hybrid_joint_stiffness ", "hybrid_joint_stiffness_batch ")) for line in failed
    )


def test_bench(capsys, robot_folder):
    code, out, err = run(capsys, "bench", robot_folder)
    assert code == 0
    rows = [line for line in out.splitlines() if "joint_stiffness " in line]
    assert len(rows) == 3
    for row in rows:
        _, call, configuration = (cell.strip() for cell in row.split("│"))
        assert 0 < float(configuration) < 10 * float(call)
    assert "timing hybrid_joint_stiffness" in err


def test_bench_of_another_folder_is_refused(capsys, tmp_path):
    code, _, err = run(capsys, "bench", tmp_path)
    assert code == 2
    assert "stiffgen generate" in err


def test_a_nan_fails_a_check():
    assert not Check("kernel", "oracle", float("nan"), 1e-12).passed


def test_installed_command():
    command = [sys.executable, "-m", "stiffgen.cli", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.startswith("stiffgen ")
