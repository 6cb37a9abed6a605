# SPDX-License-Identifier: MIT
"""Templates that try to run programs, to read files outside their packages, or to take for ever: one clear sentence."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import describe

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
ARM = """<link name="base"/><link name="{}"/><joint name="j" type="revolute"><parent link="base"/><child link="{}"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
TO_SYSTEM = (
    "[L.append((L[0].gi_frame.f_back.f_back.f_back.f_builtins['__import__']('os')"
    ".system('touch escaped') for _ in [1])) or list(L[0])[0] for L in [[]]][0]"
)


def template(*parts: str, name: str = "a") -> str:
    return f'<robot {XACRO} name="arm">{"".join(parts)}{ARM.format(name, name)}</robot>'


def prop(value: str, more: str = "") -> str:
    return f"""<xacro:property name="x" value="{value}" {more}/>"""


USED = "x${x}"
ESCAPES = {
    "frames of a generator": template(prop(f"${{{TO_SYSTEM}}}"), name=USED),
    "at the definition": template(prop(f"${{{TO_SYSTEM}}}", 'lazy_eval="false"')),
    "global scope": template(prop(f"${{{TO_SYSTEM}}}", 'scope="global"')),
    "in the name of a property": template(f'<xacro:property name="${{{TO_SYSTEM}}}" value="1"/>'),
    "in a condition": template(f'<xacro:if value="${{{TO_SYSTEM}}}"/>'),
    "default of a macro": template(
        f'<xacro:macro name="m" params="p:=${{{TO_SYSTEM}}}"><link name="${{p}}"/></xacro:macro><xacro:m/>'),
    "parameter of a macro": template(
        f'<xacro:macro name="m" params="p"><link name="${{p}}"/></xacro:macro><xacro:m p="${{{TO_SYSTEM}}}"/>'),
    "name of a macro": template(f'<xacro:call macro="${{{TO_SYSTEM}}}"/>'),
    "default of an argument": template(f'<xacro:arg name="a" default="${{{TO_SYSTEM}}}"/>', name="x$(arg a)"),
    "argument as an expression": template(
        f'<xacro:arg name="a" default="{TO_SYSTEM}"/>', prop("${$(arg a)}"), name=USED),
    "eval": template(name="$(eval ().__class__)"),
    "eval without underscores": template(name="$(eval [g.gi_frame.f_back for g in [0]])"),
    "format": template(prop("${'{0.__globals__}'.format(xacro.load_yaml)}"), name=USED),
    "lambda": template(prop("${(lambda f: f.__globals__)(xacro.load_yaml)}"), name=USED),
    "library by a function": template(prop("${xacro.load_yaml.__globals__['os'].system('touch escaped')}"), name=USED),
    "tables of the namespace": template(prop("${xacro.parent}"), name=USED),
    "python tag of YAML": template(prop("${xacro.load_yaml('tag.yaml')}"), name=USED),
    "unit of YAML": template(prop("${xacro.load_yaml('unit.yaml')}"), name=USED),
    "comment": template(f"<!-- xacro:eval-comments --><!-- ${{{TO_SYSTEM}}} -->"),
    "password file": template('<xacro:include filename="/etc/passwd"/>'),
    "file outside": template('<xacro:include filename="../outside/secret.xacro"/>'),
    "file outside, by the package": template('<xacro:include filename="$(find arm)/../outside/secret.xacro"/>'),
    "file outside, by a link": template('<xacro:include filename="link.xacro"/>'),
    "files outside, by a pattern": template('<xacro:include filename="../outside/*.xacro"/>'),
    "files outside, behind a pattern": template('<xacro:include filename="*/../../outside/*.xacro"/>'),
    "files outside, optional": template('<xacro:include filename="../outside/secret.xacro" optional="true"/>'),
    "YAML outside": template(prop("${xacro.load_yaml('../outside/secret.yaml')}"), name=USED),
    "package by a path": template('<xacro:include filename="$(find ../outside)/secret.xacro"/>'),
    "package by an absolute path": template('<xacro:include filename="$(find /etc)/passwd"/>'),
    "external entity": '<!DOCTYPE r [<!ENTITY x SYSTEM "../outside/secret.xacro">]>' + template("&x;"),
    "entities of an include": template('<xacro:include filename="laughs.xacro"/>'),
    "working folder": template(name="$(cwd)"),
}  # fmt: skip
BOMBS = {
    "power": template(prop("${9**9**9}"), name=USED),
    "aliases of YAML": template(prop("${xacro.load_yaml('laughs.yaml')}"), name=USED),
    "a YAML that holds itself": template(prop("${xacro.load_yaml('itself.yaml')}"), name=USED),
    "lists by properties": template(
        prop("${[1, 2]}"), *(f'<xacro:property name="y{k}" value="${{[y{k - 1}, y{k - 1}]}}"/>' for k in range(1, 60)),
        '<xacro:property name="y0" value="${[x, x]}"/>', name="${y59}"),
    "text by properties": template(
        prop("lol" * 9), *(f'<xacro:property name="y{k}" value="${{y{k - 1}}}${{y{k - 1}}}"/>' for k in range(1, 60)),
        '<xacro:property name="y0" value="${x}${x}"/>', name="${y59}"),
    "macros in macros": template(
        '<xacro:macro name="m0"><link name="l"/></xacro:macro>',
        *(f'<xacro:macro name="m{k}">{f"<xacro:m{k - 1}/>" * 10}</xacro:macro>' for k in range(1, 12)), "<xacro:m11/>"),
    "files in files": template('<xacro:include filename="twice0.xacro"/>'),
    "a pipe": template('<xacro:include filename="pipe.xacro"/>'),
    "a device": template('<xacro:include filename="/dev/zero"/>'),
    "a pipe of YAML": template(prop("${xacro.load_yaml('pipe.xacro')}"), name=USED),
    "loops": template(prop("${[1 for a in range(99999) for b in range(99999)]}"), name=USED),
}  # fmt: skip


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return a package beside files that it must not read; the working folder is empty."""
    folder = tmp_path / "arm"
    for each in (folder, tmp_path / "outside", tmp_path / "work"):
        each.mkdir()
    (tmp_path / "outside" / "secret.xacro").write_text('<robot name="s"><link name="SECRET"/></robot>')
    (tmp_path / "outside" / "secret.yaml").write_text("SECRET")
    (folder / "package.xml").write_text("<package><name>arm</name></package>")
    (folder / "link.xacro").symlink_to(tmp_path / "outside" / "secret.xacro")
    (folder / "tag.yaml").write_text("!!python/object/apply:os.system ['touch escaped']\n")
    (folder / "unit.yaml").write_text(f"!degrees {json.dumps(TO_SYSTEM)}\n")
    (folder / "laughs.xacro").write_text("<!DOCTYPE r [<!ENTITY a 'ha'><!ENTITY b '&a;&a;'>]><robot><a>&b;</a></robot>")
    lines = ["a0: &a0 [lol, lol]", *(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 60))]
    (folder / "laughs.yaml").write_text("\n".join(lines))
    (folder / "itself.yaml").write_text("&a [*a]")
    for k in range(15):
        include = f'<xacro:include filename="twice{k + 1}.xacro"/>' * 2
        (folder / f"twice{k}.xacro").write_text(f"<robot {XACRO}>{include if k < 14 else ''}</robot>")
    os.mkfifo(folder / "pipe.xacro")
    monkeypatch.chdir(tmp_path / "work")
    return folder


def refusal(package: Path, text: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one sentence with which a template is refused."""
    (package / "t.xacro").write_text(text)
    code = main(["inspect", str(package / "t.xacro")])
    out, error = capsys.readouterr()
    assert code == 2, out
    assert error.count("\n") == 1 and "Traceback" not in error, error
    assert "SECRET" not in out + error and "root:" not in out + error
    assert list(Path().iterdir()) == []
    return error


@pytest.mark.parametrize("escape", ESCAPES)
def test_escapes_are_one_sentence(package, capsys, escape):
    """Expand templates that reach for files or code: refused in one line."""
    if escape == "comment":  # comments are not the robot's; what they hold is evaluated where xacro does so
        assert "does not evaluate" in refusal(package, ESCAPES[escape], capsys)
        return
    sentence = refusal(package, ESCAPES[escape], capsys)
    if "outside" in escape or escape == "password file":
        assert "outside the template's packages" in sentence and "--package-path" in sentence


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_are_one_sentence_within_seconds(package, capsys, bomb):
    """Expand templates that grow without bound: refused in one line, within 5 s of processor time."""
    before = os.times()
    refusal(package, BOMBS[bomb], capsys)
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    assert spent < 5, spent


@pytest.mark.slow
def test_every_entry_of_stiffgen_refuses(package, capsys, tmp_path):
    """Open a template by each entry: expanded on request alone, and no program runs."""
    for name in ("evil.urdf", "evil.urdf.xacro"):
        file = str(package / name)
        Path(file).write_text(ESCAPES["frames of a generator"])
        for command in ("inspect", "generate", "new", "play"):
            assert main([command, file]) == 2
            message = capsys.readouterr().err
            words = "only a template is expanded" if name == "evil.urdf" else "does not evaluate"
            assert words in message, message
        for call in (stiffgen.load_chain, stiffgen.load, stiffgen.generate):
            with pytest.raises(StiffgenError):
                call(file)
    assert list(Path().iterdir()) == []


def test_a_named_folder_may_be_read(package, capsys):
    (package / "t.xacro").write_text(ESCAPES["file outside"])
    assert main(["inspect", str(package / "t.xacro"), "--package-path", str(package.parent / "outside")]) == 2
    assert "has 2 root links (SECRET, base)" in capsys.readouterr().err  # read, and then checked as any robot


def test_variables_of_the_environment_are_noted(package, monkeypatch):
    """Read an environment variable in a template: a note, as the file alone no longer determines the robot."""
    monkeypatch.setenv("ARM_LENGTH", "0.5")
    (package / "t.xacro").write_text(template(prop("$(optenv ARM_LENGTH 1)$(optenv ARM_NO)"), name="l${x}"))
    description = describe(package / "t.xacro")
    assert "l0.5" in description.inertials
    assert [note for note in description.notes if "ARM_" in note] == [
        "xacro: the template reads the environment variable ARM_LENGTH"
    ]


HARM = {
    "program": "import os; os.system('touch escaped')",
    "process": "import subprocess; subprocess.run(['touch', 'escaped'])",
    "file": "open('escaped', 'w')",
    "descriptor": "import os; os.write(os.open('escaped', os.O_CREAT | os.O_WRONLY), b'a')",
    "flags": "import os; os.open('escaped', os.O_CREAT | os.O_RDWR)",
    "truncation": "import os; os.open('kept', os.O_RDONLY | os.O_TRUNC)",
    "process behind subprocess": "import _posixsubprocess as p; p.fork_exec(*[None] * 21)",
    "process kept by subprocess": "subprocess._fork_exec(*[None] * 21)",
    "connection": "import socket; socket.socket().connect(('127.0.0.1', 9))",
    "code": "eval('1 + 1')",
    "removal": "import os; os.remove('kept')",
}


@pytest.mark.parametrize("harm", HARM)
def test_the_process_may_do_no_harm(tmp_path, harm):
    """Try to do harm in the expanding process: Python itself refuses, as a second wall."""
    (tmp_path / "kept").write_text("kept")
    text = f"import os, subprocess, socket\nfrom stiffgen.files.limits import forbid_harm\nforbid_harm()\n{HARM[harm]}"
    (tmp_path / "harm.py").write_text(text)
    done = subprocess.run([sys.executable, "harm.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and ("is not allowed here" in done.stderr or "File too large" in done.stderr), done
    assert (tmp_path / "kept").read_text() == "kept"
    assert not (tmp_path / "escaped").exists()
