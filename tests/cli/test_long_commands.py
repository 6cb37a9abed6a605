# SPDX-License-Identifier: MIT
"""Long commands: their usual time, their progress, the summary before the details; and arguments in any order."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from stiffgen.cli import COMMANDS, main
from stiffgen.cli.console import TextConsole
from stiffgen.core.errors import StiffgenError
from stiffgen.core.verify.result import Check
from stiffgen.lab.analyze.options import AnalysisOptions
from support.project import ROOT

TIME = r"\d+ (seconds|minutes)|a minute"


def test_verify_prints_progress_then_the_summary_then_each_comparison(
    robot_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Verify a faulty folder: the failure is named before the table of hundreds of lines."""

    def verified(folder: Path, *, progress: Callable[[str], None], **_: object) -> list[Check]:
        progress("comparing kernel number 3")
        return [Check("fine", "an oracle", 0.0, 1e-9), Check("wrong", "another", 1.0, 1e-9)]

    monkeypatch.setattr("stiffgen.cli.verify.verify", verified)
    assert main(["verify", str(robot_folder)]) == 1
    out, err = capsys.readouterr()
    assert "comparing kernel number 3" in err
    lines = [line for line in out.splitlines() if line.strip()]
    assert lines[0] == "1 of 2 comparisons within their bound"
    first_row = next(k for k, line in enumerate(lines) if "fine" in line)
    assert next(k for k, line in enumerate(lines) if line.startswith("FAILED wrong, another")) < first_row


def test_verify_ends_with_the_verdict_at_a_terminal(
    robot_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Five lines at most beside what failed; the table of hundreds of rows is for pipes."""
    checks = [Check(f"kernel_{k}", "an oracle", 0.0, 1e-9) for k in range(300)] + [Check("wrong", "another", 1.0, 1e-9)]
    monkeypatch.setattr("stiffgen.cli.verify.verify", lambda *_, **__: checks)
    monkeypatch.setattr("stiffgen.cli.verify.tables", lambda: TextConsole(force_terminal=True, width=60))
    assert main(["verify", str(robot_folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5 and lines[-2:] == ["300 of 301 comparisons within their bound", "FAILED wrong, another"]


def test_long_commands_name_their_usual_time(capsys: pytest.CaptureFixture[str]) -> None:
    """Look for the usual time in help texts, Makefile and page; the last two must agree."""
    assert re.search(TIME, COMMANDS["verify"][1])
    with pytest.raises(SystemExit):
        main(["--help"])
    (line,) = re.findall(r"\n +verify +([^\n]+(?:\n {10,}[^\n]+)*)", capsys.readouterr().out)
    assert re.search(TIME, " ".join(line.split()))
    (rule,) = re.findall(r"(?m)^experiment:.*## (.*)$", (ROOT / "Makefile").read_text())
    page = (ROOT / "docs" / "results.md").read_text().partition("\n## The paper's experiments in simulation\n")[2]
    found = [re.search(TIME, text) for text in (rule, page.partition("\n#")[0])]
    assert all(found) and len({each.group() for each in found if each}) == 1


def test_both_experiments_have_a_bar_of_progress() -> None:
    """Look for the command that shows the time left in both programs of make experiment."""
    recipe = re.search(r"(?m)^experiment:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text())
    assert recipe is not None
    programs = re.findall(r"-m examples\.(\w+)", recipe[1])
    assert len(programs) == 2
    for program in programs:
        files = [*(ROOT / "examples").glob(f"{program}.py"), *(ROOT / "examples").glob(f"{program}/*.py")]
        assert any("from examples.experiments.command import " in file.read_text() for file in files), program
    command = (ROOT / "examples" / "experiments" / "command.py").read_text()
    assert re.search(r"with Progress\(", command) and "TimeRemainingColumn()" in command


PARTS = (["log.csv"], ["--robot", "generated/arm"], ["--task-stiffness", *"123456"], ["--no-figures"])


@pytest.mark.parametrize("parts", list(permutations(PARTS)), ids=lambda parts: "-".join(part[0] for part in parts))
def test_arguments_of_analyze_in_any_order(parts: tuple[list[str], ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the arguments of `analyze` in each order: the six stiffnesses must not swallow the file's name."""
    seen: list[AnalysisOptions] = []

    def run_analysis(options: AnalysisOptions) -> None:
        seen.append(options)
        raise StiffgenError("enough")

    monkeypatch.setattr(importlib.import_module("stiffgen.lab.analyze.command"), "run_analysis", run_analysis)
    assert main(["analyze", *(word for part in parts for word in part)]) == 2
    (options,) = seen
    assert (str(options.log), str(options.robot), options.figures) == ("log.csv", "generated/arm", False)
    assert np.diag(np.array(options.task_stiffness)).tolist() == [1, 2, 3, 4, 5, 6]


def test_the_page_of_analyze_has_the_stiffness_over_time_in_few_lines() -> None:
    """Count the lines of the page's code for K_q(t): as few as its heading says."""
    page = (ROOT / "docs" / "analyze.md").read_text()
    match = re.search(r"## The same in four lines of NumPy\n.*?```python\n(.*?)```", page, re.DOTALL)
    assert match is not None
    lines = [line for line in match[1].splitlines() if line.strip() and not line.startswith("import ")]
    assert sum(not line.startswith(("plt.", "print(")) for line in lines) == 4
    assert sum("joint_stiffness(q, F, " in line for line in lines) == 1
    assert sum(line.startswith("plt.plot(t, ") for line in lines) == 1
