# SPDX-License-Identifier: MIT
"""``stiffgen --completion``: a shell that sources the script completes commands, options and choices."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from stiffgen.cli import COMMANDS, main
from stiffgen.cli.completion import SHELLS
from stiffgen.core.errors import install_command
from support.project import require_program

COMPLETE = """
source {script}
COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
_shtab_stiffgen
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def script(shell: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["--completion", shell])
    assert ended.value.code == 0
    said = capsys.readouterr()
    assert said.err == ""
    return said.out


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        (["stiffgen", "gen"], ["generate"]),
        (["stiffgen", "generate", "--floating"], ["--floating-base"]),
        (["stiffgen", "generate", "--scalar", "f"], ["float"]),
        (["stiffgen", "calibrate", "--ch"], ["--check"]),
    ],
)
def test_bash_completes(
    words: list[str], completed: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Complete words in bash by the printed script: options, commands and values."""
    file = tmp_path / "stiffgen.bash"
    file.write_text(script("bash", capsys))
    command = COMPLETE.format(script=file, words=" ".join(words))
    done = subprocess.run([require_program("bash", "bash"), "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.split() == completed


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_has_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = script(shell, capsys)
    assert all(name in text for name in COMMANDS)


def test_without_shtab_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--completion", "bash"]) == 2
    assert install_command("completion") in capsys.readouterr().err
