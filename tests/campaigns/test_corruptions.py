# SPDX-License-Identifier: MIT
"""Faults that ``stiffgen verify`` must find: put into a generated folder by hand, one at a time.

Each one compiles. The digests in the manifest would show any change of a file, and so would the comparison of the text;
both are left out of account. A comparison of values must fail.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import stiffgen
from stiffgen.control.sessions import library
from stiffgen.core.emit import build
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.folder import widths
from stiffgen.core.verify.folder.files import check_files, load_module
from stiffgen.core.verify.verify import _steps
from support.confined import LOADED
from support.generated_c import kernel_files
from support.kept_objects import KeptObjects
from support.project import URDF

C, PYTHON_C, PYTHON, CONTROLLER = "iiwa14.c", "python/iiwa14_python.c", "__init__.py", "iiwa14_impedance.c"


class Fault(NamedTuple):
    """Replace what ``pattern`` (a regular expression) finds after ``after``, once."""

    title: str
    file: str
    pattern: str
    replacement: str
    after: str = ""


EVALUATE = "static void evaluate_hybrid_joint_stiffness("
LAST, LANES = "const lanes finite = finite_lanes(from", "static void hybrid_joint_stiffness_lanes"
LOAD, STORE = "static APART void load_lanes(", "static APART void store_lanes("
STIFFNESS, BATCH = "void iiwa14_hybrid_joint_stiffness(", "void iiwa14_hybrid_joint_stiffness_batch("
PACKED = "void iiwa14_hybrid_joint_stiffness_packed_batch("
# ruff: noqa: E501
FAULTS = [
    Fault("load: tail takes the entry before", C, r"configuration\[c\]\[k\]", "configuration[c][k - 1]", LOAD),
    Fault("load: tail takes the first configuration", C, r"configuration\[c\]\[k\]", "configuration[0][k]", LOAD),
    Fault("load: whole lanes of one configuration", C, r"configuration\[c\] \+ k", "configuration[0] + k", LOAD),
    Fault("load: steps without sign", C, r"from \+ step \*", "from + (step < 0 ? -step : step) *", LOAD),
    Fault("load: steps taken as sizes", C, r"from \+ step \*", "from + size *", LOAD),
    Fault("load: the last one stands in everywhere", C, r"first \+ c < count \?", "first + c + 1 < count ?", LOAD + "!"),
    Fault("load: reads one configuration too many", C, r"first \+ c < count \?", "first + c <= count ?", LOAD + "!"),
    Fault("store: a tail of whole lanes beyond the end", C, r"c < present", "c < LANES", STORE),
    Fault("store: the last entries beyond the end", C, r"c < present", "c < LANES", LAST),
    Fault("store: the last configuration is forgotten", C, r"c < present", "c + 1 < present", STORE),
    Fault("store: its last entries are forgotten", C, r"c < present", "c + 1 < present", LAST),
    Fault("store: whole lanes not guarded", C, r"finite_lanes\(from\[k \+ c\]\)", "from[k + c]", STORE),
    Fault("store: last entries not guarded", C, r"finite_lanes\(from\[k\]\)", "from[k]", STORE),
    Fault("guard of rows", C, r"finite_lanes\(row\[j\]\)", "row[j]"),
    Fault("guard of entries", C, r"entry \+ 0\.0 \* entry", "entry"),
    Fault("guard of numbers", C, r"return x \+ 0\.0 \* x", "return x", "static double finite_or_nan"),
    Fault("guard of lanes", C, r"return x \+ 0\.0 \* x", "return x", "static inline lanes finite_lanes"),
    Fault("rows: the last entry is forgotten", C, r"rest < LANES \? rest : LANES", "rest < LANES ? rest - 1 : LANES"),
    Fault("rows: beyond the end", C, r"rest < LANES \? rest : LANES", "LANES"),
    Fault("sign in a single call", C, r"K\[3\]\[4\] \+", "K[3][4] -", STIFFNESS),
    Fault("sign in a batch", C, r"K\[3\]\[4\] \+", "K[3][4] -", LANES),
    Fault("one triangle is read", C, r"0\.5 \* \(task_stiffness\[1\] \+ task_stiffness\[6\]\)", "task_stiffness[1]", STIFFNESS),
    Fault("the lower triangle is read", C, r"0\.5 \* \(task_stiffness\[23\] \+ task_stiffness\[33\]\)", "task_stiffness[33]", STIFFNESS),
    Fault("one triangle is read, batch", C, r"0\.5 \* \(K\[n \* i \+ j\] \+ K\[n \* j \+ i\]\)", "K[n * i + j]", "void take_symmetric_parts("),
    Fault("only the first block's stiffness is averaged", C, r"first != 0 && step == 0", "first != 0", "void take_symmetric_parts("),
    Fault("the lower triangle is read, batch", C, r"A43 = K\[3\]\[4\]", "A43 = K[4][3]", LANES),
    Fault("the lower triangle is read as it is, batch", C, r"J\[0\]\[j\] \* K\[0\]\[1\]", "J[0][j] * K[1][0]", LANES),
    Fault("rows of the Jacobian: one is forgotten", C, r"k < rows; \+\+k", "k + 1 < rows; ++k", "void put_rows("),
    Fault("sign of the sine's quadrant", C, r"turns\.bits & 2\) << 62", "turns.bits & 1) << 62"),
    Fault("sign of the cosine's quadrant", C, r"\(turns\.bits \+ 1\) & 2", "turns.bits & 2"),
    Fault("a coefficient of the sine", C, r"0\.1666666666666663", "0.1666666666"),
    Fault("a coefficient of the cosine", C, r"0\.041666666666666595", "0.0416666666"),
    Fault("a part of pi", C, r"5\.1266883031811465e-12", "5.1266883031811465e-11"),
    Fault("no libm for far angles", C, r"if \(!\(sum <= FAR\)\)", "if (0)"),
    Fault("lower limit in C", C, r"-2\.96706,", "-2.9,", "const double iiwa14_lower"),
    Fault("upper limit in C", C, r"3\.054326,", "3.05,", "const double iiwa14_upper"),
    Fault("effort in C", C, r"320\.0,", "300.0,", "const double iiwa14_effort"),
    Fault("name of a joint in C", C, r'"A3"', '"A2"', "iiwa14_joints"),
    Fault("a link's length", C, r"0\.42\b", "0.4200001", "tip_pose("),
    Fault("a batch's first blocks only", C, r"first != 0 && step == 0", "first != 0", LOAD),
    Fault("a batch's shared wrench moves", C, r"wrench, wrench_step, done", "wrench, 6, done", BATCH),
    Fault("a batch's q in a row", C, r"q, q_step, done", "q, 7, done", BATCH),
    Fault("a batch without its tail", C, r"done < count", "done + LANES <= count", BATCH),
    Fault("a batch stores in one place", C, r"joint_stiffness \+ 49 \* done", "joint_stiffness", BATCH),
    Fault("a triangle without its second row's first entry", C, r"int j = i; j < n", "int j = i + (i == 1); j < n", "void pack_upper("),
    Fault("a packed batch stores in one place", C, r"joint_stiffness \+ 28 \* done", "joint_stiffness", PACKED),
    Fault("arguments exchanged", PYTHON_C, r"in\[0\], in\[1\]", "in[1], in[0]", "static void evaluate_hybrid_kine"),
    Fault("stiffness for wrench", PYTHON_C, r"in\[1\], in\[2\]", "in[2], in[1]", EVALUATE),
    Fault("uncorrected for corrected", PYTHON_C, r"joint_stiffness\(in", "joint_stiffness_uncorrected(in", EVALUATE),
    Fault("another representation", PYTHON_C, "iiwa14_body_jacobian", "iiwa14_hybrid_jacobian", "evaluate_body_jacobian("),
    Fault("step of another argument", PYTHON_C, r"steps\[1\]", "steps[0]", "evaluate_hybrid_joint_stiffness_batch("),
    Fault("rows taken as planes", PYTHON_C, r"a \* steps\[0\]", "a * steps[1]", "static void copy_block("),
    Fault("columns taken as rows", PYTHON_C, r"c \* steps\[rank - 1\]", "c * (npy_intp)sizeof(double)", "static void copy_block("),
    Fault("every chunk is the first", PYTHON_C, r"args\[o\] \+ steps\[o\] \* done, steps\[o\]", "args[o], steps[o]", "static void batch_loop("),
    Fault("a spring's energy", CONTROLLER, r"translation_stiffness, rotation_stiffness, &energy", "rotation_stiffness, translation_stiffness, &energy", "static double stiffgen_spring_energy("),
    Fault("a spring's torque", CONTROLLER, r"translation_stiffness, rotation_stiffness, &energy", "rotation_stiffness, translation_stiffness, &energy", "static double stiffgen_spring("),
    Fault("sign of the posture's potential", CONTROLLER, r"pull\[i\] \+= k \* away", "pull[i] -= k * away"),
    Fault("energy of the posture's potential", CONTROLLER, r"\+ 0\.5 \* twice", "+ 1.5 * twice"),
    Fault("sign of the damping", CONTROLLER, r"dr\[i\] - m->watch\.dq\[i\]", "dr[i] + m->watch.dq[i]"),
    Fault("damping against the base", CONTROLLER, r"f->dr\[i\] - m->watch\.dq\[i\]", "0.0 - m->watch.dq[i]"),
    Fault("design of the damping", CONTROLLER, r"\(2\.0 \* zeta \* zeta - 1\.0\)", "(2.0 * zeta * zeta)"),
    Fault("damping without the rotors", CONTROLLER, r"\+= m->config\.motor_inertia\[i\]", "+= 0.0 * m->config.motor_inertia[i]"),
    Fault("tangent without the limits", CONTROLLER, r"\+= k \+ slope\[i\]", "+= k"),
    Fault("sign of the limit torque", CONTROLLER, r"= -clamp\(force", "= clamp(force"),
    Fault("the lower limit pushes the other way", CONTROLLER, r"clamp\(q\[i\], lower\[i\], upper\[i\]\)", "clamp(q[i], -upper[i], upper[i])"),
    Fault("rate limit dropped", CONTROLLER, r"clamp\(aim\[i\], last - rate, last \+ rate\)", "aim[i]"),
    Fault("effort limit dropped", CONTROLLER, r"clamp\(x, smaller\([^;]*;", "x;", "static uint32_t limit_torque("),
    Fault("NaN of q accepted", CONTROLLER, r"!\(fabs\(in->q\[i\]\) <= FARTHEST && fabs\(dq\) <=", "(fabs(in->q[i]) > FARTHEST || fabs(dq) >"),
    Fault("NaN of a command accepted", CONTROLLER, r"!\(fabs\(given\[i\]\) <= FARTHEST\)", "fabs(given[i]) > FARTHEST"),
    Fault("q0 far beyond a limit accepted", CONTROLLER, r"beyond\(c, i, wanted\) > TOLERANCE", "beyond(c, i, wanted) > 1e9"),
    Fault("a velocity that contradicts accepted", CONTROLLER, r"fabs\(differs\) > allowed", "fabs(differs) > 1e9 * allowed"),
    Fault("reference's speed dropped", CONTROLLER, r"SPEED \* velocity_limit|SPEED \* c->velocity_limit\[i\]\)", "1e3 * c->velocity_limit[i])", "double relative_speed("),
    Fault("speed of the tip's equilibrium dropped", CONTROLLER, r"speed <= 1\.0 && may_rise", "may_rise"),
    Fault("fault not latched", CONTROLLER, r"next\.reason = found->reason", "next.reason = 0 * found->reason"),
    Fault("fault clears itself", CONTROLLER, r"m->fault\.reset \|\| resumes", "1 || resumes"),
    Fault("reset does nothing", CONTROLLER, r"memory\.fault\.reset = 1", "memory.fault.reset = 0", "static int request_reset("),
    Fault("springs on in a fault", CONTROLLER, r"larger\(next\.scale - fall, 0\.0\)", "next.scale + 0.0 * fall"),
    Fault("missed samples forgotten", CONTROLLER, r"s->good \? 0 : count_up\(w->missed, 1\)", "0"),
    Fault("overspeed allowed", CONTROLLER, r"w->fast \* c->sample_time > OVERSPEED_TIME", "0.0 > OVERSPEED_TIME"),
    Fault("beyond the upper limit allowed", CONTROLLER, r"larger\(c->lower_limit\[i\] - q, q - c->upper_limit\[i\]\)", "c->lower_limit[i] - q"),
    Fault("heaviest_wrench of a move dropped", CONTROLLER, r"return load <= 1\.0 \|\|", "return 1 ||"),
    Fault("limit in Python", PYTHON, r"-2\.96706", "-2.9", "LOWER ="),
    Fault("effort in Python", PYTHON, r"320\.0", "300.0", "EFFORT ="),
    Fault("tip in Python", PYTHON, "'link_ee'|\"link_ee\"", "'link_7'", "\nTIP"),
    # Each compiles; a pattern that no longer occurs fails its test, so that the list follows the code.
]  # fmt: skip
HARMLESS = {"load: the last one stands in everywhere"}
"""Lanes that are not stored: the pattern is kept as a control. A check of values that fails on it would be wrong."""
LONG = {*HARMLESS, "tangent without the limits", "a spring's energy", "effort limit dropped"}
"""Faults that verify's last steps find, or none; CI has the next one instead, and one that hostile sessions find."""


def corrupted(text: str, fault: Fault) -> str:
    """Put the fault into the text; an AssertionError says that a fault no longer applies and must be written anew."""
    after = fault.after.removesuffix("!")
    assert after in text, f"{fault.title}: no '{after}'"
    start = text.index(after)
    changed, count = re.subn(fault.pattern, fault.replacement, text[start:], count=1)
    assert count == 1, f"{fault.title}: no '{fault.pattern}'"
    return text[:start] + changed


def place(fault: Fault, folder: Path) -> Path:
    """Return the file that a fault applies to; C stands for all files of kernels."""
    after, files = fault.after.removesuffix("!"), kernel_files(folder, "iiwa14") if fault.file == C else []
    for file in files:
        text = file.read_text()
        if after in text and re.search(fault.pattern, text[text.index(after) :]):
            return file
    return folder / fault.file


FIRST = {
    "load: reads one configuration too many": ("bounds of memory",),
    "store: last entries not guarded": ("NaN and infinity",),
    "lower limit in C": ("names and limits in C",),
    "effort in C": ("names and limits in C",),
    "a velocity that contradicts accepted": ("hostile sessions",),
    "step of another argument": ("stacks of every length",),
    "columns taken as rows": ("stacks of every length",),
    C: ("stacks of every length",),
    PYTHON_C: ("differentiating and comparing",),
    CONTROLLER: ("stepping the controller", "hostile sessions"),
    PYTHON: ("names and limits",),
    URDF.name: ("reading the URDF",),
}
"""The steps of ``verify`` that look at a fault or at a file most closely: run first, as one failed comparison suffices."""
TEXT = "printing again"
"""The step that finds every change of a source."""
LAST = ("names and limits", "batches in C", "bounds of memory", "certified bounds", "hostile sessions")
"""Steps that compile or print, in the order of their cost; all others come before."""


def _order(title: str, first: Sequence[str]) -> tuple[bool, int]:
    """Return the rank of a step of ``verify``: what finds most faults in the least time comes first."""
    if title in first:
        return False, first.index(title)
    return True, LAST.index(title) if title in LAST else -1


def _verify(folder: Path, urdf: Path | None, first: Sequence[str], kept: KeptObjects, send: Connection) -> None:
    """Send the comparisons of values of the first step of ``verify`` that has failed ones; [] if none has."""
    build._FAST_TO_COMPILE, build.run_all = ("-O0",), kept.run
    library.CAREFUL = ("-O0", *library.CAREFUL[1:])
    widths.WIDTHS = widths.WIDTHS[:2]  # the module has the widest vectors
    robot = open_robot(folder)
    load_module(robot)
    with tempfile.TemporaryDirectory() as scratch:
        steps = [each for each in _steps(robot, urdf, 10, 0, Path(scratch), other_version=False) if each[0] != TEXT]
        for title, step in sorted(steps, key=lambda each: _order(each[0], first)):
            try:
                failed = [
                    f"{check.kernel}: {check.oracle}"
                    for check in step()
                    if not check.passed and check.kernel != "files"
                ]
            except (ValueError, TypeError, IndexError, KeyError, AttributeError) as error:  # as verify() does
                failed = [f"{title}: {error}"]
            if failed:
                send.send(failed)
                return
    send.send([])


def failed_comparisons(
    kept: KeptObjects, folder: Path, urdf: Path | None = None, first: Sequence[str] = ()
) -> list[str]:
    """Return failed comparisons of values, in another process: a fault may write anywhere."""
    receive, send = LOADED.Pipe(duplex=False)
    process = LOADED.Process(target=_verify, args=(folder, urdf, first, kept, send))
    process.start()
    send.close()
    try:
        failed = receive.recv()
    except EOFError:
        failed = None
    process.join()
    assert process.exitcode is not None
    if process.exitcode < 0:
        return [f"killed by signal {-process.exitcode}"]
    assert process.exitcode == 0 and failed is not None
    return failed


@pytest.fixture
def failures(kept_objects: KeptObjects) -> Callable[..., list[str]]:
    return partial(failed_comparisons, kept_objects)


@pytest.fixture
def folder(robot_folder, tmp_path, monkeypatch) -> Path:
    """Copy the folder to spoil it, compiled without optimisation. Its name is its own: an extension is loaded once a process."""
    monkeypatch.setenv("CFLAGS", "-O0")
    target = tmp_path / "spoilt" / "iiwa14"
    shutil.copytree(robot_folder, target, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    return target


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.title)
def test_every_fault_still_applies(fault, robot_folder):
    text = place(fault, robot_folder).read_text()
    assert corrupted(text, fault) != text


def is_in_ci(number: int) -> bool:
    """Return whether CI seeds a fault: every other one, but the next for one that needs all of verify's steps."""
    return FAULTS[number].title not in LONG and (number % 2 == 0 or FAULTS[number - 1].title in LONG)


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, marks=pytest.mark.slow if is_in_ci(k) else pytest.mark.wide, id=fault.title)
        for k, fault in enumerate(FAULTS)
    ],
)
def test_no_fault_passes(fault, folder, failures):
    """Seed a fault in a generated file: `verify` or the compiled module's self-check must find it, unless it is
    harmless.
    """
    file = place(fault, folder)
    file.write_text(corrupted(file.read_text(), fault))
    try:
        build.build_module(folder, "iiwa14")
    except stiffgen.BuildError as error:  # guards and sines: the compiled code's own check comes first
        assert "self-check" in str(error)
    else:
        failed = failures(folder, first=FIRST.get(fault.title, FIRST.get(fault.file, ())))
        assert (failed == []) == (fault.title in HARMLESS), failed


@pytest.mark.wide(instead="tests/cli/test_cli.py::test_verify")
def test_the_folder_itself_passes_without_optimisation(folder, failures):
    """As a user compiles it: tests/cli/test_cli.py::test_verify."""
    build.build_module(folder, "iiwa14")
    assert failures(folder, URDF) == []


def axis(chain: dict[str, Any]) -> None:
    chain["joints"][3]["axis"] = [-x for x in chain["joints"][3]["axis"]]


def limit(chain: dict[str, Any]) -> None:
    chain["coordinates"][2]["upper"] += 0.1


def mass(chain: dict[str, Any]) -> None:
    chain["joints"][5]["body"]["mass"] *= 1.001


def coordinate(chain: dict[str, Any]) -> None:
    chain["joints"][1]["multiplier"] = 2.0


def tip(chain: dict[str, Any]) -> None:
    chain["tips"][0]["translation"][2] += 1e-6


def fewer(chain: dict[str, Any]) -> None:
    chain["joints"].pop()
    chain["coordinates"].pop()
    chain["tips"][0]["joint"] -= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil",
    [mass, fewer, limit, tip, *(pytest.param(spoil, marks=pytest.mark.wide) for spoil in (axis, coordinate))],
    ids=lambda spoil: spoil.__name__,
)
def test_another_chain_in_the_manifest(spoil: Callable[[dict[str, Any]], None], robot_folder, tmp_path, failures):
    """Spoil the chain in the manifest: `verify` must not pass with functions of another chain."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    spoil(manifest["chain"])
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert failures(folder) != []


@pytest.mark.wide(instead="test_another_chain_in_the_manifest")
def test_a_folder_of_another_urdf_needs_the_urdf(tmp_path, failures, unoptimised):
    """Chain, code and digests agree with each other; only the robot's file shows it."""
    other = tmp_path / "iiwa14.urdf"
    text, count = re.subn(r'xyz="0 0 0\.1475" rpy', 'xyz="0 0 0.1575" rpy', URDF.read_text(), count=1)
    assert count
    other.write_text(text)
    folder = stiffgen.generate(other, output=tmp_path / "generated", name="iiwa14")
    assert failures(folder) == []
    (failed,) = failures(folder, URDF, FIRST[URDF.name])
    assert "iiwa14.urdf, read again" in failed


def test_digests(robot_folder, tmp_path):
    """Add a comment, remove a file: `verify` must see either by its digest."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(robot_folder, folder)
    (folder / "iiwa14.h").write_text((folder / "iiwa14.h").read_text() + "/* mine */\n")
    (folder / "README.md").unlink()
    (check,) = [check for check in check_files(stiffgen.open_robot(folder)) if not check.passed]
    assert check.oracle == "SHA-256 in the manifest"
    assert "iiwa14.h was changed" in check.detail
    assert "README.md is missing" in check.detail
