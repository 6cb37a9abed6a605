# SPDX-License-Identifier: MIT
"""``stiffgen new``: the project builds, runs and passes its own test; what is ambiguous is asked, or refused."""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest

from stiffgen.cli import main
from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import describe
from stiffgen.core.robot.chain import Tool
from stiffgen.core.robot.description import Reading
from stiffgen.core.robot.reader import read_description
from stiffgen.lab.new.project import FILES, new_project
from stiffgen.lab.new.questions import Answers, decide
from support.c_program import STRICT
from support.chains import ARM, INERTIAL, chain_urdf, replaced
from support.project import ROOT, URDF, require_program

DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"
STIFFGEN = (sys.executable, "-m", "stiffgen.cli")


def asked(*answers: str):
    """Return a terminal that gives these answers, and the questions it was asked."""
    left, questions = list(answers), []

    def ask(question: str) -> str:
        questions.append(question)
        return left.pop(0)

    return ask, questions


def test_options_leave_friction_alone_to_ask():
    tool = Tool(xyz=(0.0, 0.0, 0.2))
    ask, questions = asked("")
    found = decide(read_description(DUAL), ask, tip="left hand", base="base", tool=tool, controller="impedance")
    assert found == Answers("left hand", "base", tool, "trace", "impedance")
    assert [question.split(":")[0] for question in questions] == ["Friction to feed forward"]


def test_the_only_tip_is_taken_and_empty_answers_are_the_defaults():
    assert decide(read_description(URDF), None) == Answers("link_ee", "link_0", None, "trace", "impedance")
    ask, questions = asked("", "", "", "")
    assert decide(read_description(URDF), ask) == Answers("link_ee", "link_0", None, "trace", "impedance")
    assert [question.split(":")[0].split("\n")[0] for question in questions] == [
        "Base link", "Tool", "Controller", "Friction to feed forward",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "file"), [("impedance", "src/control.hpp"), ("ros2", "config/controllers.yaml")]
)
def test_friction_is_asked_and_stated(tmp_path, controller, file):
    """Numbers for each joint, with commas or spaces; 0 without an answer."""
    for number, answers in enumerate((("3,2", "-1 2 2 1 1 1 1", "3, 2.5,2,1 1,0.5,0"), ("",))):
        ask, questions = asked(*answers)
        chosen = partial(decide, ask=ask, tip="link_ee", base="link_0", tool=Tool(), controller=controller)
        folder = new_project(URDF, chosen, output=tmp_path / str(number), build=False)
        stated = "3.0, 2.5, 2.0, 1.0, 1.0, 0.5, 0.0" if number == 0 else ", ".join(["0.0"] * 7)
        assert stated in (folder / file).read_text()
        assert "of 7 joints" in questions[0] and questions[1:] == ["7 numbers from 0 [N m or N], or nothing []"] * (
            len(answers) - 1
        )


def test_answers_are_taken_and_wrong_ones_asked_again():
    ask, questions = asked("middle hand", "right-hand", "", "up", "0 0 0.2", "robust", "spring", "quaternion")
    found = decide(read_description(DUAL), ask)
    assert found == Answers("right-hand", "base", Tool(xyz=(0.0, 0.0, 0.2)), "quaternion", "spring")
    assert "left hand: " in questions[0] and "'middle hand' is not one of them" in questions[1]
    assert "Three numbers" in questions[4] and "'robust' is not one of them: impedance, ros2, spring" in questions[6]


def test_another_spring_does_not_go_with_the_controller():
    with pytest.raises(StiffgenError, match=r"spring quaternion.*choose --controller spring=quaternion"):
        decide(read_description(URDF), None, spring="quaternion")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([str(DUAL)], "no terminal to ask at; choose one with --tip: left hand, right-hand"),
        (["nowhere.urdf"], "nowhere.urdf"),
        ([str(URDF), "--output", "taken"], "taken: exists, and a project is never overwritten; choose another"),
        ([str(URDF), "--tip", "link_9"], "link_9"),
        ([str(URDF), "--name", "int"], "nearest: --name robot_int"),
        ([str(ROOT / "tests" / "data" / "solo12.urdf"), "--tip", "FL_FOOT", "--base", "nothing"], "nothing"),
        ([str(URDF), "--tool", "mass=-1"], "mass"),
        ([str(URDF), "--no-masses", "--controller", "impedance"], "--controller impedance needs masses"),
    ],
)
def test_bad_input_is_one_message_and_leaves_nothing(arguments, named, tmp_path, monkeypatch, capsys):
    """Give what no project can be made of: exit code 2, one message, and no folder."""
    (tmp_path / "taken").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(["new", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and named in captured.err
    assert captured.err.splitlines()[-1].startswith("stiffgen: ")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"] and not list((tmp_path / "taken").iterdir())


@pytest.mark.slow
def test_without_masses_and_a_fault_of_inertia(tmp_path, capsys):
    """Make a project of a faulty inertia: named before any question; without masses it is made."""
    faulty = tmp_path / "faulty.urdf"
    faulty.write_text(re.sub(r'izz="[^"]*"', 'izz="9"', URDF.read_text()))
    for tip in ([], ["--tip", "link_ee"]):
        assert main(["new", str(faulty), *tip, "--output", str(tmp_path / "out")]) == 2
        assert "only with --no-masses: link 'link_1'" in capsys.readouterr().err
    assert main(["new", str(faulty), "--no-masses", "--no-build", "--output", str(tmp_path / "out")]) == 0
    assert "mass_matrix" not in (tmp_path / "out" / "src" / "simulated_robot.hpp").read_text()
    assert "--no-masses" in regenerate((tmp_path / "out" / "README.md").read_text())


def test_elements_to_ignore_stand_in_the_readmes_command(tmp_path, capsys):
    """The command generates the functions again, without a word about an element that is to be ignored."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(replaced(('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axles/>')))
    options = ("--ignore", "axles", "--tip", "hand", "--no-build", "--output", str(tmp_path / "out"))
    assert main(["new", str(urdf), *options]) == 0
    assert "--ignore axles" in regenerate((tmp_path / "out" / "README.md").read_text())


@pytest.mark.slow
def test_a_template_takes_its_files_with_it(tmp_path):
    """Make a project of a template: its files come with it, and regenerate the same robot."""
    (tmp_path / "arms" / "urdf").mkdir(parents=True)
    (tmp_path / "arms" / "package.xml").write_text("<package><name>arms</name></package>")
    (tmp_path / "arms" / "part.xacro").write_text(chain_urdf("rrr"))
    template = tmp_path / "arms" / "urdf" / "arm.urdf.xacro"
    template.write_text('<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                        '<xacro:include filename="$(find arms)/part.xacro"/></robot>')  # fmt: skip
    reading = Reading(arguments={"name": "arm"})
    project = new_project(template, reading=reading, output=tmp_path / "project", build=False)
    words = regenerate((project / "README.md").read_text()).split()
    assert words[2:4] == ["urdf/urdf/arm.urdf.xacro", "name:=arm"]
    copy = describe(project / words[2], reading)
    assert copy == describe(template, reading)


@pytest.mark.slow
def test_licences_go_with_the_copies(tmp_path):
    """Copy files with their licences: from beside or above, up to the package, and nothing outside."""
    (tmp_path / "LICENSE").write_text("of somebody else")
    package = tmp_path / "arms"
    (package / "urdf").mkdir(parents=True)
    urdf = package / "urdf" / "arm.urdf"
    urdf.write_text(chain_urdf("rrr"))

    def copied(output):
        project = new_project(urdf, output=tmp_path / output, build=False)
        return {path.name for path in (project / "urdf").iterdir()}, (project / "README.md").read_text()

    names, readme = copied("none")
    assert names == {"arm.urdf"} and "ask its maker before you pass them on" in readme
    (package / "package.xml").write_text("<package><license>BSD</license><license file='x'>MIT</license></package>")
    assert "(package.xml names BSD, MIT)" in copied("stated")[1]
    (package / "COPYING.txt").write_text("text")
    (package / "NOTICE").write_text("text")
    (package / "LICENSED_PARTS.md").write_text("text")
    assert copied("above")[0] == {"arm.urdf", "COPYING.txt", "NOTICE"}
    (package / "urdf" / "arm.LICENSE").write_text("text")
    (package / "urdf" / "leg.LICENSE").write_text("text")
    (package / "urdf" / "arm.urdf.license").write_text("text")
    assert copied("own")[0] == {"arm.urdf", "arm.LICENSE", "arm.urdf.license"}


def test_names_with_ends_of_lines_and_html(tmp_path):
    """Name parts with line ends and HTML: the README and a shell take them as text."""
    tip = "a\n\n<script>alert(1)</script>\n    rm -rf 'x'\\é\x7f"
    urdf = tmp_path / b"x\xff\n<b>.urdf".decode("utf-8", "surrogateescape")
    escaped = escape(tip, {"\n": "&#10;", "'": "&apos;"})
    urdf.write_text(chain_urdf("rrr").replace('"l3"', f'"{escaped}"'), encoding="utf-8")
    assert escaped in urdf.read_text(encoding="utf-8")
    project = new_project(urdf, output=tmp_path / "project", build=False)
    readme = (project / "README.md").read_text(encoding="utf-8")
    assert readme.isascii() and "<script" not in readme.replace(regenerate(readme), "")
    assert not re.search(r"^\s*(<|rm)", readme, re.MULTILINE)
    command = regenerate(readme).replace("stiffgen generate", "printf '%s\\0'")
    words = subprocess.run(["bash", "-c", command], capture_output=True, check=True).stdout.split(b"\0")
    assert words[words.index(b"--tip") + 1] == tip.encode()
    assert os.fsdecode(words[0]) == f"urdf/{urdf.name}" and (project / os.fsdecode(words[0])).is_file()


ARMATURE = """<mujoco><worldbody><body name="one"><inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.02"/>
  <joint name="a" axis="0 0 1" range="-90 90" armature="0.04" actuatorfrcrange="-20 20"/><body name="two" pos="0.2 0 0">
  <inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.02"/>
  <joint name="b" axis="0 1 0" range="-90 90" armature="0.03" actuatorfrcrange="-20 20"/>
  </body></body></worldbody></mujoco>
"""


@pytest.mark.slow
def test_rotors_are_those_of_the_generated_controller(tmp_path):
    """Make projects: the configuration states the header's rotor inertia and where it is from."""
    without_limit = tmp_path / "without.urdf"
    without_limit.write_text(replaced((' effort="20" velocity="4"', "")))
    armature = tmp_path / "armature.xml"
    armature.write_text(ARMATURE)
    cases = {
        "panda": (ROOT / "tests" / "data" / "panda.urdf", "panda_hand", set()),
        "arm": (without_limit, "finger", {1}),
        "armature": (armature, "two", set()),
    }
    for name, (file, tip, guessed) in cases.items():
        options = {"name": name, "output": tmp_path / name, "build": False}
        project = new_project(file, lambda found, tip=tip: decide(found, tip=tip), **options)
        control = (project / "src" / "control.hpp").read_text()
        robot = (project / "src" / "simulated_robot.hpp").read_text()
        header = (project / "generated" / name / f"{name}_impedance.h").read_text()
        said = re.search(r"motor_inertia of this robot, to be stated: (.*)", header)
        rotors = numbers_of("ROTORS = ", robot)
        assert said and "(config.motor_inertia, ROTORS)" in control
        expected = [0.005 * 100.0 / 2.0 if k in guessed else float(each) for k, each in enumerate(said[1].split(", "))]
        assert rotors == expected and all(rotors), name
    panda = (tmp_path / "panda" / "src" / "simulated_robot.hpp").read_text()
    assert "stated by Franka" in panda and "0.605721456" in panda
    assert numbers_of("ROTORS = ", (tmp_path / "armature" / "src" / "simulated_robot.hpp").read_text()) == [0.04, 0.03]


def numbers_of(before: str, text: str) -> list[float]:
    """Return the numbers of the first initialiser behind a pattern."""
    found = re.search(before + r"\{([^}]*)\}", text)
    assert found, before
    return [float(each) for each in found[1].split(",")]


def regenerate(readme: str) -> str:
    """Return the README's command that generates the functions again."""
    found = re.search(r"^    (stiffgen generate .*)$", readme, re.MULTILINE)
    assert found
    return found[1]


@pytest.mark.slow
def test_a_signal_leaves_nothing(tmp_path):
    """Stop `new` by SIGTERM: its exit code, and no folder."""
    process = subprocess.Popen([*STIFFGEN, "new", str(URDF)], cwd=tmp_path, stdin=subprocess.DEVNULL)
    while process.poll() is None and not any(tmp_path.iterdir()):
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    assert process.wait() == 128 + signal.SIGTERM
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_questions_at_a_terminal(tmp_path):
    """Answer the questions of `new` at a terminal: the tool's origin ends up in the header."""
    (tmp_path / "arm.urdf").write_text(ARM)  # the hand is no leaf, and its finger one
    ours, theirs = pty.openpty()
    command = [*STIFFGEN, "new", "arm.urdf", "--no-build"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    os.close(theirs)
    os.write(ours, b"\n0 0 0.1\n\n\n")
    out, err = process.communicate()
    os.close(ours)
    assert (process.returncode, out.strip()) == (0, "arm_control"), err
    assert "Tool: its origin in the axes of finger" in err
    assert "xyz 0 0 0.1 m" in (tmp_path / "arm_control" / "generated" / "arm" / "arm.h").read_text()


PROJECTS = {
    "iiwa14": [str(URDF)],
    "sliding": ["sliding.urdf", "--tool", "xyz=0,0.05,0.1", "--tool", "mass=0.5"],
    "dual": [str(DUAL), "--tip", "left hand", "--controller", "spring=quaternion"],
    "coupled": ["sliding.urdf", "--name", "coupled", "--controller", "spring=coupled"],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=() if case == "iiwa14" else pytest.mark.wide) for case in PROJECTS],
)
def test_the_project_builds_runs_and_passes_its_own_test(case, tmp_path):
    """As its README says, and without a warning."""
    (tmp_path / "sliding.urdf").write_text(chain_urdf("rprrmr"))
    # What no project may depend on: where stiffgen lies.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | {"CFLAGS": "-O0"}

    def run(*command: str, cwd: Path) -> str:
        known = os.environ if command[0] == sys.executable and "stiffgen.cli" in command else environment
        done = subprocess.run(
            command, cwd=cwd, env=dict(known), capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    project = tmp_path / run(*STIFFGEN, "new", *PROJECTS[case], "--output", "project", cwd=tmp_path).strip()
    (name,) = (folder.name for folder in (project / "generated").iterdir())
    assert {str(f.relative_to(project)) for f in project.rglob("*") if f.is_file()} >= set(FILES)
    readme = (project / "README.md").read_text()
    assert {line.split("`")[1] for line in readme.splitlines() if line.startswith("| `")} <= {
        *FILES, f"generated/{name}",
    }  # fmt: skip
    commands = re.findall(r"^    (cmake .*|build/.*|ctest .*)$", readme, re.MULTILINE)
    assert len(commands) == 4
    strict = ["-DCMAKE_C_FLAGS_RELEASE=-O0", f"-DCMAKE_CXX_FLAGS_RELEASE=-O1 {' '.join(STRICT)}"]
    for command in commands:
        parts = command.split()
        if "/" not in parts[0]:
            require_program(parts[0], "cmake")
        more = strict if "-S" in parts else ["--fast"] if parts[0].startswith("build/") else []
        parts[0] = str(project / parts[0]) if "/" in parts[0] else parts[0]
        out = run(*parts, *more, cwd=project)
    assert "100% tests passed" in out

    Kq = run(sys.executable, "python/first_steps.py", cwd=project)
    assert "antisymmetric part: 0," in Kq
    first = re.search(r"^ \*   (cc .*)$", (project / "src" / "first_steps.c").read_text(), re.MULTILINE)
    assert first
    run(*first[1].split(), *STRICT, cwd=project)
    rows = run(str(project / "first_steps"), cwd=project).splitlines()
    in_c = np.array([[float(word) for word in row.split()[-len(rows) :]] for row in rows])
    assert np.array_equal(in_c, in_c.T) and np.abs(in_c).max() > 1.0
    numbers = re.findall(r"-?\d+\.\d*", Kq[: Kq.index("antisymmetric")].split("\n", 1)[1])
    np.testing.assert_allclose(in_c.ravel(), [float(number) for number in numbers], atol=1.1e-3)

    again = regenerate(readme)
    before = (project / "generated" / name / f"{name}.c").read_bytes()
    assert main_in(project, again) == 0
    assert (project / "generated" / name / f"{name}.c").read_bytes() == before


def main_in(folder: Path, command: str) -> int:
    done = subprocess.run([*STIFFGEN, *shlex.split(command)[1:], "--no-build"], cwd=folder, check=False)
    return done.returncode


def test_new_and_generate_choose_tips_alike(tmp_path, capsys):
    """One of two leaves cannot be the tip for its inertia: neither command chooses the other one silently."""
    leg = (
        f'<link name="leg">{INERTIAL}</link><joint name="hip" type="revolute"><parent link="base"/>'
        '<child link="leg"/></joint></robot>'
    )
    faulty = tmp_path / "two.urdf"
    faulty.write_text(replaced(("</robot>", re.sub(r'izz="[^"]*"', 'izz="9"', leg))))
    for command in ("new", "generate"):
        assert main([command, str(faulty), "--no-build", "--output", str(tmp_path / command)]) == 2
        assert "choose one with --tip: hand, finger" in capsys.readouterr().err


def test_a_mark_on_the_base_is_no_tip(tmp_path):
    """ROS-Industrial marks the base by a leaf of its own; a refusal of the only tip's masses comes first."""
    mark = '<link name="mark"/><joint name="m" type="fixed"><parent link="base"/><child link="mark"/></joint></robot>'
    text = replaced(("</robot>", mark))
    (tmp_path / "arm.urdf").write_text(text)
    assert decide(read_description(tmp_path / "arm.urdf")).tip == "finger"
    (tmp_path / "arm.urdf").write_text(text.replace('izz="0.03"', 'izz="9"'))
    with pytest.raises(StiffgenError, match=r"tip 'finger'.*--no-masses.*inertia"):
        decide(read_description(tmp_path / "arm.urdf"))
