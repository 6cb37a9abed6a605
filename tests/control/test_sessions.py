# SPDX-License-Identifier: MIT
"""Changed defaults, rules and lines of a controller are found by the table of fields and by the hostile sessions."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import stiffgen
from campaigns.mutations import Mutant, Workshop, changed_defaults, count_survivors, mutants
from stiffgen.control.core.config import CONFIG
from stiffgen.control.core.field import Field
from stiffgen.control.core.signals import INPUT
from stiffgen.control.sessions import sessions
from stiffgen.control.sessions.hostile import HostileSession
from stiffgen.control.sessions.library import CAREFUL, ControllerLibrary, set_field
from stiffgen.control.sessions.rules import check_rules
from stiffgen.control.sessions.sessions import SESSIONS, open_controller
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.folder.forked import confined
from support.controller_library import compile_c
from support.project import ROOT

FOLDER = ROOT / "generated" / "iiwa14"


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(open_robot(FOLDER), tmp_path_factory.mktemp("workshop"))


def failed_rules(workshop: Workshop, library: Path) -> set[str]:
    """Return the names of the comparisons with the table of fields that fail."""
    controller = open_controller(library, workshop.robot)

    def made(**stated: Any) -> Any:
        for name, value in stated.items():
            set_field(controller.config, next(field for field in CONFIG if field.name == name), value, -1)
        return SimpleNamespace(config=controller.config)

    module = SimpleNamespace(Impedance=made)
    checks = check_rules(controller, module, workshop.robot.chain)
    return {check.kernel.removeprefix("controller: ") for check in checks if not check.passed}


def test_the_controller_itself_passes(workshop: Workshop) -> None:
    """All sessions of it run in tests/cli/test_cli.py::test_verify."""
    assert failed_rules(workshop, workshop.reference) == set()


@pytest.mark.parametrize("change", ["nothing", "a line", "a file less"])
def test_the_folders_own_controller_runs(change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Change a source of the folder: the controller that runs is compiled from it, not the generator's."""
    folder = tmp_path / "iiwa14"
    shutil.copytree(FOLDER, folder)
    robot = open_robot(folder)
    texts = {file: (FOLDER / file).read_text() for file in robot.manifest["files"] if file.endswith((".c", ".h"))}
    if change == "a line":
        texts["iiwa14.c"] += "\n"
    elif change == "a file less":
        (folder / "iiwa14_dispatch.c").unlink()

    def compiled(source: Path, name: str, build: Path) -> Path:
        build.mkdir(parents=True)
        (build / "library").write_text(str(source))
        return build / "library"

    monkeypatch.setattr(sessions, "build_controller", compiled)
    reference, own = sessions._build_both(robot, texts, tmp_path / "build")
    assert reference != own
    assert (own.read_text() == str(folder)) == (change != "nothing")


@pytest.mark.parametrize("field", [field for field in CONFIG if not field.when], ids=lambda field: field.name)
def test_every_changed_default_is_found(workshop: Workshop, field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    """Change one default of the C library: the rule "defaults" must notice the difference to the table."""
    call = ControllerLibrary.call

    def call_changed(library: ControllerLibrary, function: str, *arguments: Any) -> int:
        code = call(library, function, *arguments)
        if function == "default_config":
            value = np.ravel(getattr(library.config, field.name))[-1]
            changed = 2.0 * value + 0.01 if np.isfinite(value) else 1.0
            set_field(library.config, field, 2 if field.type == "int" and value != 2 else changed, -1)
        return code

    monkeypatch.setattr(ControllerLibrary, "call", call_changed)
    assert "defaults" in failed_rules(workshop, workshop.reference)


@pytest.mark.slow
def test_defaults_and_rules_are_the_tables(workshop: Workshop) -> None:
    """Change a default and a rule in the C: found, as the table is the generator's."""
    defaults = changed_defaults(workshop.text)
    assert len(defaults) == len([field for field in CONFIG if not field.when])
    chosen = next(each for each in defaults if "ramp_time" in each.before)
    library, _ = workshop.compile(chosen.text) or (None, None)
    assert library is not None and failed_rules(workshop, library) == {"defaults"}
    text = workshop.text.replace("&c->ramp_time, 1, 0.0001, 10.0", "&c->ramp_time, 1, 0.0001, 20.0")
    assert text != workshop.text
    library, _ = workshop.compile(text) or (None, None)
    assert library is not None and failed_rules(workshop, library) == {"rules"}


@pytest.mark.slow
@pytest.mark.parametrize(("count", "most"), [(2, 0), pytest.param(5, 1, marks=pytest.mark.wide)])
def test_sessions_kill_mutants(workshop: Workshop, count: int, most: int) -> None:
    """Draw some with a fixed seed; equivalent ones may be among them. ``make campaign NAME=mutations`` counts many."""
    counted, survivors = count_survivors(workshop, mutants(workshop.text, count, seed=8), seed=0)
    assert counted >= count - most and len(survivors) <= most, survivors


def test_every_field_is_above_0_in_some_session(workshop: Workshop) -> None:
    """Check that each field is above 0 in some session: else its code would not run."""
    robot = workshop.robot
    first, second = (open_controller(workshop.reference, robot) for _ in range(2))
    zero = {field.name for field in first.fields}
    for number in range(SESSIONS):
        config = HostileSession(first, second, robot.chain, np.random.default_rng([0, number])).config
        zero -= {name for name in zero if np.any(np.array(getattr(config, name)))}
    assert zero == set()


def test_verify_uses_every_function_and_input_of_the_controller(workshop: Workshop) -> None:
    """Check that sessions use each function and input: else they could change unseen."""
    header = (workshop.folder / "iiwa14_impedance.h").read_text()
    functions = set(re.findall(r"^\w[\w *]* \*?iiwa14_impedance_(\w+)\(", header, re.MULTILINE))
    sources = "".join(file.read_text() for file in Path(sessions.__file__).parent.glob("*.py"))
    assert functions >= {"step", "error_text", "refusal_text"}
    assert {name for name in functions if f'"{name}"' not in sources} == set()
    unset = {field.name for field in INPUT if not re.search(rf"given\.{field.name}\b|\"{field.name}\"", sources)}
    assert unset == set()


def test_a_crash_is_a_fault_and_ends_nothing_else() -> None:
    (fault,) = confined(lambda: os.abort())
    assert "status -6" in fault
    assert confined(lambda: ["session 3: step 4"]) == ["session 3: step 4"]
    assert confined(lambda: []) == []


def test_an_index_outside_an_array_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "a.c").write_text("double f(int i) { double a[3] = {0.0}; a[i] = 1.0; return a[0]; }")
    library = compile_c(tmp_path / "a.so", *CAREFUL, "-shared", "-fPIC", tmp_path / "a.c")
    function = ctypes.CDLL(str(library)).f
    assert confined(lambda: [str(function(2))][1:]) == []
    assert "ends its process" in confined(lambda: [str(function(3))])[0]


TREE = """<robot name="tree"><link name="base"/>{}</robot>"""
BRANCH = """<link name="{0}"><inertial><origin xyz="0.1 0 0.1"/><mass value="2"/><inertia ixx="0.1" ixy="0" ixz="0"
iyy="0.1" iyz="0" izz="0.1"/></inertial></link><joint name="to_{0}" type="{2}"><parent link="{1}"/><child link="{0}"/>
<origin xyz="0.2 0.1 0.3" rpy="0.3 0.2 0.1"/><axis xyz="0 1 0"/><limit lower="-{3}" upper="{3}" velocity="2"
effort="50"/>
</joint>"""


@pytest.mark.wide(instead="test_the_controller_itself_passes")
def test_sessions_run_on_robots_of_every_kind(tmp_path: Path) -> None:
    """Run sessions on two tips, a short slide and tools as arguments: they pass, and see exchanged tools."""
    turns = ("revolute", 1.5)
    links = (("body", "base", *turns), ("left", "body", "prismatic", 0.02), ("right", "body", *turns))
    (tmp_path / "tree.urdf").write_text(TREE.format("".join(BRANCH.format(*each) for each in links)))
    tips = ["left", "right"]
    folder = stiffgen.generate(tmp_path / "tree.urdf", tip=tips, output=tmp_path, runtime_tool=True, build=False)
    (tmp_path / "work").mkdir()
    workshop = Workshop(open_robot(folder), tmp_path / "work")
    assert workshop.survives(workshop.reference, seed=0)
    used = ", m->config.tool_pose + 16 *"
    assert used in workshop.text
    first = workshop.text.replace(used, ", m->config.tool_pose + 0 *")
    assert count_survivors(workshop, [Mutant(0, "", "", first)], seed=0) == (1, [])
