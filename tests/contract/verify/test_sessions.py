# SPDX-License-Identifier: MIT
"""Changed defaults, rules and lines of a controller are found by the table of fields and by the hostile sessions."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from campaigns.mutations import Workshop, changed_defaults, count_survivors, mutants
from stiffgen.opened import open_robot
from stiffgen.verify.controller_library import ControllerLibrary
from stiffgen.verify.controller_rules import check_rules
from support.project import ROOT

FOLDER = ROOT / "generated" / "iiwa14"


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(open_robot(FOLDER), tmp_path_factory.mktemp("workshop"))


def failed_rules(workshop: Workshop, library: Path) -> set[str]:
    """Return the names of the comparisons with the table of fields that fail."""
    controller = ControllerLibrary(library, workshop.robot.name, workshop.robot.chain)
    module = SimpleNamespace(Impedance=lambda: SimpleNamespace(config=controller.config))
    checks = check_rules(controller, module, workshop.robot.chain)
    return {check.kernel.removeprefix("controller: ") for check in checks if not check.passed}


def test_the_controller_itself_passes(workshop: Workshop) -> None:
    assert failed_rules(workshop, workshop.reference) == set()
    assert workshop.survives(workshop.reference, seed=0)


def test_defaults_and_rules_are_the_tables(workshop: Workshop) -> None:
    """Every default changed at once, and a rule: the table is the generator's, not the folder's."""
    defaults = changed_defaults(workshop.text)
    assert len(defaults) >= 24
    chosen = next(each for each in defaults if "energy_limit" in each.before)
    library, _ = workshop.compile(chosen.text) or (None, None)
    assert library is not None and failed_rules(workshop, library) == {"defaults"}
    text = workshop.text.replace("&c->energy_limit, 1, 1e-06, 10000.0", "&c->energy_limit, 1, 1e-06, 20000.0")
    assert text != workshop.text
    library, _ = workshop.compile(text) or (None, None)
    assert library is not None and failed_rules(workshop, library) == {"rules"}


def test_sessions_kill_mutants(workshop: Workshop) -> None:
    """Draw six with a fixed seed; equivalent ones may be among them. ``make campaign NAME=mutations`` counts many."""
    counted, survivors = count_survivors(workshop, mutants(workshop.text, 6, seed=3), seed=0)
    assert counted >= 4 and len(survivors) <= 1, survivors
