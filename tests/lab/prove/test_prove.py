# SPDX-License-Identifier: MIT
"""``stiffgen prove``: what CI proves of the iiwa 14, and some seeded faults; tests/campaigns/ has all of both."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from stiffgen import generate
from stiffgen.cli import main
from stiffgen.core.errors import MissingExtraError, OutputError, StiffgenError, install_command
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.result import Check
from stiffgen.lab.prove import frama_c, harness, tools, widths
from stiffgen.lab.prove.run import prove
from stiffgen.lab.prove.safety_page import filed_for, write_page
from stiffgen.lab.prove.verdict import Outcome, Verdict, read_verdicts
from support.chains import chain_urdf
from support.generated_c import kernel_files
from support.project import URDF, require_compiler, require_program
from support.seeded_faults import CONTROLLER, FAULTS, FOLDER, Fault, faulty


@pytest.fixture
def provers() -> None:
    """Both programs; skip where one is missing, fail on CI."""
    require_program("frama-c", "frama-c-base")
    try:
        tools.find_provers()
    except MissingExtraError as error:
        if os.environ.get("CI"):
            pytest.fail(str(error))
        pytest.skip(str(error))


def outcomes(verdicts: list[Verdict]) -> dict[str, list[Verdict]]:
    found: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        found.setdefault(verdict.outcome, []).append(verdict)
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
    files = kernel_files(folder, "iiwa14") if fault.part == "memory" else [folder / CONTROLLER]
    assert any(file.read_text() != (FOLDER / file.name).read_text() for file in files)


SHAPES = (
    "hybrid_jacobian", "hybrid_joint_stiffness", "body_joint_stiffness", "mass_matrix", "spring_joint_stiffness",
)  # fmt: skip
"""Kernels of every shape: rows, the upper triangle computed, the lower one, the whole tree, a spring. All others:
``make campaign NAME=proofs``."""
MATRICES = SHAPES[1:4]
"""The symmetric ones, but for the spring's."""


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of these kernels: both provers read the whole file for each function."""
    output = tmp_path_factory.mktemp("shapes")
    chosen = (
        "hybrid.jacobian",
        "hybrid.joint_stiffness",
        "body.joint_stiffness",
        "mass_matrix",
        "spring.joint_stiffness",
    )
    return generate(URDF, name="iiwa14", output=output, kernels=chosen, controller=False, python=False)


@pytest.mark.wide(instead="test_the_controller_is_proved")
@pytest.mark.usefixtures("provers")
def test_the_memory_of_every_shape_is_proved(shapes: Path) -> None:
    """For all inputs, by Eva: accesses, initialisation, undefined behaviour, loops, arguments that are not written."""
    verdicts = prove(shapes, parts=("memory",))
    assert_proved(verdicts)
    assert {v.tool for v in verdicts} == {"Frama-C"}
    assert {*SHAPES, "hybrid_jacobian_batch", "self_check"} < {v.function for v in verdicts}


@pytest.mark.wide(instead="test_a_fault_is_caught")
@pytest.mark.usefixtures("provers")
def test_the_bits_of_every_shape_are_proved(shapes: Path) -> None:
    """For all inputs, by ESBMC: bounds, and symmetry to the last bit of single calls, batches and packed ones."""
    verdicts = prove(shapes, parts=("bits",), only=MATRICES)
    assert_proved(verdicts)
    assert {v.function.removesuffix("_batch").removesuffix("_packed") for v in verdicts} == {*MATRICES}
    symmetric = {v.function for v in verdicts if "symmetric" in v.claims}
    assert {"hybrid_joint_stiffness", "hybrid_joint_stiffness_batch", "body_joint_stiffness_batch"} < symmetric


@pytest.mark.slow
@pytest.mark.usefixtures("provers")
def test_the_controller_is_proved() -> None:
    """For all inputs and states that a call can leave, by Eva: the whole controller of the committed folder."""
    verdicts = prove(FOLDER, parts=("services", "step"))
    assert_proved(verdicts)
    proved = {v.function for v in verdicts}
    assert {"iiwa14_impedance_step", "iiwa14_impedance_init", "validate", "fits_memory", "find_modes"} < proved


@pytest.mark.wide(instead="test_the_controller_is_proved")
@pytest.mark.usefixtures("provers")
def test_the_papers_law_is_proved(tmp_path: Path) -> None:
    """For all inputs, by Eva, of an arm of two joints (of seven: ``make campaign NAME=proofs``); a fault is caught."""
    (tmp_path / "arm.urdf").write_text(chain_urdf("rr"))
    folder = generate(tmp_path / "arm.urdf", output=tmp_path, build=False)
    verdicts = prove(folder, parts=("paper",))
    assert_proved(verdicts)
    own = {f"{folder.name}_paper_step", f"{folder.name}_paper_validate", "diagonalise", "is_stiffness"}
    assert own < {v.function for v in verdicts}
    source = folder / f"{folder.name}_paper.c"
    source.write_text(source.read_text().replace("i < 36; ++i", "i < 37; ++i"))
    assert "is_stiffness" in {v.function for v in outcomes(prove(folder, parts=("paper",)))["alarm"]}


@pytest.mark.slow
@pytest.mark.usefixtures("provers")
def test_a_width_runs_clean(monkeypatch: pytest.MonkeyPatch, shapes: Path) -> None:
    monkeypatch.setattr(widths, "WIDTHS", widths.WIDTHS[1:2])
    assert_proved(prove(shapes, parts=("widths",)))


@pytest.mark.usefixtures("provers")
@pytest.mark.slow
@pytest.mark.parametrize(
    "title",
    [
        "a shift beyond the width",
        pytest.param("an argument is written", marks=pytest.mark.wide),
        pytest.param("a rate too many", marks=pytest.mark.wide),
        pytest.param("an invalid number is taken", marks=pytest.mark.wide),
        pytest.param("the configuration is written", marks=pytest.mark.wide),
    ],
)
def test_a_fault_is_caught(title: str, tmp_path: Path) -> None:
    """Prove code with a seeded fault: refuted, or an alarm."""
    (fault,) = (each for each in FAULTS if each.title == title)
    only = (fault.only,) if fault.only else ()
    found = outcomes(prove(faulty(fault, tmp_path), parts=(fault.part,), only=only))
    assert found.keys() & {"refuted", "alarm"}


SMALL = """
extern const double table[4];
volatile int anything;
volatile double seen;
void prove_inside(void) { seen = table[anything & 3]; Frama_C_show_each_returned_inside(1); }
void prove_perhaps_outside(void) { seen = table[anything & 7]; Frama_C_show_each_returned_perhaps_outside(1); }
void prove_outside(void) { seen = table[4]; Frama_C_show_each_returned_outside(1); }
"""


@pytest.mark.usefixtures("provers")
def test_eva_tells_an_alarm_from_a_refutation(tmp_path: Path) -> None:
    """An index within 0 ... 3 is proved, within 0 ... 7 undecided, and 4 wrong wherever it is reached."""
    (tmp_path / "small.c").write_text(SMALL)
    sure = {}
    for entry in ("inside", "perhaps_outside", "outside"):
        found = frama_c.analyse(tools.find_provers(), tmp_path, "small.c", [], 60.0, entry=f"prove_{entry}")
        assert not found.trouble
        sure[entry] = [alarm.is_sure for alarms in found.alarms.values() for alarm in alarms]
    assert sure == {"inside": [], "perhaps_outside": [False], "outside": [True]}


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("proved", "proved"), 0),
        (("proved", "alarm"), 3),
        (("no answer", "proved"), 3),
        (("alarm", "refuted", "proved"), 1),
        (("no answer", "refuted"), 1),
    ],
)
def test_exit_codes_tell_outcomes_apart(
    words: tuple[Outcome, ...], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """0: all proved; 1: one is refuted; 3: none is refuted, but one is undecided."""
    verdicts = [Verdict("f", "in bounds", "Eva", word, 0.1, "because") for word in words]
    monkeypatch.setattr(importlib.import_module("stiffgen.lab.prove.command"), "prove", lambda *_, **__: verdicts)
    assert main(["prove", str(FOLDER)]) == code
    out = capsys.readouterr().out
    for word in {*words} - {"proved"}:
        assert f"{word}: f, by Eva: because" in out


@pytest.mark.usefixtures("provers")
def test_a_prover_that_gives_up_is_no_proof(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a result of Frama-C, the controller has no verdict "proved", and not none at all."""
    program = tmp_path / "frama-c"
    program.write_text("#!/bin/sh\necho 'fatal error: no more memory'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    found = outcomes(prove(FOLDER, parts=("services",)))
    assert {verdict.tool for verdict in found["no answer"]} == {"Frama-C"}
    assert [verdict.function for verdict in found["proved"]] == ["comparisons"]


def test_the_harness_of_a_folder_with_derivatives_is_c(tmp_path: Path) -> None:
    """A body that calls another kernel's body (a product that is part of a larger one) is no damage to the folder."""
    arm = tmp_path / "arm.urdf"
    arm.write_text(chain_urdf("rr"))
    folder = generate(arm, output=tmp_path, kernels="spring", derivatives=True, controller=False, build=False)
    robot = open_robot(folder)
    text = robot.kernel_text()
    assert text.count("spring_linearization_vjp_lanes(") == 3
    (tmp_path / "bodies_apart.c").write_text(harness.bodies_apart(robot.table, text))
    bits = tmp_path / "bits.c"
    bits.write_text(harness.kernels_bits(robot, robot.table))
    flags = ["-std=gnu11", "-fsyntax-only", "-Werror", "-DSTIFFGEN_NO_VECTORS", f"-I{robot.folder}", f"-I{tmp_path}"]
    subprocess.run([require_compiler("gcc"), *flags, str(bits)], check=True)


def test_missing_program_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Take the provers away: exit code 2 and how to install them."""
    monkeypatch.setattr(tools.shutil, "which", lambda name: None)
    monkeypatch.setattr(tools, "_bundled", lambda: None)
    assert main(["prove", str(FOLDER)]) == 2
    assert install_command("prove") in capsys.readouterr().err
    monkeypatch.setattr(tools, "_bundled", lambda: "esbmc")
    assert main(["prove", str(FOLDER)]) == 2
    assert "apt-get install frama-c-base" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("clang", "words"),
    [
        (None, "needs clang; install it (Debian: apt-get install clang)"),
        ("echo 'ld: cannot find libclang_rt.asan-x86_64.a' >&2; exit 1", "apt-get install libclang-rt-dev"),
        ('case "$*" in *memory,*) exit 1;; *) exec {clang} "$@";; esac', "apt-get install libclang-rt-dev"),
        (
            "while [ $# -gt 1 ]; do shift; done; printf '#!/bin/sh\\necho FATAL: error: shadow memory\\n' >\"$1\"; "
            'chmod +x "$1"',
            "-fsanitize=address,undefined here (FATAL: error: shadow memory)",
        ),
    ],
    ids=["no clang", "no runtime library", "none of memory", "does not run"],
)
def test_missing_sanitizers_are_named_before_the_first_proof(
    clang: str | None, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before, "no answer" for each width after all other proofs, which take eight minutes."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, text in (("esbmc", "echo ESBMC version 8.4"), ("frama-c", "echo 25"), ("clang", clang)):
        if text is not None:
            (programs / name).write_text(f"#!/bin/sh\n{text.replace('{clang}', shutil.which('clang') or 'clang')}\n")
            (programs / name).chmod(0o755)
    for name in ("gcc", "chmod"):
        (programs / name).symlink_to(require_compiler("gcc") if name == "gcc" else "/bin/chmod")
    monkeypatch.setenv("PATH", str(programs))
    assert main(["prove", str(FOLDER), "widths"]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_bad_input_is_refused(tmp_path: Path) -> None:
    """Ask for proofs that cannot be made: refused with the reason."""
    with pytest.raises(StiffgenError, match=r"nonsense: no kernel of .*hybrid_joint_stiffness"):
        prove(FOLDER, only=("nonsense",))
    with pytest.raises(StiffgenError, match="nothing to prove: kernels alone were named"):
        prove(FOLDER, parts=("step",), only=("mass_matrix",))
    with pytest.raises(StiffgenError, match="--timeout"):
        prove(FOLDER, timeout=0.0)
    with pytest.raises(OutputError, match="not a folder that 'stiffgen generate' wrote"):
        prove(tmp_path)
    (tmp_path / "verdicts.json").write_text('{"verdicts": 3}')
    with pytest.raises(OutputError, match="holds no verdicts"):
        read_verdicts(tmp_path / "verdicts.json")


def test_verdicts_of_other_bytes_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "verdicts.json"
    sources = open_robot(FOLDER).source_digests() | {"iiwa14.c": "0" * 64}
    content = {"robot": "iiwa14", "sources": sources, "tools": {}, "verdicts": []}
    file.write_text(json.dumps(content))
    with pytest.raises(OutputError, match=r"about another iiwa14\.c"):
        filed_for(open_robot(FOLDER), file)


def test_page_shows_what_it_was_given(tmp_path: Path) -> None:
    """Write the page of a failed comparison and an open proof: both stand on it, escaped, without a date."""
    sources = open_robot(FOLDER).source_digests()
    verdict = {"function": "act", "claims": "in bounds", "tool": "Frama-C", "outcome": "alarm", "seconds": 1.0}
    content = {"robot": "iiwa14", "sources": sources, "tools": {"ESBMC": "8.4"}, "verdicts": [verdict]}
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
    assert not re.search(r"20\d\d-\d\d", page), "no date"
