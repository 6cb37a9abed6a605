# SPDX-License-Identifier: MIT
"""docs/compliance.md: solved equilibria, a column of rods on springs, and the page's table and picture."""

from __future__ import annotations

import re
from types import ModuleType

import numpy as np
import pinocchio
import pytest

from examples import tip_compliance
from support.pictures import difference
from support.project import ROOT, URDF

PAGE = (ROOT / "docs" / "compliance.md").read_text()


def test_the_pages_table_is_that_of_the_results(robot: ModuleType) -> None:
    rows = [row[:4] for row in tip_compliance.rows(robot)]
    assert ["| " + " | ".join(row) + " |" for row in rows[:-1]] == re.findall(r"^\| [\d.]+ to .*$", PAGE, re.MULTILINE)
    assert rows[-1][2:] == ("unstable", "none")
    assert "With 7.5 to 40 N m/rad there is no equilibrium" in PAGE


@pytest.mark.parametrize("share", tip_compliance.SHARES[:-1])
def test_the_loaded_compliance_is_that_of_solved_equilibria(robot: ModuleType, share: float) -> None:
    posture = tip_compliance.Posture(
        robot, tip_compliance.BENT, np.diag(share * tip_compliance.MOTORS), tip_compliance.FORCE
    )
    found, _ = tip_compliance.softest(posture.compliance())
    assert found == pytest.approx(tip_compliance.solved(posture), rel=1e-4 if share > 0.1 else 1e-2)


def test_a_column_of_rods_buckles_at_the_same_force(robot: ModuleType) -> None:
    """Turned by small angles x about horizontal axes, it loses the height x^T M x / 2: M has the shorter rods above."""
    model = pinocchio.buildModelFromUrdf(str(URDF))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.zeros(model.nq))
    end = data.oMf[model.getFrameId("link_ee")].translation[2]
    axes = pinocchio.computeJointJacobians(model, data, np.zeros(model.nq))[3:]
    rods = [end - data.oMi[k + 1].translation[2] for k in range(model.nq) if abs(axes[2, k]) < 0.5]
    assert len(rods) == 3
    expected = 100.0 / np.linalg.eigvalsh(np.minimum.outer(rods, rods))[-1]
    assert tip_compliance.buckling_force(robot, 100.0) == pytest.approx(expected, rel=1e-9)
    assert tip_compliance.buckling_force(robot, 300.0) == pytest.approx(3 * expected, rel=1e-9)


def test_the_picture_is_todays(robot: ModuleType) -> None:
    assert difference(tip_compliance.figure(robot), (ROOT / "docs" / "compliance.svg").read_text(), 1.0) == ""
