# SPDX-License-Identifier: MIT
"""The command line: output, exit codes 0, 1 and 2, and messages without tracebacks."""

from __future__ import annotations

import errno
import inspect
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.cli import COMMANDS, main
from stiffgen.cli.parsing import CommandParser
from stiffgen.control.sessions import library, sessions
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.verify.result import Check
from stiffgen.rooms import is_there
from support.folders import restamp
from support.project import ROOT, URDF


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_inspect(capsys):
    code, out, err = run(capsys, "inspect", URDF)
    assert (code, err) == (0, "")
    assert "link_ee │ link_0 │ 7: A1, A2, A3, A4, A5, A6, A7" in out
    row = next(line for line in out.splitlines() if line.startswith("A4"))
    for cell in ("revolute", "0 -1 0", "-2.0944", "1.309", "176", "link_4", "4.123"):
        assert cell in row


def test_inspect_shows_every_problem(capsys, tmp_path):
    """Put several faults into a file: `inspect` lists all of them, not only the first one."""
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


@pytest.mark.slow
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
    """Name files, tips, bases and names that do not exist: exit code 2, and the remedy is named."""
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert named in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_no_command_shows_the_help(capsys):
    assert main([]) == 0
    assert "generate C code" in capsys.readouterr().out


def test_usage_errors_exit_with_2(capsys):
    for arguments in (["paint"], ["generate"], ["verify", "x", "--samples", "0"]):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
    capsys.readouterr()


@pytest.fixture
def few_sessions(monkeypatch):
    """Let verify run a sixth of its hostile sessions, without optimisation: for tests that do not look at these."""
    monkeypatch.setattr(sessions, "SESSIONS", sessions.SESSIONS // 6)
    monkeypatch.setattr(library, "CAREFUL", ("-O0", *library.CAREFUL[1:]))


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised", "narrowest_width", "few_sessions")
def test_verify(capsys, robot_folder):
    """Verify the iiwa 14 by the command: all comparisons pass, and each kind of oracle is listed."""
    code, out, err = run(capsys, "verify", robot_folder, URDF, "--samples", 20)
    assert code == 0
    assert re.search(r"(\d+) of \1 comparisons within their bound", out)
    for oracle in (
        "iiwa14.urdf, read again",
        "SHA-256 in the manifest",
        "stacks: lengths, order",
        "C: counts, steps, ends",
        "NaN and infinity in",
        "differentiated Jacobian",
        "Hessian of a potential",
        "body form, turned",
        "bitwise symmetry",
        "CasADi",
    ):
        assert oracle in out
    assert "comparing" in err


@pytest.mark.wide(instead="test_verify")
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
def test_verify_fails_on_a_wrong_kernel(capsys, robot_folder, tmp_path):
    """Turn one sign in the compiled C: the real command fails."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    source = (folder / "iiwa14.c").read_text()
    right = "A34 = K[3][4] + half_m2;"
    at = source.index(right, source.index("void iiwa14_hybrid_joint_stiffness("))
    (folder / "iiwa14.c").write_text(source[:at] + right.replace("+", "-") + source[at + len(right) :])
    for built in folder.rglob("*.so"):
        built.unlink()
    from stiffgen.core.emit.build import build_module

    build_module(folder, "iiwa14")
    restamp(folder)
    code, out, _ = run(capsys, "verify", folder, "--samples", 20)
    assert code == 1
    # FAILED, what is compared, and its oracle behind a comma.
    failed = set(re.findall(r"^FAILED ([^,]*),", out, re.MULTILINE))
    # The batch function has a body of its own, which the single one no longer agrees with; the controller's tangent is
    # compared with the module's stiffness, its steps with those on kernels of this generator.
    wrong = "hybrid_joint_stiffness"
    of_the_kernel = {f"{wrong}{rest}" for rest in ("", "_batch", "_packed", "_packed_batch")}
    assert wrong in failed
    assert failed <= of_the_kernel | {"controller: tangent", "controller: sessions", "text"}


def test_a_nan_fails_a_check():
    assert not Check("kernel", "oracle", float("nan"), 1e-12).passed


def test_installed_command():
    command = [sys.executable, "-m", "stiffgen.cli", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.startswith("stiffgen ")


LONG = "a" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ["generate", URDF, "--no-build", "--output", LONG],
        ["generate", f"{LONG}.urdf"],
        ["inspect", LONG],
        ["verify", LONG],
        ["analyze", f"{LONG}.csv", "--robot", LONG, "--task-stiffness", *"111111"],
    ],
)
def test_a_name_too_long_for_the_file_system(capsys, tmp_path, monkeypatch, arguments):
    """Give names beyond the file system's length: exit code 2, one message, no file and no traceback."""
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.splitlines()[-1].startswith("stiffgen: ") and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["generate", URDF, "--name", "a", "--name", "b"], "--name is given twice"),
        (["generate", URDF, "--cuda", "--cuda"], "--cuda is given twice"),
        (["generate", URDF, "--scalar", "float", "--scalar", "double"], "--scalar is given twice"),
        (["verify", "x", "--samples", "1", "--samples", "1"], "--samples is given twice"),
        (["analyze", "x", "--robot", "x", "--robot", "y", "--task-stiffness", "1"], "--robot is given twice"),
        (["generate", URDF, "--lock", "A1=-0,5"], "'A1=-0,5': VALUE is a number [rad or m]; write -0.5"),
        (["generate", URDF, "--lock", "A1=90deg"], "'A1=90deg': VALUE is a number [rad or m]"),
        (["generate", URDF, "--tool", "mass=1,5"], "'mass=1,5': mass is a number; write 1.5"),
    ],
)
def test_an_option_given_twice_or_without_a_number_is_refused(capsys, arguments, named):
    """Give an option twice or a comma as decimal point: exit code 2, and the option is named."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert stopped.value.code == 2
    assert named in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--lock", "A1=0", "--lock", "A1=1"], "'A1' twice"),
        (["--no-masses", "--tool", "mass=1"], "--no-masses"),
        (["--sensor", "xyz=0,0,1"], "--sensor xyz=... without its link; add --sensor LINK"),
        (["--sensor", "link_ee", "--sensor", "link_7"], "'link' twice"),
        (["--sensor", "link_ee", "--sensor", "sign=both"], "--sensor sign=both is not one of environment, robot"),
        (["--sensor", "link_5"], "a joint lies between the --sensor link 'link_5' and tip link_ee"),
        (["--tool", "xyz=0,0,0", "--tool", "xyz=0,0,1"], "'xyz' twice"),
        (["--placement", "centre=0,0,inf"], "three finite numbers"),
        (["--placement", "rotation_axes=flange"], "base, tip, equilibrium"),
        (["--range", "force=-1"], "range force=-1.0: must be a positive number"),
        (["--name", "numpy"], "--name robot_numpy"),
        (["--name", "stddef"], "--name robot_stddef"),
    ],
)
def test_options_that_contradict_are_refused(capsys, tmp_path, options, named):
    """Give contradicting options: exit code 2, the option is named, and no folder is written."""
    code, out, err = run(capsys, "generate", URDF, "--no-build", "--output", tmp_path, *options)
    assert (code, out) == (2, "")
    assert named in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_another_robot_in_the_folder_is_refused(capsys, tmp_path):
    """Generate another q, tip or tool into the same folder: refused, and the files stay as they were."""
    small = ("--kernels", "limits", "--no-controller", "--no-batches")
    generate = ("generate", URDF, "--no-build", "--output", tmp_path, *small)
    assert run(capsys, *generate)[0] == 0
    before = (tmp_path / "iiwa14" / "iiwa14.h").read_text()
    assert run(capsys, *generate, "--tool", "mass=1")[0] == 0  # the same q, frames and arguments
    for options, named in (
        (["--lock", "A3=0"], ("A1, A2, A3", "A1, A2, A4")),
        (["--tip", "link_6"], ("link_ee", "link_6")),
        (["--tool", "runtime"], ("tool_pose",)),
    ):
        shutil.rmtree(tmp_path / "iiwa14")
        assert run(capsys, *generate)[0] == 0
        code, out, err = run(capsys, *generate, *options)
        assert (code, out) == (2, "")
        assert "remove it first" in err and all(name in err for name in named)
        assert (tmp_path / "iiwa14" / "iiwa14.h").read_text() == before
    stiffgen.generate(URDF, output=tmp_path, build=False, force=True, tip="link_6")
    assert (tmp_path / "iiwa14" / "iiwa14.h").read_text() != before


def stiffgen_process(*arguments, **options):
    command = [sys.executable, "-m", "stiffgen.cli", *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "unbuffered"),
    [
        (["--help"], ""),
        (["inspect", URDF], "1"),
        pytest.param(["--help"], "1", marks=pytest.mark.wide),
        pytest.param(["inspect", URDF], "", marks=pytest.mark.wide),
    ],
    ids=["help", "inspect, unbuffered", "help, unbuffered", "inspect"],
)
def test_standard_output_that_cannot_be_written(arguments, unbuffered, monkeypatch):
    """Write to a full disk, a closed pipe and a closed output: no traceback, and exit codes as other programs have."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    reading, writing = os.pipe()
    os.close(reading)
    with Path("/dev/full").open("w") as full:
        processes = [stiffgen_process(*arguments, stdout=output) for output in (full, writing)]
    os.close(writing)
    processes.append(stiffgen_process(*arguments, stdout=subprocess.DEVNULL, preexec_fn=lambda: os.close(1)))
    piped = processes.pop(1)  # as into head
    assert (piped.communicate()[1], piped.returncode) == ("", 128 + signal.SIGPIPE)
    for process in processes:
        error = process.communicate()[1]
        assert process.returncode == 2, error
        assert error.startswith("stiffgen: standard output: ") and len(error.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGTERM") or os.name == "nt", reason="no POSIX signals")
def test_a_signal_leaves_nothing_behind(tmp_path):
    """While the compiler runs: neither folders nor the compiler stay."""
    compiler = tmp_path / "slow-cc"
    compiler.write_text('#!/bin/sh\ncase "$*" in *_python.c*) echo $$ > "$0.pid"; sleep 600;; esac\nexec cc "$@"\n')
    compiler.chmod(0o755)
    output, temporary = tmp_path / "new" / "out", tmp_path / "tmp"
    temporary.mkdir()
    process = stiffgen_process(
        "generate", URDF, "--output", output, env=os.environ | {"CC": str(compiler), "TMPDIR": str(temporary)}
    )
    pid = tmp_path / "slow-cc.pid"
    while not (pid.exists() and pid.read_text().strip()):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    error = process.communicate()[1]
    assert process.returncode == 128 + signal.SIGTERM
    assert error.splitlines()[-1] == "stiffgen: ended by SIGTERM"
    assert not (tmp_path / "new").exists()
    assert list(temporary.iterdir()) == []
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


@pytest.mark.slow
def test_a_full_disk(capsys, tmp_path, monkeypatch):
    """Let each write fail for lack of room: exit code 2, the reason, and nothing left behind."""

    def full(self, *arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))

    monkeypatch.setattr("pathlib.Path.write_text", full)
    code, out, err = run(capsys, "generate", URDF, "--no-build", "--output", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "No space left on device" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("name", [
    "a; b\nc\\d $HOME (\"e\") '#", *(pytest.param(name, marks=pytest.mark.wide) for name in
    ("semi;colon", "new\nline", "back\\slash", "sp ace $HOME", '(paren) "quote" #')),
])  # fmt: skip
def test_any_character_in_the_output_folder(tmp_path, name):
    """Build in a folder with unusual characters: compiler and Python get the path as it is."""
    robot = tmp_path / "one.urdf"
    robot.write_text(
        '<robot name="one"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    folder = stiffgen.generate(robot, output=tmp_path / name)
    assert folder == tmp_path / name / "one"
    assert open_robot(folder).module.forward_kinematics([0.0]).shape == (4, 4)


@pytest.mark.parametrize("damage", ["{", "[]", '{"generator": "stiffgen", "files": {}}', "no text \\0"])
def test_a_damaged_manifest_is_one_sentence(damage, capsys, robot_folder, tmp_path):
    """Damage the manifest: exit code 2 and one line that names the file."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    (folder / "manifest.json").write_text(damage)
    code, _, err = run(capsys, "verify", folder)
    assert code == 2
    assert err.count("\n") == 1
    assert "manifest.json" in err


def test_a_negative_seed_is_refused(capsys, robot_folder):
    with pytest.raises(SystemExit) as refused:
        main(["verify", str(robot_folder), "--samples", "5,-1"])
    assert refused.value.code == 2
    assert "--samples: must not be negative" in capsys.readouterr().err


def test_the_keywords_of_python_are_the_fields_of_the_records():
    """A call shows its keywords and their meanings; a field of the chain is one of all three."""
    for call, record in ((stiffgen.load_chain, ChainOptions), (stiffgen.generate, stiffgen.GenerationOptions)):
        names = [each.name for each in fields(record)]
        assert list(inspect.signature(call).parameters) == ["urdf", *names]
        assert all(f"        {name}: " in call.__doc__ for name in names)
    assert stiffgen.load_chain(URDF, arguments=None, lock=None).dof == 7


def test_commands_and_options_stay_few():
    """Count commands (10), options of ``generate`` (30) and of all (91): no more, each under a heading."""
    counts, titles = {}, []
    for name, (module, _) in COMMANDS.items():
        if is_there(module):
            command = CommandParser(prog=name)
            import_module(f"stiffgen.{module}").add(command)
            counts[name] = sum(bool(action.option_strings) for action in command._actions) - 1  # --help
            if name == "generate":
                titles = [group.title for group in command._action_groups if group._group_actions]
    assert len(counts) <= 10 and counts["generate"] <= 30 and sum(counts.values()) <= 91, counts
    assert titles == ["positional arguments", "options", "robot", "frames", "springs", "tool", "output"]
