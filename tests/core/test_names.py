# SPDX-License-Identifier: MIT
"""Names of any file become safe identifiers, strings and comments."""

from __future__ import annotations

import ast
import keyword
import re
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stiffgen
from stiffgen.core.errors import StiffgenError
from stiffgen.core.names import MAX_LENGTH, c_string, checked_identifier, comment, identifier
from support.project import ROOT, URDF

ANY_TEXT = st.text(st.characters(), max_size=200)  # with surrogates and control characters
SLOW = settings(derandomize=True, max_examples=500, deadline=None)


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("iiwa14", "iiwa14"), ("LBR iiwa 14 R820", "LBR_iiwa_14_R820"), ("3dof", "robot_3dof"), ("", "robot"),
        ("---", "robot"), ("std", "robot_std"), ("Eigen", "robot_Eigen"), ("link", "robot_link"),
        ("Käfer", "Kafer"), ("机器人", "robot"), ("double", "robot_double"), ("Class", "robot_Class"),
        ("None", "robot_None"),
        ("match", "robot_match"), ("numpy", "robot_numpy"), ("stddef", "robot_stddef"), ("Turtle", "robot_Turtle"),
        ("AUX", "robot_AUX"), ("__x__", "x"), ("a//../b", "a_b"),
        ("../../etc/passwd", "etc_passwd"),
        ("stiffgen", "robot_stiffgen"), ("stiffgen_damping", "robot_stiffgen_damping"), ("a" * 99, "a" * 40),
        ("a" * 39 + "_b", "a" * 39), ("9" * 99, "robot_" + "9" * 34), ("x;rm -rf /", "x_rm_rf"), ("١٢", "robot"),
        ("ﬁ", "fi"),
    ],
)  # fmt: skip
def test_the_rule(name, made):
    """Compare identifiers made of names with those expected: reserved words, other scripts, long and empty ones."""
    assert identifier(name) == made


@SLOW
@given(ANY_TEXT | st.from_regex(r"\A[a-zA-Z0-9_]{0,60}\Z") | st.sampled_from(keyword.kwlist))
def test_an_identifier_is_one_in_c_and_python_and_stays_as_it_is(name):
    """Make identifiers of any text: valid in C and Python, and made again they stay."""
    made = identifier(name)
    assert re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", made)
    assert not keyword.iskeyword(made) and not keyword.issoftkeyword(made)
    assert len(made) <= MAX_LENGTH
    assert identifier(made) == made == checked_identifier(made)


@pytest.mark.parametrize(
    "name", ["", "a b", "../x", "int", "_x", "x_", "a__b", "é", "a" * 41, "stiffgen", "x\n", "\udcff"]
)
def test_a_chosen_name_is_checked_and_the_nearest_offered(name):
    """Choose an invalid name: refused in one line that ends with a valid one."""
    with pytest.raises(StiffgenError) as refusal:
        checked_identifier(name)
    nearest = str(refusal.value).split()[-1]
    assert checked_identifier(nearest) == nearest
    assert "\n" not in str(refusal.value)


def test_no_name_hides_a_module_of_this_python():
    for module in sys.stdlib_module_names:
        assert identifier(module) != module or module.startswith("_"), module


@pytest.mark.parametrize("name", ["numpy", "stddef", "Random"])
def test_a_name_that_hides_another_is_refused(name):
    with pytest.raises(StiffgenError, match=f"hide another.*--name robot_{name}"):
        checked_identifier(name)


@SLOW
@given(ANY_TEXT)
def test_c_strings_hold_the_utf8_bytes(text):
    literal = c_string(text)
    assert re.fullmatch(r'"([ !#-\[\]-~]|\\[0-7]{3})*"', literal) and "?" not in literal
    assert ast.literal_eval("b" + literal) == text.encode("utf-8", "replace")


@SLOW
@given(ANY_TEXT | st.sampled_from(["*/", "\\\n", "??/", '"""', "]](x)", "<script>", "`", "#]]", "@X@", "${x}"]))
def test_comments_stay_comments(text):
    """Put any text into a comment: no sequence is left that ends a comment in C, Python, CMake or HTML."""
    made = comment(text)
    assert 0 < len(made) <= 80
    assert made.isprintable() and made.isascii()
    for ending in ("*/", "//*", '"', "\\", "`", "<", ">", "|", "#", "@", "$", "[", "]", "??"):
        assert ending not in made


def test_no_name_of_a_robot_makes_a_function_equal_to_an_internal_one():
    """Compare internal names with NAME_suffix: such a NAME must be one that no robot can have."""
    folder = ROOT / "generated" / "iiwa14"
    texts = {file.name: re.sub(r"/\*.*?\*/", "", file.read_text(), flags=re.S) for file in folder.glob("*.[ch]")}
    public = "".join(text for name, text in texts.items() if name.endswith(".h"))
    suffixes = set(re.findall(r"\biiwa14(_\w+)", public))
    declared = r"^(?:static|typedef|void)\b[^;={(\n]*?\b(\w+)\s*[\[(;=]"
    internal = set(re.findall(declared, "\n".join(texts.values()), re.M))
    assert {"worst_work", "stiffgen_mass_matrix", "sine_cosine"} <= internal
    internal = {name for name in internal if not name.startswith("iiwa14_")}
    robots = {(name[: -len(end)], end) for name in internal for end in suffixes if name.endswith(end)}
    possible = [f"{robot}{end}" for robot, end in robots if identifier(robot) == robot]
    assert possible == []


def test_a_robot_named_robot_compiles(tmp_path):
    """Many files give this name."""
    folder = stiffgen.generate(URDF, output=tmp_path, name="robot", build=False)
    for source in ("robot.c", "robot_impedance.c"):
        subprocess.run(["gcc", "-std=c99", "-fsyntax-only", "-Wall", "-Werror", str(folder / source)], check=True)


def test_dir_lists_public_names_alone() -> None:
    """No module that the package or its user imported, such as ``sys`` or ``stiffgen.core.errors``."""
    import stiffgen.core.robot.chain

    assert set(dir(stiffgen)) - {"__doc__", "__file__", "__name__", "__path__"} == set(stiffgen.__all__)
