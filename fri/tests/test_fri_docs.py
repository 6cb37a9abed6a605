# SPDX-License-Identifier: MIT
"""The commands in docs/fri.md against the programs that take them."""

from __future__ import annotations

import re
import shlex

import pytest

from fri.robot import demo
from fri.robot.__main__ import arguments
from fri.robot.faults import KINDS, parse_faults
from stiffgen.cli import parser as stiffgen_parser
from support.pages import blocks, commands
from support.project import ROOT

PAGES = {name: (ROOT / "docs" / name).read_text() for name in ("fri.md",)}
SOURCES = ROOT / "fri" / "client"
CLIENT_OPTIONS = set(re.findall(r'\{"([a-z-]+)", (?:"[A-Z]+"|NULL|no_argument)', (SOURCES / "options.cpp").read_text()))
ROBOT_OPTIONS = {name.lstrip("-") for action in arguments()._actions for name in action.option_strings}
DEMO_OPTIONS = {name.lstrip("-") for action in demo.arguments()._actions for name in action.option_strings}
OTHERS = {"build", "set-eee", "quiet", "name", "output", "tool", "sensor", "check", "reading"}
"""Options of cmake, ethtool, stiffgen generate and calibrate."""


def lines(page: str) -> list[str]:
    """Commands of the page's blocks."""
    return [line for block in blocks(ROOT / "docs" / page) if block.language == "sh" for line in commands(block)]


def code(page: str) -> str:
    """All that is set as code."""
    fenced = "".join(block.code for block in blocks(ROOT / "docs" / page))
    return "\n".join([*re.findall(r"`([^`\n]+)`", PAGES[page]), fenced])


@pytest.mark.parametrize("page", PAGES)
def test_every_option_that_is_named_exists(page: str) -> None:
    named = set(re.findall(r"(?<![\w-])--([a-z][a-z-]*)", code(page)))
    assert len(named) > 10
    assert named - CLIENT_OPTIONS - ROBOT_OPTIONS - DEMO_OPTIONS - OTHERS == set()


def test_every_option_of_the_robot_has_a_help() -> None:
    assert all(action.help for action in arguments()._actions)


def test_every_kind_of_fault_is_in_the_help() -> None:
    assert {kind for kind in KINDS if not re.search(rf"^{kind}\b", arguments().format_help(), re.M)} == set()
    for line in re.findall(r"^--faults (\S+)", PAGES["fri.md"], re.M):
        parse_faults(line, "2.7")


@pytest.mark.parametrize("page", PAGES)
def test_every_command_that_is_shown_can_be_given(page: str) -> None:
    """Parse each command of a page with the parser of its program: a renamed option or target fails."""
    rules = re.findall(r"^([a-z][\w/ -]*):", (ROOT / "Makefile").read_text(), re.M)
    targets = {target for rule in rules for target in rule.split()}
    variables = re.findall(
        r"(?:set\(|find_path\(|find_library\(|option\()(\w+)", (SOURCES / "CMakeLists.txt").read_text()
    )
    given = lines(page)
    assert len(given) >= 4
    for command in given:
        words = shlex.split(command)
        if words[0] == "make":
            assert set(words[1:]) <= targets
        elif words[0] == "cmake":
            for name in re.findall(r"-D(\w+)=", command):
                assert name in variables
        elif words[0] == ".venv/bin/stiffgen":
            stiffgen_parser().parse_args(words[1:])
        elif "fri.robot" in words:
            arguments().parse_args(words[words.index("fri.robot") + 1 :])
        elif words[0].endswith("/fri_wiping"):
            for word, value in zip(words[1:], [*words[2:], ""], strict=True):
                assert not word.startswith("--") or word[2:] in CLIENT_OPTIONS
                assert word != "--trajectory" or (ROOT / value).exists()
    for target in re.findall(r"`make ([^`]+)`", PAGES[page]):
        assert target.split()[0] in targets


def test_every_event_has_a_text() -> None:
    source = (ROOT / "fri" / "client" / "events.h").read_text()
    bits = {name: 1 << int(bit) for name, bit in re.findall(r"EVENT_(\w+) = 1 << (\d+)", source)}
    texts = re.findall(r'\{EVENT_(\w+), "([^"]*)",\s*"([^"]*)",\s*"([^"]*)"\}', source)
    assert [name for name, *_ in texts] == list(bits)
    assert list(bits.values()) == [1 << k for k in range(len(bits))]
