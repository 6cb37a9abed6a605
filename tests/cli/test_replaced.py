# SPDX-License-Identifier: MIT
"""An option of an earlier version is refused by a message that names what takes its place, as docs do."""

from __future__ import annotations

import re
from importlib import import_module

import pytest

from stiffgen.cli import COMMANDS, main
from stiffgen.cli.parsing import CommandParser
from stiffgen.cli.replaced import REPLACED
from support.project import ROOT

PLACES = {"generate": ["urdf/iiwa14.urdf"], "new": ["urdf/iiwa14.urdf"], "inspect": ["urdf/iiwa14.urdf"]}
PLACES |= {"play": ["generated/iiwa14"], "prove": ["generated/iiwa14"], "verify": ["generated/iiwa14"]}
PLACES |= {
    "analyze": ["log.csv", "--robot", "generated/iiwa14", "--task-stiffness", "300"],
    "calibrate": ["log.csv", "--robot", "generated/iiwa14"],
    "measure": ["log.csv"],
}
OLD = [(command, option) for command, options in REPLACED.items() for option in options]


@pytest.mark.parametrize(("command", "option"), OLD)
def test_what_takes_its_place_is_named(command: str, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Give an option of an older release: exit code 2, and the option that replaces it is named."""
    with pytest.raises(SystemExit) as ended:
        main([command, *PLACES[command], f"{option}=1"])
    error = capsys.readouterr().err.splitlines()[-1]
    assert ended.value.code == 2
    assert error.startswith(f"stiffgen {command}: error: unrecognized arguments: {option}=1; in place of {option}: ")
    assert error.endswith(REPLACED[command][option])


@pytest.mark.parametrize("command", REPLACED)
def test_old_options_are_gone_and_new_ones_are_there(command: str) -> None:
    """Compare the table of replaced options with the parser: old ones unknown, named ones known."""
    parser = CommandParser(prog=command)
    import_module(f"stiffgen.{COMMANDS[command][0]}").add(parser)
    known = set(parser._option_string_actions)
    assert not known & REPLACED[command].keys()
    named = {word for words in REPLACED[command].values() for word in re.findall(r"--[\w-]+", words)}
    assert named <= known


def test_the_page_lists_every_old_option() -> None:
    page = (ROOT / "CHANGELOG.md").read_text()
    table = page.split("## Options that were replaced")[1].split("\n\n")[1]
    before = " ".join(row.split("|")[1] for row in table.splitlines()[2:])
    assert {option for _, option in OLD} <= set(re.findall(r"--[\w-]+", before))


def test_an_unknown_option_has_no_replacement(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["generate", "urdf/iiwa14.urdf", "--tol", "1"])
    assert capsys.readouterr().err.splitlines()[-1] == "stiffgen generate: error: unrecognized arguments: --tol 1"


def test_inspect_takes_a_file_or_a_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect"]) == 2
    assert "--list known" in capsys.readouterr().err
