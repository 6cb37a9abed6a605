# SPDX-License-Identifier: MIT
"""docs/hazards.csv: each row names the test that fails if its sentence is false.

``make campaign NAME=hazards`` runs the tests on the faults.
"""

from __future__ import annotations

import pytest

from support.hazard_faults import HAZARD_FAULTS, HazardFault, hazards, spoilt
from support.project import ROOT, files_of_tests

CONTROLLER = (ROOT / "generated" / "iiwa14" / "iiwa14_impedance.c").read_text()


def test_each_row_has_a_seeded_fault_for_one_of_its_tests() -> None:
    rows = hazards()
    assert {fault.hazard for fault in HAZARD_FAULTS} == set(rows)
    assert {fault.hazard for fault in HAZARD_FAULTS if fault.test not in rows[fault.hazard]} == set()


def test_each_named_test_is_defined_once() -> None:
    texts = "".join(file.read_text() for file in files_of_tests())
    named = {test.partition("[")[0] for tests in hazards().values() for test in tests}
    assert [test for test in sorted(named) if texts.count(f"def {test}(") != 1] == []


@pytest.mark.parametrize("fault", HAZARD_FAULTS, ids=lambda fault: fault.test)
def test_the_fault_still_applies(fault: HazardFault) -> None:
    assert spoilt(CONTROLLER, fault) != CONTROLLER
